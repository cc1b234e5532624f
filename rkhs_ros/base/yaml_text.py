"""Read and write YAML with the same types as ROS parameter files, and match their sections to nodes.

PyYAML reads 1e5 and nan as text and 1:30 as a number, and it recognises dates; ROS does not, and neither does this
reader. It limits the size of untrusted text, and rejects aliases, which ROS does not support and which can expand
without bound.
"""

import re
from collections.abc import Hashable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from rkhs_ros.base.validation import require, truncated

MOST_BYTES = 100_000  # of a text; PyYAML needs about a second for it
MOST_INT64 = 2**63 - 1
OF_ANY_NODE = {"use_sim_time", "start_type_description_service", "qos_overrides"}  # parameters that ROS declares
NUMBER_WORDS = r"[-+]?(?:\.(?:inf|Inf|INF)|[iI][nN][fF](?:[iI][nN][iI][tT][yY])?|[nN][aA][nN])|\.(?:nan|NaN|NAN)"
BOOLS = r"y|Y|yes|Yes|YES|true|True|TRUE|on|On|ON|n|N|no|No|NO|false|False|FALSE|off|Off|OFF"
RESOLVERS = {  # types of plain scalars; the first match counts; numbers follow strtol and strtod
    "bool": BOOLS,
    "null": r"~|null|Null|NULL|",
    "int": r"[-+]?(?:0|[1-9][0-9]*|0[0-7]+|0[xX][0-9a-fA-F]+)",
    "float": rf"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|{NUMBER_WORDS}",
}
KINDS = (*RESOLVERS, "str", "seq", "map")
TAG = "tag:yaml.org,2002:"
PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")  # text that needs no quotes, unless it is a reserved word
RESERVED = re.compile("|".join(RESOLVERS.values()))


class _Reader(yaml.SafeLoader):
    """A YAML loader that makes plain values only."""

    yaml_implicit_resolvers = {
        None: [(TAG + kind, re.compile(rf"(?:{pattern})\Z")) for kind, pattern in RESOLVERS.items()]
    }
    yaml_constructors = {tag: made for tag, made in yaml.SafeLoader.yaml_constructors.items() if tag in {
        *(TAG + kind for kind in KINDS), None}}  # fmt: skip
    bool_values = yaml.SafeLoader.bool_values | {"y": True, "n": False}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise yaml.YAMLError(f"line {event.start_mark.line + 1}: anchors and aliases, which ROS does not support")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        found = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                key.tag = f"{TAG}str"  # ROS reads every key as text, so a key may be called "on"
                if key.value in found:
                    raise yaml.YAMLError(f"line {key.start_mark.line + 1}: a second key '{key.value}'")
                found.add(key.value)
        return yaml.constructor.BaseConstructor.construct_mapping(self, node, deep)


class _Writer(yaml.SafeDumper):
    """A YAML dumper that quotes ambiguous text and writes no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        """Return True, because ROS does not support aliases."""
        return True


def _represent_text(writer: _Writer, text: str) -> yaml.ScalarNode:
    plain = PLAIN.fullmatch(text) and not RESERVED.fullmatch(text)
    return writer.represent_scalar(f"{TAG}str", text, style=None if plain else "'")


_Writer.add_representer(str, _represent_text)


def loaded(text: str) -> Any:
    """Parse YAML text."""
    require(len(text) <= MOST_BYTES, "text", f"at most {MOST_BYTES} characters", "more")
    try:
        return yaml.load(text, _Reader)  # makes plain values only
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: a number with very many digits
        raise ValueError(truncated(error)) from error


def read_yaml(path: Path) -> Any:
    """Read a YAML file.

    Raises:
        ValueError: the file is not YAML, too large, or has aliases; the message names it.
    """
    content = path.read_bytes()
    try:
        return loaded(content.decode())
    except ValueError as error:
        raise ValueError(f"{path}: expected a YAML file, got one that cannot be parsed ({error})") from error


def dumped(tree: Mapping[str, Any]) -> str:
    """Return YAML text that PyYAML, `loaded` and ROS read alike; the values must be valid for ROS parameters."""
    return yaml.dump(tree, Dumper=_Writer, sort_keys=False, default_flow_style=None)


def require_ros_value(value: Any, name: str) -> None:
    """Check that a value can be a ROS parameter.

    The value may be a section of parameters; the name is for messages.

    Raises:
        ValueError: the value is not a boolean, a 64-bit integer, a finite number, UTF-8 text or a list of one type.
    """
    if isinstance(value, Mapping):
        for key, each in value.items():
            require("." not in key, name, "names without a dot", repr(key))
            require_ros_value(each, f"{name}.{key}")
        return
    each = value if isinstance(value, list | tuple) else [value]
    good = len(each) > 0 and len(set(map(type, each))) == 1 and all(map(_is_ros_scalar, each))
    expected = "true or false, a 64-bit integer, a finite number, UTF-8 text, or a list of one of these types"
    require(good, name, expected, repr(value))


def _is_ros_scalar(value: Any) -> bool:
    if isinstance(value, str):
        return "\0" not in value and value.encode(errors="replace") == value.encode(errors="surrogatepass")
    if isinstance(value, float):
        return abs(value) < float("inf")
    return isinstance(value, bool) or (isinstance(value, int) and -MOST_INT64 <= value <= MOST_INT64)


PARAMETERS = "ros__parameters"  # the key below the name of a node
LEARNER, ROBOT = "/**/learner", "/**/robot"  # sections for these nodes in any namespace
WILDCARDS = {"*": "/[^/]+", "**": "(/[^/]+)*"}  # for one part of a node's full name, and for any number of parts


def read_sections(path: Path) -> dict[str, dict[str, Any]]:
    """Return the sections of a ROS parameter file by node name, as written in the file."""
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

    The section may have wildcards, such as ``/**/simulator``; the node has its full name, such as ``/lab/simulator``.
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
