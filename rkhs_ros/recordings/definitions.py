"""Messages of rkhs_interfaces without a ROS workspace: types, serialisation (CDR) and definitions.

The folder ``msg`` beside this module is the one of rkhs_interfaces.
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
    return _store_with(*((path.read_text(), PACKAGE + path.stem) for path in sorted(FOLDER.glob("*.msg"))))


@cache
def _store_of(kind: str, text: str) -> Typestore:
    return store() if text == definition(kind) else _store_with((text, kind))


def _store_with(*definitions: tuple[str, str]) -> Typestore:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # here, since the import takes 0.1 s

    types = get_typestore(Stores.EMPTY)
    for text, kind in definitions:
        types.register(get_types_from_msg(text, kind))
    return types


class Types:
    """Our message types as attributes, like those of ``rkhs_interfaces.msg``; omitted fields are 0."""

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return partial(_made, PACKAGE + name)


def encoded(message: Any) -> bytes:
    """Serialise a message in CDR, the format of ROS topics."""
    return bytes(store().serialize_cdr(message, message.__msgtype__))


@cache
def definition(kind: str) -> str:
    """Return the definition of a message type with its nested types, in the format of recordings."""
    return store().generate_msgdef(kind, ros_version=2)[0]


def decoded(content: bytes | memoryview, kind: str, text: str) -> Any:
    """Deserialise a message.

    Args:
        content: serialised message.
        kind: name of the type, such as ``rkhs_interfaces/msg/Policy``.
        text: definition in the recording.

    Raises:
        rosbags.serde.SerdeError: the content is not a message of this type.
    """
    return _store_of(kind, text).deserialize_cdr(content, kind)


def _made(kind: str, **given: Any) -> Any:
    makers = _makers(kind)
    zeros = {name: make(None) for name, make in makers.items() if name not in given}
    return store().types[kind](**zeros, **{name: makers[name](value) for name, value in given.items()})


@cache
def _makers(kind: str) -> dict[str, Callable[[Any], Any]]:
    """Return the functions that convert a value, or None, to each field of a message."""
    return {name: _maker(about) for name, about in store().fielddefs[kind][1]}


def _maker(about: Any) -> Callable[[Any], Any]:
    """Return a function that converts a value to an array of numbers, a list of messages, or a single one of these."""
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
