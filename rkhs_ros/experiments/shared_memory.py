"""Shared memory that killed nodes leave: Fast DDS frees what it used only in a process that ends by itself."""

from __future__ import annotations

import fcntl
import time
from pathlib import Path

HERE = Path("/dev/shm")
SETTLED = 0.2  # seconds; what is younger may be about to be locked


def free_abandoned(folder: Path = HERE) -> None:
    """Remove the segments and ports of Fast DDS that no living process has locked.

    Args:
        folder: where they are, ``fastrtps_NAME``, its lock ``fastrtps_NAME_el`` and semaphore
            ``sem.fastrtps_NAME_mutex``.
    """
    names = {path.name.removesuffix("_el") for path in folder.glob("fastrtps_*")}
    for name in names:
        files = [folder / name, folder / f"{name}_el", folder / f"sem.{name}_mutex"]
        if not _young(files) and not _held(files[1]):
            for file in files:
                file.unlink(missing_ok=True)


def _young(files: list[Path]) -> bool:
    return any(file.exists() and time.time() - file.stat().st_mtime < SETTLED for file in files)


def _held(lock: Path) -> bool:
    try:
        with lock.open() as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False
