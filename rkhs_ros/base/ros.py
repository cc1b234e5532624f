"""Whether this Python can run nodes, found out without an import of ROS, and what to do if it cannot."""

from __future__ import annotations

import os
import re
import sys
from importlib.util import find_spec
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]  # of the sources; elsewhere the folder that pip installs to
EXPECTED = "ROS 2 Jazzy and the built interfaces"


def missing_ros() -> str:
    """Return what keeps this Python from running nodes, with what to do; empty if nothing does."""
    rclpy, interfaces = find_spec("rclpy"), find_spec("rkhs_interfaces")
    origin = interfaces.origin if interfaces else None  # None of the source folder, which passes for a package
    built_for = re.search(r"/python(\d+\.\d+)/", origin or "")
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    if origin and not rclpy:
        why = f"{sys.prefix} has no rclpy"
    elif built_for and built_for[1] != version:
        why = f"rkhs_interfaces is built for Python {built_for[1]}, not {version}"
    elif not origin:
        why = "rkhs_interfaces is not built"
    else:
        return ""
    return f"{why} ({_remedy()})"


def _remedy() -> str:
    if not (REPOSITORY / "setup.bash").is_file():
        return "pip installs the library only; for topics and robots build the repository, see its docs/start.md"
    entered = os.environ.get("VIRTUAL_ENV", sys.prefix)
    if Path(entered).resolve() != Path(sys.prefix).resolve():
        return f"this is not the environment that was entered, {entered}: use its rkhs, or open a new shell"
    return f"run 'make build' in {REPOSITORY}, then 'source setup.bash'"


def require_ros(what: str) -> None:
    """Raise ValueError, which says what to do, if this Python cannot run nodes.

    Args:
        what: needs them.
    """
    missing = missing_ros()
    if missing:
        raise ValueError(f"{what}: expected {EXPECTED}, got none: {missing}")
