"""Bounds of actions, finite and infinite."""

import numpy as np

from rkhs_ros.policies.spaces import Spaces

SPACES = Spaces((1,), np.array([-1.0, 0.0, 2.0, -np.inf]), np.array([3.0, np.inf, 2.0, np.inf]))


def test_half_the_range_of_an_action_is_1_for_infinite_and_empty_ranges() -> None:
    assert SPACES.half_ranges.tolist() == [2.0, 1.0, 1.0, 1.0]


def test_the_middle_of_a_range_is_0_for_infinite_ranges_and_left_out_for_symmetric_ones() -> None:
    assert SPACES.middle == (1.0, 0.0, 2.0, 0.0)
    assert Spaces((1,), np.array([-1.0, -np.inf]), np.array([1.0, 0.0])).middle == ()


def test_actions_are_clipped_to_their_bounds_with_and_without_a_margin() -> None:
    far = np.array([[-9.0, -9.0, -9.0, -9.0], [9.0, 9.0, 9.0, 9.0], [1.0, 1.0, 2.0, 1.0]])
    assert SPACES.clip(far).tolist() == [[-1.0, 0.0, 2.0, -9.0], [3.0, 9.0, 2.0, 9.0], [1.0, 1.0, 2.0, 1.0]]
    near = SPACES.clip_with_margin(far, np.array([0.5, 1.0, 2.0, 4.0]))
    assert near.tolist() == [[-1.5, -1.0, 0.0, -9.0], [3.5, 9.0, 4.0, 9.0], [1.0, 1.0, 2.0, 1.0]]
