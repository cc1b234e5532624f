"""A node's command line, checked before ROS parses it."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from rkhs_ros.base.parameter_files import is_for, read_sections
from rkhs_ros.base.validation import require

USAGE = """usage: ros2 run rkhs_ros {0} --ros-args [--params-file FILE] [-p NAME:=VALUE] [-r __ns:=/NAMESPACE]

FILE is a configuration, see config/; 'ros2 param describe /{0} NAME' describes a parameter."""


def check_arguments(name: str, arguments: Sequence[str]) -> None:
    """Handle ``--help``; refuse arguments that are not for ROS, and unreadable parameter files.

    Args:
        name: of the node.
        arguments: of its process.

    Raises:
        ValueError: an argument is not for ROS, or a parameter file cannot be read.
        SystemExit: after printing the help.
    """
    ours, ros = _split(arguments)
    if {"-h", "--help"} & set(ours):
        print(USAGE.format(name))
        raise SystemExit(0)
    expected = f"ROS arguments such as '--ros-args --params-file {(ours or [''])[0]}'"
    require(not ours, "arguments", expected, " ".join(ours))
    for file in _parameter_files(ros):
        _sections(file)


def require_section(node: str, arguments: Sequence[str]) -> None:
    """Refuse to start if there are parameter files but none has a section for the node.

    Args:
        node: its full name.
        arguments: of its process.

    Raises:
        ValueError: no parameter file has a section for the node.
    """
    files = _parameter_files(_split(arguments)[1])
    if files and not any(is_for(section, node) for file in files for section in _sections(file)):
        expected = f"expected a section '/**/{node.rpartition('/')[2]}'"
        raise ValueError(f"no parameters for {node} in {', '.join(map(str, files))}: {expected}")


def _split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split arguments into those that are not for ROS, and those between ``--ros-args`` and ``--``, which are."""
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
        raise ValueError(f"{file}: cannot read the parameter file: {error.strerror}") from error
