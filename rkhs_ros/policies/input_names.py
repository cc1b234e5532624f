"""What the numbers that a policy sees and commands are called."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

from rkhs_ros.policies.inputs import Inputs

UNIT = re.compile(r"\s*\([^()]*\)$")


@dataclass(frozen=True)
class Names:
    """What the numbers of a task are called, with their units.

    Attributes:
        observations: of each number of an observation.
        actions: of each number of an action.
    """

    observations: tuple[str, ...]
    actions: tuple[str, ...]


def plain_names(kind: str, count: int) -> tuple[str, ...]:
    """Return what some numbers are called of which no more is known: "observation 0" etc."""
    return tuple(f"{kind} {i}" if count > 1 else kind for i in range(count))


def reported_names(said: object, count: int) -> tuple[str, ...]:
    """Return what somebody's code calls some numbers, if that is as many names; else none."""
    good = isinstance(said, list | tuple) and len(said) == count and all(isinstance(name, str) for name in said)
    return tuple(said) if good else ()  # type: ignore[arg-type]


def input_names(inputs: Inputs, names: Names) -> tuple[str, ...]:
    """Return what the policy's inputs are made of, in their order."""
    seen = _turned(names.observations, inputs.columns)
    if inputs.history > 1:
        ages = range(inputs.history - 1, -1, -1)
        seen = [name for ago in ages for name in [*_aged(seen, ago), *_aged(names.actions, ago + 1)]]
    if inputs.degree == 0:
        return tuple(seen)
    chosen = combinations_with_replacement(range(len(seen) + 1), inputs.degree)
    return tuple(" · ".join(seen[i] for i in columns if i < len(seen)) or "constant" for columns in chosen)


def _turned(observations: Sequence[str], angles: Sequence[int]) -> list[str]:
    turned = [UNIT.sub("", observations[column]) for column in angles]
    rest = [name for column, name in enumerate(observations) if column not in angles]
    return [f"{function} of {name}" for function in ("sine", "cosine") for name in turned] + rest


def _aged(names: Sequence[str], ago: int) -> list[str]:
    return [f"{name}, {ago} step{'s' * (ago > 1)} ago" for name in names] if ago else list(names)
