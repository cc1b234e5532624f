"""Settings: the fields of frozen dataclasses, each with a description and a range.

They validate YAML files, declare ROS parameters and define the resolved configuration. Settings that are created in
Python are checked too.
"""

from collections.abc import Iterator, Mapping
from dataclasses import Field, field, fields, is_dataclass
from functools import cache
from numbers import Integral, Real
from typing import Any, NamedTuple, TypeVar, get_type_hints

import numpy as np

from rkhs_ros.base.validation import NamedFields, hint, pick, require

T = TypeVar("T")
Tree = Mapping[str, Any]


class UnknownKeyError(ValueError):
    """Raised for a key that is not a setting of its section."""


class Settings(NamedFields):
    """Base class of frozen dataclasses whose fields are settings; every new instance checks its values."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value has the wrong type or is out of range."""
        types = _types(type(self))  # type: ignore[arg-type]  # a class can be hashed
        for f in fields(self):  # type: ignore[arg-type]  # a subclass is a dataclass
            if _is_setting(f, types):
                object.__setattr__(self, f.name, _checked(f, types[f.name], getattr(self, f.name), f.name))


class Entry(NamedTuple):
    """A setting with its dotted name, value and metadata."""

    name: str
    value: Any
    about: Mapping[str, Any]


def setting(
    default: Any,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """Declare a dataclass field that users can set.

    Args:
        default: default value.
        description: meaning and unit.
        minimum: smallest number allowed.
        maximum: largest number allowed.
        choices: allowed strings; empty for any.
    """
    about = {"description": description, "minimum": minimum, "maximum": maximum, "choices": choices}
    return field(default=default, metadata=about)


def variant(default: Any, table: Mapping[str, type], key: str) -> Any:
    """Declare a field whose class is selected from a table by the entry ``key`` of its section."""
    return field(default=default, metadata={"table": table, "key": key})


def build(cls: type[T], values: Tree, path: str = "") -> T:
    """Build a settings dataclass from a tree of values.

    The values are plain, by field name, nested for nested settings; ``path`` is the dotted prefix for messages.

    Raises:
        ValueError: a key is unknown, or a value has the wrong type or is out of range; one line with a hint.
    """
    require(isinstance(values, Mapping), path.rstrip(".") or "configuration", "a section of keys", repr(values))
    types = _types(cls)  # type: ignore[arg-type]  # a class can be hashed
    known = {f.name: f for f in fields(cls) if _is_setting(f, types)}  # type: ignore[arg-type]  # a dataclass
    for key in values:
        if key not in known:
            raise UnknownKeyError(f"unknown key '{path}{key}', {_meant(str(key), cls, known, path)}")
    return cls(**{k: _convert(f, types[k], values[k], path + k) for k, f in known.items() if k in values})


def build_section(cls: type[T], values: Any, path: str) -> T:
    """Build the settings of a section whose dotted path is ``path``, which every error names."""
    try:
        return build(cls, values, f"{path}.")
    except ValueError as error:
        text = str(error)
        raise ValueError(text if path in text else f"{path}: {text}") from error


def _meant(key: str, cls: type, known: Mapping[str, Any], path: str) -> str:
    """Return a hint for an unknown key: the full names of nested settings of that name, or the closest full name."""
    within = [path + entry.name for entry in entries(cls()) if entry.name.rpartition(".")[2] == key]
    return hint(key, known, path) if not within else f"did you mean {' or '.join(map(repr, within))}?"


@cache
def _types(cls: type) -> dict[str, Any]:
    return get_type_hints(cls)


def _is_setting(f: Field[Any], types: dict[str, Any]) -> bool:
    return bool(f.metadata) or is_dataclass(types[f.name])


def _build_variant(f: Field[Any], values: Tree, path: str) -> Any:
    """Build the settings dataclass that the values select; without a selection, the default's class."""
    table, key = f.metadata["table"], f.metadata["key"]
    meant = f" such as {path}{key}={values}" if isinstance(values, str) else ""
    require(isinstance(values, Mapping), path.rstrip("."), f"a section of keys{meant}", repr(values))
    cls: Any = pick(str(values[key]), table, path + key) if key in values else type(f.default)
    try:
        return build(cls, {k: v for k, v in values.items() if k != key}, path)
    except UnknownKeyError as error:  # for example, another variant is selected but the old one's settings remain
        of_others = {name for other in table.values() for name in _types(other)} - set(_types(cls))
        if key not in values or not of_others.intersection(map(str, values)):
            raise
        section = path.rstrip(".")
        remedy = f"{section}={{{key}: {values[key]}}} selects '{values[key]}' with its defaults"
        raise UnknownKeyError(f"{error} ({remedy})") from error


def _convert(f: Field[Any], kind: Any, value: Any, name: str) -> Any:
    if "table" in f.metadata:
        return _build_variant(f, value, name + ".")
    if is_dataclass(kind):
        return build(kind, value, name + ".")  # type: ignore[arg-type]  # a dataclass type
    return _checked(f, kind, value, name)


def _checked(f: Field[Any], kind: Any, value: Any, name: str) -> Any:
    """Convert the value of a setting to its type and check its range."""
    if "table" in f.metadata or is_dataclass(kind):
        require(isinstance(value, kind), name, f"{_named(kind)}", f"{value!r}")
        return value
    if isinstance(value, list | tuple) and not value and f.default == ():
        return ()
    try:
        converted = _of_type(kind, value, name)
    except OverflowError as error:
        raise ValueError(f"{name}: expected a number within double precision, got one too large") from error
    check_range(converted, f.metadata, name)
    return converted


def _of_type(kind: Any, value: Any, name: str) -> Any:
    text, whole, number = isinstance(value, str), _is_number(value, Integral), _is_number(value, Real)
    simple = {
        bool: (isinstance(value, bool), "true or false"),
        int: (whole, "a whole number"),
        float: (number, "a number"),
        str: (text, "text (quote words that YAML reads as another type)"),
    }
    if kind in simple:
        is_good, expected = simple[kind]
        require(is_good, name, expected, repr(value))
        return kind(value)
    if kind == tuple[str, ...]:
        texts = (value,) if text else value
        good = isinstance(texts, list | tuple) and all(isinstance(v, str) for v in texts)
        require(good, name, "a list of strings", repr(value))
        return tuple(texts)
    if text and kind != tuple[float, ...]:
        return value
    if kind == str | int:
        require(whole, name, "a whole number or one of the choices", repr(value))
        return int(value)
    row = isinstance(value, list | tuple | np.ndarray) and np.ndim(value) == 1 and len(value) > 0
    numbers = row and all(_is_number(v, Real) for v in value)
    require(numbers or number, name, "a list of numbers", repr(value))
    return tuple(map(float, value)) if numbers else (float(value),)


def _is_number(value: Any, kind: type) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)


