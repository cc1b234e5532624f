"""Changes of observations: angles and circles are periodic, other columns have plain differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rkhs_ros.learning.model.state_coordinates import RADIANS, StateCoordinates
from rkhs_ros.policies.inputs import Inputs


def on_circle(angles: np.ndarray, radius: float = 1.0) -> np.ndarray:
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def observed(rng: np.random.Generator, n: int = 50, radius: float = 1.0) -> np.ndarray:
    """Return observations with a cosine, a number, a sine and an angle."""
    cosine, sine = on_circle(rng.uniform(-np.pi, np.pi, n), radius).T
    return np.column_stack([cosine, rng.normal(size=n), sine, rng.uniform(-np.pi, np.pi, n)])


def test_circles_are_detected(rng: np.random.Generator) -> None:
    coordinates = StateCoordinates.of(observed(rng).astype(np.float32).astype(float), Inputs(angles=(3.0,)))
    assert coordinates.circles == ((0, 2),)
    assert coordinates.columns == [0, 1, 3]
    assert sorted(coordinates.periodic) == [0, 2, 3]


def test_two_circles_are_distinguished(rng: np.random.Generator) -> None:
    one, other = (on_circle(rng.uniform(-3, 3, 50)) for _ in range(2))
    observations = np.column_stack([one[:, 0], other[:, 0], one[:, 1], other[:, 1]])
    assert StateCoordinates.of(observations).circles == ((0, 2), (1, 3))


@pytest.mark.parametrize("size", [1024.0, 1 / 1024])
def test_circles_are_detected_in_any_units(rng: np.random.Generator, size: float) -> None:
    before, after = observed(rng), observed(rng)
    plain, scaled = StateCoordinates.of(before), StateCoordinates.of(size * before)
    assert plain.circles == scaled.circles == ((0, 2),)
    change = plain.difference(before, after)
    np.testing.assert_array_equal(scaled.difference(size * before, size * after)[:, [0, 2]], change[:, [0, 2]])


def test_pairs_that_are_not_circles_are_not_detected(rng: np.random.Generator) -> None:
    flags = np.eye(2)[rng.integers(2, size=50)]
    assert StateCoordinates.of(flags).circles == ()
    near = on_circle(rng.uniform(-3, 3, 200)) * rng.uniform(0.999, 1.001, (200, 1))
    assert StateCoordinates.of(near).circles == ()
    assert StateCoordinates.of(np.ones((50, 2))).circles == ()


@given(seed=st.integers(0, 1000))
def test_add_inverts_difference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, after = observed(rng, 20), observed(rng, 20)
    coordinates = StateCoordinates(4, [3], np.array([RADIANS]), ((0, 2),))
    changes = coordinates.difference(before, after)
    assert (np.abs(changes[:, [0, 3]]) <= np.pi).all()
    np.testing.assert_array_equal(changes[:, 2], 0.0)
    np.testing.assert_allclose(coordinates.add(before, changes), after, atol=1e-12)


def test_changed_observations_stay_on_their_circle(rng: np.random.Generator) -> None:
    now, coordinates = observed(rng), StateCoordinates(4, [3], np.array([RADIANS]), ((0, 2),))
    for _ in range(1000):
        now = coordinates.add(now, rng.normal(size=now.shape))
    np.testing.assert_allclose(np.hypot(now[:, 0], now[:, 2]), 1.0, atol=1e-12)
    assert (np.abs(now[:, 3]) <= np.pi).all()
