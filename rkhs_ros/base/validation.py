"""Validate values with messages that name the expected value, the value given and the closest valid name."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from difflib import get_close_matches
from importlib.util import find_spec
from math import isfinite, prod
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

T = TypeVar("T")
REAL_KINDS = "buif"  # numpy kinds of booleans and numbers; text and dates are not converted
LARGEST = 1e100  # largest observation or reward; products of a few such numbers are still finite
MOST_LISTED, MOST_MEANT = 30, 3  # names listed and suggested in a message
MOST_SHOWN = 200  # characters of a value in a message


def truncated(value: object) -> str:
    """Return an untrusted value as one printable line of limited length."""
    text = str(value)
    line = " ".join(text[: 2 * MOST_SHOWN].split())
    return "".join(c if c.isprintable() else "?" for c in line)[:MOST_SHOWN] + "..." * (len(line) > MOST_SHOWN)


def require(condition: bool, what: str, expected: str, got: object) -> None:
    """Raise ValueError "what: expected ..., got ..." unless the condition holds."""
    if not condition:
        raise ValueError(f"{what}: expected {expected}, got {truncated(got)}")


@contextmanager
def prefixed(what: object) -> Iterator[None]:
    """Prefix a ValueError with what it is about."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error


def require_extra(module: str, extra: str, what: str) -> None:
    """Raise ValueError with an installation hint if a module is missing."""
    remedy = f"{module} to be installed (pip install {module}, or the extra '{extra}')"
    require(find_spec(module) is not None, what, remedy, "none")


def missing_ros() -> str:
    """Return why this Python cannot run nodes, with a remedy; empty if it can. This does not import ROS."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    interfaces = find_spec("rkhs_interfaces")  # its origin is None for the folder of the sources
    if find_spec("rclpy") and interfaces and f"/python{version}/" in (interfaces.origin or ""):
        return ""
    return f"no rclpy and rkhs_interfaces for Python {version} (run 'make build', then 'source setup.bash')"


def require_ros(what: str) -> None:
    """Raise ValueError with a remedy if this Python cannot run nodes."""
    missing = missing_ros()
    require(not missing, what, "ROS 2 Jazzy and the built interfaces", missing)


def pick(name: str, table: Mapping[str, T], kind: str) -> T:
    """Return the entry with a name."""
    if name not in table:
        raise ValueError(f"unknown {kind} '{truncated(name)}', {hint(name, table)}")
    return table[name]


def hint(name: str, known: Mapping[str, Any], path: str = "") -> str:
    """Return "did you mean 'x'?" for similar names, or list the known names if they are few.

    ``path`` is the prefix of the suggested names.
    """
    if near := nearest(name, known):
        return f"did you mean {' or '.join(repr(path + each) for each in near)}?"
    if not known:
        return "there are none here"
    return f"known: {', '.join(sorted(known))}" if len(known) <= MOST_LISTED else f"none of {len(known)} is similar"


def nearest(name: str, known: Mapping[str, Any]) -> list[str]:
    """Return the known names that begin or end with a name, or the most similar one."""
    word = truncated(name)
    parts = sorted(each for each in known if word and (each.startswith(word) or each.endswith(f"_{word}")))
    plain = {each.lower(): each for each in known}
    return parts[:MOST_MEANT] or [plain[each] for each in get_close_matches(word.lower(), plain, n=1)]


class NamedFields:
    """Base class of dataclasses that suggest a name for an unknown keyword."""

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Raise TypeError for a keyword that is not a field."""
        known = {f.name: f for f in fields(cls) if f.init}  # type: ignore[arg-type]  # a subclass is a dataclass
        for name in kwargs:
            if name not in known:
                raise TypeError(f"{cls.__name__}: unknown setting '{truncated(name)}', {hint(name, known)}")
        return super().__new__(cls)


def numbers(*counts: int) -> str:
    """Return "1 number" or "1 or 4 numbers" for the allowed counts, without repetition."""
    each = sorted(set(counts))
    return f"{' or '.join(map(str, each))} number{'s' * (each[-1] != 1)}"


def all_finite(array: NDArray[np.float64]) -> bool:
    """Return whether all numbers are finite, in one pass if the sum of their squares is finite."""
    return isfinite(np.vdot(array, array)) or bool(np.isfinite(array).all())


def all_within(array: NDArray[np.float64], limit: float) -> bool:
    """Return whether no magnitude exceeds the limit; nan does. One pass if the sum of squares is below its square."""
    return bool(np.vdot(array, array) <= limit**2) or bool((np.abs(array) <= limit).all())


def require_finite(array: NDArray[np.float64], what: str) -> None:
    """Raise ValueError if a number is not finite."""
    if not all_finite(array):
        raise ValueError(f"{what}: expected finite numbers, got nan or infinity")


def finite_array(values: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """Return the values as a read-only, C-contiguous array of a shape.

    Raises:
        ValueError: the number of values is wrong, or a value is not a finite real number.
    """
    kind = np.asarray(values).dtype
    require(kind.kind in REAL_KINDS, what, "real numbers", kind)
    array = np.array(values, dtype=np.float64, order="C")  # another memory order would change the last bits of products
    if array.size != prod(shape):
        raise ValueError(f"{what}: expected {shape} values, got {array.shape}")
    require_finite(array, what)
    array = array.reshape(shape)
    array.setflags(write=False)
    return array