def _named(kind: Any) -> str:
    return " or ".join(cls.__name__ for cls in getattr(kind, "__args__", (kind,)))


def check_range(value: Any, about: Mapping[str, Any], name: str) -> None:
    """Raise ValueError if the value, or an element of a tuple, is out of range or not among the choices."""
    low = -float("inf") if about["minimum"] is None else about["minimum"]
    high = float("inf") if about["maximum"] is None else about["maximum"]
    for one in value if isinstance(value, tuple) else (value,):
        if not isinstance(one, str):
            require(low <= one <= high and abs(one) != float("inf"), name, f"a number in [{low}, {high}]", one)
        elif about["choices"] and one not in about["choices"]:
            known = (*about["choices"], *([] if about["minimum"] is None else ["a number"]))
            raise ValueError(f"{name}: unknown choice '{one}', {hint(one, dict.fromkeys(known))}")


def entries(settings: Any, path: str = "") -> Iterator[Entry]:
    """Yield the settings of a dataclass instance; nested ones have dotted names."""
    for f in fields(settings):
        value = getattr(settings, f.name)
        if "table" in f.metadata:
            table, key = f.metadata["table"], f.metadata["key"]
            name = next(n for n, cls in table.items() if cls is type(value))
            about = {"description": f"which {f.name} to use", "minimum": None, "maximum": None, "choices": tuple(table)}
            yield Entry(f"{path}{f.name}.{key}", name, about)
            yield from entries(value, f"{path}{f.name}.")
        elif is_dataclass(value):
            yield from entries(value, f"{path}{f.name}.")
        elif "description" in f.metadata:
            yield Entry(path + f.name, value, f.metadata)
