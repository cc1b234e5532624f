"""The messages of rkhs_interfaces without a ROS workspace: their types, their bytes (CDR) and their definitions.

The folder ``msg`` beside this module is that of rkhs_interfaces.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

FOLDER = Path(__file__).parent / "msg"
PACKAGE = "rkhs_interfaces/msg/"
ZEROS: dict[str, Any] = {"string": "", "bool": False}  # the other types are numbers


@cache
def store() -> Typestore:
    """Return our message types."""
    return _with_ours("EMPTY")


@cache
def store_of_all() -> Typestore:
    """Return the message types of ROS 2 Jazzy, and ours."""
    return _with_ours("ROS2_JAZZY")


def _with_ours(name: str) -> Typestore:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # here, since it takes 0.1 s and few need it

    types = get_typestore(Stores[name])
    for path in sorted(FOLDER.glob("*.msg")):
        types.register(get_types_from_msg(path.read_text(), PACKAGE + path.stem))
    return types


class Types:
    """Our message types by their names, as the attributes of ``rkhs_interfaces.msg``; fields left out are 0."""

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return partial(_made, PACKAGE + name)


def encoded(message: Any) -> bytes:
    """Return the bytes of a message, as they go over topics."""
    return bytes(store().serialize_cdr(message, message.__msgtype__))


@cache
def definition(kind: str) -> str:
    """Return the definition of a message type with those of the types within, as recordings hold it."""
    return store().generate_msgdef(kind, ros_version=2)[0]


@cache
def _store_of(kind: str, text: str) -> Typestore:
    """Return the types of a definition that a recording holds."""
    if kind in store().types and text in ("", definition(kind)):
        return store()
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(text, kind))
    return types


def decoded(content: bytes | memoryview, kind: str, text: str) -> Any:
    """Return the message in some bytes.

    Args:
        content: the bytes.
        kind: name of the type, as ``rkhs_interfaces/msg/Policy``.
        text: its definition, as the recording holds it; ours where empty.

    Raises:
        rosbags.serde.SerdeError: they are no such message.
    """
    return _store_of(kind, text).deserialize_cdr(content, kind)


def _made(kind: str, **given: Any) -> Any:
    makers = _makers(kind)
    unknown = given.keys() - makers
    if unknown:
        raise ValueError(f"{kind}: expected its fields, got {', '.join(sorted(unknown))}")
    return store().types[kind](**{name: make(given.get(name)) for name, make in makers.items()})


@cache
def _makers(kind: str) -> dict[str, Callable[[Any], Any]]:
    """Return what makes the fields of a message from what is given for them, None where nothing is."""
    return {name: _maker(about) for name, about in store().fielddefs[kind][1]}


def _maker(about: Any) -> Callable[[Any], Any]:
    """Return what makes a field: an array of its numbers, a list of its messages, or a single one of these."""
    from rosbags.interfaces import Nodetype

    node, inner = about
    if node == Nodetype.NAME:
        return lambda value: _made(inner) if value is None else value
    if node == Nodetype.BASE:
        zero = ZEROS.get(inner[0], 0)
        return lambda value: zero if value is None else value
    (within, (name, *_)), _ = inner
    if within == Nodetype.BASE and name != "string":
        return lambda value: np.asarray([] if value is None else value, dtype=name)
    return lambda value: [] if value is None else list(value)
