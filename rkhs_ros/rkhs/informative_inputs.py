"""Which two of many inputs tell most of what a policy does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from rkhs_ros.rkhs.kernels import Array

Action = Callable[[Array], Array]  # from points, shape (k, d), to one number of the actions, shape (k,)
MOST_POINTS = 200  # at which the choice is made
SHORTLIST = 20  # inputs of which all pairs are tried


class InputPair(NamedTuple):
    """A plane through the median of the points visited.

    Attributes:
        columns: the two inputs that vary on it.
        explained: share of the action's variance over the points visited that is left where all other inputs are
            held at their medians; nan where the action does not vary, less than 0 where it tells less than nothing.
    """

    columns: tuple[int, int]
    explained: float


def most_informative_inputs(action: Action, points: Array) -> InputPair:
    r"""Return the slice that explains most of an action at the points visited.

    .. math:: 1 - \frac{E (h(x) - h(m \text{ but for two columns of } x))^2}{Var\, h(x)}

    with the medians m. All pairs are tried of the inputs that explain most by themselves. Bandwidths would not do:
    they say how fast the action may vary, not how much it does.

    Args:
        action: one number of the actions.
        points: visited, shape (k, d) with d >= 2.
    """
    some = points[np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).round().astype(int)]
    alone = [_left(action, some, [i]) for i in range(points.shape[1])]
    shortlist = sorted(np.argsort(alone, kind="stable")[:SHORTLIST].tolist())
    left, columns = min((_left(action, some, pair), pair) for pair in combinations(shortlist, 2))
    variance = float(np.var(action(some)))
    return InputPair(columns, 1.0 - left / variance if variance > 0.0 else float("nan"))


def on_slice(points: Array, columns: Sequence[int], values: Array) -> Array:
    """Return points with values, shape (k, columns), in some columns, and the medians of the points in others."""
    held = np.tile(np.median(points, axis=0), (len(values), 1))
    held[:, list(columns)] = values
    return held


def _left(action: Action, points: Array, columns: Sequence[int]) -> float:
    held = on_slice(points, columns, points[:, list(columns)])
    return float(np.mean((action(points) - action(held)) ** 2))
