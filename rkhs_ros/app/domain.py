"""ROS domain of a run: a free domain, unless ROS_DOMAIN_ID is set."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import locked, read_whole
from rkhs_ros.base.validation import require

VARIABLE = "ROS_DOMAIN_ID"
# A process owns a domain while it binds the port PORT_BASE + domain, as the coordinator of ROS's tests does.
PORT_BASE = 32768
DOMAINS = range(100, 0, -1)  # from the top, since people tend to choose small numbers


@contextmanager
def reserved_domain(folder: Path, default: str | None = None) -> Iterator[None]:
    """Set a ROS domain that no other run uses for the nodes started in this context, and write it to the run's folder.

    A domain set by ROS_DOMAIN_ID stays.

    Args:
        folder: folder of the run; contains the file ``domain`` while the run is running.
        default: domain if ROS_DOMAIN_ID is unset or empty, such as that of a robot; None for a free domain.

    Raises:
        RunError: all domains are in use.
        ValueError: another process uses the folder.
    """
    given = os.environ.get(VARIABLE)  # ROS treats an empty value like none
    with socket.socket() as claim:
        domain = given or default or str(_claimed(claim))
        with locked(folder):  # otherwise the active run could no longer be found
            _file(folder).write_text(f"{domain}\n")
        os.environ[VARIABLE] = domain
        try:
            yield
        finally:
            if given is None:
                del os.environ[VARIABLE]
            else:
                os.environ[VARIABLE] = given
            with suppress(OSError):
                _file(folder).unlink(missing_ok=True)


def domain_of(folder: Path) -> str:
    """Return the ROS domain of an active run.

    Raises:
        ValueError: the folder has no active run over topics.
    """
    require(_file(folder).is_file(), f"{folder}", "the folder of an active run over topics", "none")
    return read_whole(_file(folder)).decode(errors="replace").strip()


def _file(folder: Path) -> Path:
    return folder / "domain"


def _claimed(claim: socket.socket) -> int:
    for domain in DOMAINS:
        with suppress(OSError):
            claim.bind(("", PORT_BASE + domain))
            return domain
    raise RunError(f"expected a free ROS domain among {len(DOMAINS)}, got none. Set {VARIABLE}")
