"""Settings as ROS parameters: read from the node's overrides, declared with description and range."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from rkhs_ros.base.settings import Entry
from rkhs_ros.base.validation import hint

OF_EVERY_NODE = ("use_sim_time", "start_type_description_service", "qos_overrides")
MOST_INT64 = 2**63 - 1  # the greatest bound that a range of whole numbers can have


def given(node: Node) -> dict[str, Any]:
    """Return the parameters a node was started with as a tree, without those that every ROS node has.

    The node must have been made with ``automatically_declare_parameters_from_overrides``, so that unknown names
    are seen and can be refused.
    """
    tree: dict[str, Any] = {}
    for name, parameter in node.get_parameters_by_prefix("").items():
        if name.split(".")[0] in OF_EVERY_NODE:
            continue
        *path, last = name.split(".")
        section = tree
        for key in path:
            section = section.setdefault(key, {})
        value = parameter.value
        section[last] = list(value) if parameter.type_.name.endswith("_ARRAY") else value
    return tree


def declare(node: Node, entries: Iterable[Entry]) -> None:
    """Declare settings under their dotted names with the values in use.

    They are read-only: a run is fixed by its configuration.
    """
    for entry in entries:
        if node.has_parameter(entry.name):
            node.undeclare_parameter(entry.name)
        value = list(entry.value) if isinstance(entry.value, tuple) else entry.value
        node.declare_parameter(entry.name, value, _descriptor(entry.about), ignore_override=True)


def declared(node: Node, tree: dict[str, Any], name: str, default: Any, description: str) -> Any:
    """Take one setting of a node out of its tree and declare it.

    Raises:
        ValueError: the value is of another type than the default.
    """
    value = tree.pop(name, default)
    if type(value) is not type(default):
        raise ValueError(f"{name}: expected {type(default).__name__}, got {value!r}")
    declare(node, [Entry(name, value, {"description": description})])
    return value


def restarts(node: Node, tree: dict[str, Any]) -> int:
    """Take out of a node's tree how often it was started again, and declare it."""
    return int(declared(node, tree, "restarts", 0, "times that this node was started again after it died"))


@dataclass(frozen=True)
class Process:
    """What tells a process of a node from others of the same name.

    Attributes:
        number: greater than those of processes before it, by the system's clock.
        began: monotonic time at which it began, in seconds, or the run that it belongs to.
    """

    number: int
    began: float


def process(node: Node, tree: dict[str, Any]) -> Process:
    """Take out of a node's tree what names its process and tells how old it is, and declare it.

    All nodes of a run are given the time at which it began, plus their restarts, and how long that is ago: so of two
    runs all nodes of one are older than those of the other.
    """
    about = "names this process among those of its name, the older ones by smaller numbers; 0 for the time"
    number = int(declared(node, tree, "instance", 0, about)) or time.time_ns()
    about = "seconds since the run of this process began; of two processes of a name the one of the older run stays"
    return Process(number, time.monotonic() - float(declared(node, tree, "run_age", 0.0, about)))


def require_known(tree: Mapping[str, Any], *known: str) -> None:
    """Refuse what is left of a node's tree.

    Raises:
        ValueError: something is, but for the names given.
    """
    for name in tree:
        if name not in known:
            raise ValueError(f"unknown key '{name}', {hint(name, dict.fromkeys(known))}")


def _descriptor(about: Mapping[str, Any]) -> ParameterDescriptor:
    low, high, choices = about.get("minimum"), about.get("maximum", 0), about.get("choices")
    descriptor = ParameterDescriptor(description=about["description"], read_only=True)
    if choices:
        descriptor.additional_constraints = "one of " + ", ".join(choices)
    elif low is not None and isinstance(low, int):
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=min(high, MOST_INT64))]
    elif low is not None:
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=float(high))]
    return descriptor
