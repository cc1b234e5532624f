"""Settings as ROS parameters, with description and range, and the command line of a node, which names their files."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from rkhs_ros.base.settings import Entry
from rkhs_ros.base.validation import hint, require
from rkhs_ros.base.yaml_text import MOST_INT64, OF_ANY_NODE, is_for, read_sections

USAGE = """usage: ros2 run rkhs_ros {0} --ros-args [--params-file FILE] [-p NAME:=VALUE] [-r __ns:=/NAMESPACE]

FILE is a configuration, see config/; 'ros2 param describe /{0} NAME' describes a parameter."""


def check_arguments(name: str, arguments: Sequence[str]) -> None:
    """Raise ValueError for an argument that is not for ROS, or an unreadable parameter file; print the help."""
    ours = list(takewhile(lambda word: word != "--ros-args", arguments))
    if {"-h", "--help"} & set(ours):
        print(USAGE.format(name))
        raise SystemExit(0)
    expected = f"ROS arguments such as '--ros-args --params-file {(ours or [''])[0]}'"
    require(not ours, "arguments", expected, " ".join(ours))
    for file in _parameter_files(arguments):
        _sections(file)


def _parameter_files(arguments: Sequence[str]) -> list[Path]:
    return [Path(file) for flag, file in pairwise(arguments) if flag == "--params-file"]


def _sections(file: Path) -> list[str]:
    try:
        return list(read_sections(file))
    except OSError as error:
        raise ValueError(f"{file}: cannot read the parameter file: {error.strerror}") from error


def given(node: Node, *, needs_section: bool = False) -> dict[str, Any]:
    """Return the parameters with which a node was started as a tree, without those of every ROS node.

    The node must have been created with ``automatically_declare_parameters_from_overrides``, so that unknown names can
    be refused. Raises ValueError if the node needs a section of its parameter files, and none is for it.
    """
    name, files = node.get_fully_qualified_name(), _parameter_files(sys.argv)
    if needs_section and files and not any(is_for(section, name) for file in files for section in _sections(file)):
        expected = f"expected a section '/**/{node.get_name()}'"
        raise ValueError(f"no parameters for {name} in {', '.join(map(str, files))}: {expected}")
    tree: dict[str, Any] = {}
    for name, parameter in node.get_parameters_by_prefix("").items():
        if name.split(".")[0] in OF_ANY_NODE:
            continue
        *path, last = name.split(".")
        section = tree
        for key in path:
            section = section.setdefault(key, {})
        value = parameter.value
        section[last] = list(value) if parameter.type_.name.endswith("_ARRAY") else value
    return tree


def declare(node: Node, entries: Iterable[Entry]) -> None:
    """Declare settings under their dotted names with the values in use, read-only, without empty lists."""
    for entry in entries:
        if node.has_parameter(entry.name):
            node.undeclare_parameter(entry.name)
        if entry.value == ():  # ROS cannot declare an empty list
            continue
        value = list(entry.value) if isinstance(entry.value, tuple) else entry.value
        node.declare_parameter(entry.name, value, _descriptor(entry.about), ignore_override=True)


def declared(node: Node, tree: dict[str, Any], name: str, default: Any, description: str) -> Any:
    """Remove one setting of a node from its tree, declare it, and return its value, which has the default's type."""
    value = tree.pop(name, default)
    if type(value) is not type(default):
        raise ValueError(f"{name}: expected {type(default).__name__}, got {value!r}")
    declare(node, [Entry(name, value, {"description": description})])
    return value


def require_known(tree: Mapping[str, Any], *known: str) -> None:
    """Raise ValueError for an unknown key that is left in a node's tree."""
    for name in tree:
        if name not in known:
            raise ValueError(f"unknown key '{name}', {hint(name, dict.fromkeys(known))}")


def _descriptor(about: Mapping[str, Any]) -> ParameterDescriptor:
    low, high, choices = about.get("minimum"), about.get("maximum", 0), about.get("choices")
    descriptor = ParameterDescriptor(description=about["description"], read_only=True)
    if choices:
        numbers = "" if low is None else f"{low} to {high}, or "
        descriptor.additional_constraints = f"{numbers}one of " + ", ".join(choices)
    elif low is not None and isinstance(low, int):
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=min(high, MOST_INT64))]
    elif low is not None:
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=float(high))]
    return descriptor
