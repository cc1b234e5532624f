"""Settings as ROS parameters: read from a node's overrides, declared with description and range."""

from collections.abc import Iterable, Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from rkhs_ros.base.settings import Entry
from rkhs_ros.base.validation import hint

OF_EVERY_NODE = ("use_sim_time", "start_type_description_service", "qos_overrides")
MOST_INT64 = 2**63 - 1  # the greatest bound of an integer range


def given(node: Node) -> dict[str, Any]:
    """Return the parameters with which a node was started as a tree, without those of every ROS node.

    The node must have been created with ``automatically_declare_parameters_from_overrides``, so that unknown names can
    be refused.
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
    """Declare settings under their dotted names with the values in use, read-only, without empty lists."""
    for entry in entries:
        if node.has_parameter(entry.name):
            node.undeclare_parameter(entry.name)
        if entry.value == ():  # ROS cannot declare an empty list
            continue
        value = list(entry.value) if isinstance(entry.value, tuple) else entry.value
        node.declare_parameter(entry.name, value, _descriptor(entry.about), ignore_override=True)


def declared(node: Node, tree: dict[str, Any], name: str, default: Any, description: str) -> Any:
    """Remove one setting of a node from its tree, declare it, and return its value.

    Raises:
        ValueError: the value has another type than the default.
    """
    value = tree.pop(name, default)
    if type(value) is not type(default):
        raise ValueError(f"{name}: expected {type(default).__name__}, got {value!r}")
    declare(node, [Entry(name, value, {"description": description})])
    return value


def require_known(tree: Mapping[str, Any], *known: str) -> None:
    """Refuse unknown keys that are left in a node's tree.

    Raises:
        ValueError: a key is not among the known names.
    """
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
