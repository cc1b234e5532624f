"""Read ROS parameter files and match their sections to nodes."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rkhs_ros.base.validation import require
from rkhs_ros.base.yaml_text import read_yaml

PARAMETERS = "ros__parameters"  # the key below the name of a node
# Sections for these nodes in any namespace.
SIMULATOR, POLICY, LEARNER = "/**/simulator", "/**/policy", "/**/learner"
ROBOT, GATE, SIMULATED_ROBOT = "/**/robot", "/**/gate", "/**/simulated_robot"
WILDCARDS = {"*": "/[^/]+", "**": "(/[^/]+)*"}  # for one part of a node's full name, and for any number of parts


def read_sections(path: Path) -> dict[str, dict[str, Any]]:
    """Return the sections of a ROS parameter file by node name, as written in the file.

    Raises:
        ValueError: the file is not a ROS parameter file.
        OSError: the file cannot be read.
    """
    document = read_yaml(path)
    require(isinstance(document, dict), f"{path}", "sections 'simulator' and 'learner'", type(document).__name__)
    sections: dict[str, dict[str, Any]] = {}
    for name, section in _flat(document):
        parameters: Any = section[PARAMETERS] if isinstance(section, dict) and list(section) == [PARAMETERS] else None
        require(isinstance(parameters, dict), f"{path}: {name}", PARAMETERS, section)
        sections[name] = parameters
    return sections


def is_for(section: str, node: str) -> bool:
    """Return whether a section applies to a node.

    Args:
        section: name of the section in the file, possibly with wildcards, such as ``/**/simulator``.
        node: full name of the node, such as ``/lab/simulator``.
    """
    parts = section.strip("/").split("/")
    return re.fullmatch("".join(WILDCARDS.get(part, "/" + re.escape(part)) for part in parts), node) is not None


def _flat(document: Mapping[Any, Any], namespace: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the sections; the name of a section within a namespace begins with the namespace."""
    for name, section in document.items():
        inner = isinstance(section, dict) and section and all(isinstance(value, dict) for value in section.values())
        if inner and PARAMETERS not in section:
            yield from _flat(section, f"{namespace}{name}/")
        else:
            yield f"{namespace}{name}", section
