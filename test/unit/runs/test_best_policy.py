"""The choice of the best policy by the lower end of an interval."""

from math import inf, nan, sqrt

import numpy as np
import pytest

from rkhs_ros.learning.iteration import Row, lower_bound
from rkhs_ros.runs.curve import BEGINNING
from rkhs_ros.runs.report import evaluation_bounds

POLICIES, EPISODES, DRAWS = 31, 5, 400


def row(evaluated: int, value: float, sd: float) -> Row:
    return BEGINNING._replace(evaluation_episodes=evaluated, evaluation_return=value, evaluation_return_sd=sd)


def test_the_bound_is_the_mean_minus_its_standard_error() -> None:
    returns = np.array([1.0, 2.0, 6.0, 3.0])
    standard_error = returns.std(ddof=1) / sqrt(len(returns))
    assert lower_bound(float(returns.mean()), float(returns.std()), 4) == pytest.approx(3.0 - standard_error)
    assert lower_bound(7.0, 0.0, 1) == 7.0


def test_lines_give_the_bounds_of_their_own_episodes() -> None:
    rows = [row(0, nan, nan), row(1, 4.0, 0.0), row(1, nan, nan), row(6, 5.0, 4.0)]
    assert evaluation_bounds(rows) == [-inf, 4.0, -inf, 5.0 - 4.0 / 2]
