"""Refusals that say what was expected, what was got, and what may have been meant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from math import prod
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

T = TypeVar("T")
REAL_KINDS = "buif"  # of numpy types, for truth values and numbers; what text and dates stand for is not guessed
LARGEST = 1e100  # observation or reward: products of a few of them are still finite
MOST_LISTED, MOST_MEANT = 30, 3  # names in a refusal
MOST_SHOWN = 200  # characters of what was got


def shown(value: object) -> str:
    """Return a value as one line, cut where it is long: it may come from anybody."""
    text = str(value)
    line = " ".join(text[: 2 * MOST_SHOWN].split())
    return "".join(c if c.isprintable() else "?" for c in line)[:MOST_SHOWN] + "..." * (len(line) > MOST_SHOWN)


def require(condition: bool, what: str, expected: str, got: object) -> None:
    """Raise ValueError "what: expected ..., got ..." unless the condition holds."""
    if not condition:
        raise ValueError(f"{what}: expected {expected}, got {shown(got)}")


def pick(name: str, table: Mapping[str, T], kind: str) -> T:
    """Return the entry of that name.

    Raises:
        ValueError: the name is unknown; the message offers the nearest one.
    """
    if name not in table:
        raise ValueError(f"unknown {kind} '{shown(name)}', {hint(name, table)}")
    return table[name]


def hint(name: str, known: Mapping[str, Any], path: str = "") -> str:
    """Return "did you mean 'x'?" for names that begin alike, or the nearest one, else the names if they are few.

    Args:
        name: the unknown one.
        known: those that there are.
        path: what goes before each of them where it is meant.
    """
    begun = sorted(each for each in known if name and each.startswith(name))
    near = begun[:MOST_MEANT] or _like(shown(name), known)
    if near:
        return f"did you mean {' or '.join(repr(path + each) for each in near)}?"
    if not known:
        return "there are none here"
    return f"known: {', '.join(sorted(known))}" if len(known) <= MOST_LISTED else f"none of {len(known)} is like it"


def _like(name: str, known: Iterable[str]) -> list[str]:
    """Return names of which this is the last word, or that differ in case and punctuation only, and the nearest one."""
    plain = {each: _plain(each) for each in known}
    same = [each for each in sorted(plain) if name and (each.endswith(f"_{name}") or plain[each] == _plain(name))]
    return list(dict.fromkeys([*same[:MOST_MEANT], *get_close_matches(name, plain, n=1)]))


def _plain(name: str) -> str:
    return "".join(filter(str.isalnum, name)).lower()


def numbers(*counts: int) -> str:
    """Return "1 number" or "1 or 4 numbers": what was expected where the counts are allowed, each said once."""
    each = sorted(set(counts))
    return f"{' or '.join(map(str, each))} number{'s' * (each[-1] != 1)}"


def require_finite(array: NDArray[np.float64], what: str) -> None:
    """Raise ValueError where a number is not finite."""
    if not np.isfinite(array).all():
        raise ValueError(f"{what}: expected finite numbers, got nan or infinity")


def finite_array(values: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """Return the values as a read-only array of that shape, row by row in memory.

    Raises:
        ValueError: another number of values, some that are not finite, or something else than real numbers.
    """
    kind = np.asarray(values).dtype
    require(kind.kind in REAL_KINDS, what, "real numbers", kind)
    array = np.array(values, dtype=np.float64, order="C")  # the memory order would change last bits of products
    if array.size != prod(shape):
        raise ValueError(f"{what}: expected {shape} values, got {array.shape}")
    require_finite(array, what)
    array = array.reshape(shape)
    array.setflags(write=False)
    return array
