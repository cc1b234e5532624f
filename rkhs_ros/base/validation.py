"""Refusals that say what was expected, what was got, and what may have been meant."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from math import prod
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

T = TypeVar("T")
REAL_KINDS = "buif"  # of numpy types, for truth values and numbers; what text and dates stand for is not guessed
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


def hint(name: str, known: Mapping[str, Any]) -> str:
    """Return "did you mean 'x'?" for names that begin alike, or the nearest one, else the names if they are few."""
    begun = sorted(each for each in known if name and each.startswith(name))
    near = begun[:MOST_MEANT] or get_close_matches(shown(name), known, n=1)
    if near:
        return f"did you mean {' or '.join(map(repr, near))}?"
    return f"known: {', '.join(sorted(known))}" if len(known) <= MOST_LISTED else f"none of {len(known)} is like it"


def numbers(*counts: int) -> str:
    """Return "1 number" or "1 or 4 numbers": what was expected where the counts are allowed, each said once."""
    each = sorted(set(counts))
    return f"{' or '.join(map(str, each))} number{'s' * (each[-1] != 1)}"


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
    if not np.isfinite(array).all():
        raise ValueError(f"{what}: expected finite numbers, got nan or infinity")
    array = array.reshape(shape)
    array.setflags(write=False)
    return array
