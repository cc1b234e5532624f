"""Select the two inputs that explain most of an action."""

from itertools import product

import numpy as np
import pytest

from rkhs_ros.pictures.policy_coordinates import most_informative_inputs, on_slice


def test_a_slice_of_independent_inputs_explains_the_variance_of_its_inputs() -> None:
    corners = np.array(list(product([-1.0, 1.0], repeat=3)))
    best = most_informative_inputs(lambda x: x @ np.array([2.0, 1.0, 3.0]), corners)
    assert best.columns == (0, 2)
    assert best.explained == pytest.approx(13 / 14)  # the inputs contribute variances 4, 1 and 9


def test_a_slice_fixes_the_other_inputs_at_their_medians() -> None:
    points = np.array([[0.0, 5.0, 1.0], [1.0, 6.0, 2.0], [8.0, 9.0, 9.0]])
    assert on_slice(points, (2, 0), np.array([[3.0, 4.0]])).tolist() == [[4.0, 6.0, 3.0]]
