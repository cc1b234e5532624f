"""Find the two inputs that explain most of a policy's action."""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from rkhs_ros.rkhs.kernels import Array

Action = Callable[[Array], Array]  # from points, shape (k, d), to one component of the actions, shape (k,)
MOST_POINTS = 200  # maximum number of points for the selection
SHORTLIST = 20  # number of inputs whose pairs are all tried


class InputPair(NamedTuple):
    """A plane through the median of the visited points.

    Attributes:
        columns: the two inputs that vary on the plane.
        explained: share of the action's variance over the visited points that remains when all other inputs are
            fixed at their medians; nan if the action is constant, negative if the plane predicts worse than the mean.
    """

    columns: tuple[int, int]
    explained: float


def most_informative_inputs(action: Action, points: Array) -> InputPair:
    r"""Return the pair of inputs that explains most of an action at the visited points.

    .. math:: 1 - \frac{E (h(x) - h(m \text{ but for two columns of } x))^2}{Var\, h(x)}

    with the medians m. All pairs of the inputs that explain most individually are tried. Bandwidths are no substitute:
    they bound how fast the action may vary, not how much it varies.

    Args:
        action: one component of the actions.
        points: visited points, shape (k, d) with d >= 2.
    """
    some = points[np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).round().astype(int)]
    alone = [_left(action, some, [i]) for i in range(points.shape[1])]
    shortlist = sorted(np.argsort(alone, kind="stable")[:SHORTLIST].tolist())
    left, columns = min((_left(action, some, pair), pair) for pair in combinations(shortlist, 2))
    variance = float(np.var(action(some)))
    return InputPair(columns, 1.0 - left / variance if variance > 0.0 else float("nan"))


def on_slice(points: Array, columns: Sequence[int], values: Array) -> Array:
    """Return points with values, shape (k, columns), in the given columns and the points' medians in all others."""
    held = np.tile(np.median(points, axis=0), (len(values), 1))
    held[:, list(columns)] = values
    return held


def _left(action: Action, points: Array, columns: Sequence[int]) -> float:
    held = on_slice(points, columns, points[:, list(columns)])
    return float(np.mean((action(points) - action(held)) ** 2))
