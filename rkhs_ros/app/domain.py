"""The ROS domain of a run: one of its own, unless ROS_DOMAIN_ID says which."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import read_whole
from rkhs_ros.base.lock import locked
from rkhs_ros.base.validation import require

VARIABLE = "ROS_DOMAIN_ID"
# Whoever has this port, plus a domain, bound has that domain: so have it the coordinator of ROS's own tests.
PORT_BASE = 32768
DOMAINS = range(100, 0, -1)  # from the top, as people who choose one take small numbers


@contextmanager
def own_domain(folder: Path, default: str | None = None) -> Iterator[None]:
    """Have the nodes that are started meanwhile in a domain that no other run has, and say in the folder which.

    Where the environment says which domain, that stays.

    Args:
        folder: the run's; the file ``checkpoints/domain`` is in it as long as the run goes on.
        default: the domain where the environment does not say, as of a robot; None for one that no other run has.

    Raises:
        RunError: all domains are taken.
        ValueError: another process is in the folder.
        OSError: the folder cannot be written.
    """
    given = os.environ.get(VARIABLE)
    with socket.socket() as claim:
        domain = given or default or str(_claimed(claim))
        with locked(folder):  # else the run under way could not be found any more
            _file(folder).write_text(f"{domain}\n")
        os.environ[VARIABLE] = domain
        try:
            yield
        finally:
            if given is None:
                del os.environ[VARIABLE]
            with suppress(OSError):
                _file(folder).unlink(missing_ok=True)


def domain_of(folder: Path) -> str:
    """Return the domain of a run that goes on.

    Raises:
        ValueError: none is under way in the folder.
    """
    require(_file(folder).is_file(), f"{folder}", "the folder of a run under way over topics", "none")
    return read_whole(_file(folder)).decode(errors="replace").strip()


def _file(folder: Path) -> Path:
    return folder / "checkpoints" / "domain"


def _claimed(claim: socket.socket) -> int:
    for domain in DOMAINS:
        with suppress(OSError):
            claim.bind(("", PORT_BASE + domain))
            return domain
    raise RunError(f"expected a free ROS domain of {len(DOMAINS)}, got none; set {VARIABLE}")
