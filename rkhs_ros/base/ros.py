"""Check without importing ROS whether this Python can run nodes, and suggest a remedy if it cannot."""

import os
import re
import sys
from importlib.util import find_spec
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]  # of the sources; for an installed package, pip's target folder
EXPECTED = "ROS 2 Jazzy and the built interfaces"


def missing_ros() -> str:
    """Return why this Python cannot run nodes, with a remedy; empty if it can."""
    rclpy, interfaces = find_spec("rclpy"), find_spec("rkhs_interfaces")
    # The origin is None for the source folder, which counts as a namespace package.
    origin = interfaces.origin if interfaces else None
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
        return f"this is not the active environment {entered}: use its rkhs, or open a new shell"
    return f"run 'make build' in {REPOSITORY}, then 'source setup.bash'"


def require_ros(what: str) -> None:
    """Raise ValueError with a remedy if this Python cannot run nodes.

    Args:
        what: name of the feature that needs nodes, used in the message.
    """
    missing = missing_ros()
    if missing:
        raise ValueError(f"{what}: expected {EXPECTED}, got none: {missing}")
