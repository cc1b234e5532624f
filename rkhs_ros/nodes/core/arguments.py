"""A node's command line, looked at before ROS takes its part of it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from rkhs_ros.base.parameter_files import is_for, read_sections
from rkhs_ros.base.validation import require

USAGE = """usage: ros2 run rkhs_ros {0} --ros-args [--params-file FILE] [-p NAME:=VALUE] [-r __ns:=/NAMESPACE]

FILE is a configuration, see config/; 'ros2 param describe /{0} NAME' tells what a parameter is."""


def check_arguments(name: str, arguments: Sequence[str]) -> None:
    """Answer ``--help``, and refuse what is not for ROS, and parameter files that cannot be read.

    Args:
        name: the node's.
        arguments: of its process.

    Raises:
        ValueError: there is such an argument or file.
        SystemExit: help was asked for, and given.
    """
    ours, ros = _split(arguments)
    if {"-h", "--help"} & set(ours):
        print(USAGE.format(name))
        raise SystemExit(0)
    require(not ours, "arguments", f"those of ROS, as '--ros-args --params-file {(ours or [''])[0]}'", " ".join(ours))
    for file in _parameter_files(ros):
        _sections(file)


def require_section(node: str, arguments: Sequence[str]) -> None:
    """Refuse to go without parameters where there are files that should have some.

    Args:
        node: its full name.
        arguments: of its process.

    Raises:
        ValueError: there are parameter files, none of them with a section for the node.
    """
    files = _parameter_files(_split(arguments)[1])
    if files and not any(is_for(section, node) for file in files for section in _sections(file)):
        expected = f"expected a section '/**/{node.rpartition('/')[2]}'"
        raise ValueError(f"no parameters for {node} in {', '.join(map(str, files))}: {expected}")


def _split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the arguments that are not for ROS, and those that are: between ``--ros-args`` and ``--``."""
    ours: list[str] = []
    ros: list[str] = []
    inside = False
    for word in arguments:
        if word == "--ros-args" or (inside and word == "--"):
            inside = word == "--ros-args"
        else:
            (ros if inside else ours).append(word)
    return ours, ros


def _parameter_files(ros: Sequence[str]) -> list[Path]:
    return [Path(file) for flag, file in pairwise(ros) if flag == "--params-file"]


def _sections(file: Path) -> list[str]:
    try:
        return list(read_sections(file))
    except OSError as error:
        raise ValueError(f"{file}: expected a parameter file, got: {error.strerror}") from error
