"""Changes of observations: angles and circles are periodic, other columns have plain differences."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

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
    positions_and_pressure = np.array([4e5, 5.4e6, 0.0, 101325.0, 0.0])
    far = positions_and_pressure + rng.uniform(-1.0, 1.0, (200, 5))
    assert StateCoordinates.of(far).circles == ()


@pytest.mark.parametrize(
    ("count", "spread", "is_circle"), [(9, 0, False), (11, 0, True), (50, 8e-5, True), (50, 1.25e-4, False)]
)
def test_a_circle_has_ten_points_and_a_constant_radius(count: int, spread: float, is_circle: bool) -> None:
    points = on_circle(np.linspace(0.1, 1.5, count)) * np.sqrt(1.0 + np.linspace(0.0, spread, count))[:, None]
    assert StateCoordinates.of(points).circles == (((0, 1),) if is_circle else ())


@pytest.mark.parametrize(("spread", "is_circle"), [(3.3e-5, True), (4.8e-5, False)])
def test_a_radius_is_constant_relative_to_the_part_of_a_circle(spread: float, is_circle: bool) -> None:
    points = on_circle(np.linspace(-0.02, 0.02, 50) + np.pi / 2) * np.sqrt(1.0 + np.linspace(0.0, spread, 50))[:, None]
    assert StateCoordinates.of(points).circles == (((0, 1),) if is_circle else ())


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


TURN_SIZES = st.sampled_from([360.0, 1.0, 6400.0])


@given(seed=st.integers(0, 1000), turn=TURN_SIZES)
def test_coordinates_of_angles_in_other_units_agree_with_those_in_radians(seed: int, turn: float) -> None:
    rng, scale = np.random.default_rng(seed), np.array([1.0, 1.0, 1.0, turn / RADIANS])
    before, after = observed(rng, 30), observed(rng, 30)
    radians = StateCoordinates.of(before, Inputs(angles=(3.0,)))
    other = StateCoordinates.of(scale * before, Inputs(angles=(3.0,), turns=(turn,)))
    assert (other.circles, other.columns, other.periodic) == (radians.circles, radians.columns, radians.periodic)
    changes = radians.difference(before, after)
    np.testing.assert_allclose(other.difference(scale * before, scale * after), scale * changes, atol=1e-9 * turn)
    kicks = rng.normal(size=before.shape)
    moved = other.add(scale * before, scale * kicks) / scale
    np.testing.assert_allclose(on_the_unit_circle(moved), on_the_unit_circle(radians.add(before, kicks)), atol=1e-9)
    assert (np.abs(other.add(scale * before, 10.0 * scale * kicks)[:, 3]) <= 0.5 * turn).all()


def on_the_unit_circle(points: np.ndarray) -> np.ndarray:
    """Return observations with their angle, column 3, as a cosine and a sine: both ends of a turn are equal."""
    return np.column_stack([points[:, :3], on_circle(points[:, 3])])


@given(seed=st.integers(0, 1000), turn=TURN_SIZES)
def test_angles_of_different_units_wrap_at_their_own_turn(seed: int, turn: float) -> None:
    rng = np.random.default_rng(seed)
    coordinates = StateCoordinates(3, [2, 0], np.array([turn, RADIANS]))
    before, changes = rng.normal(size=(2, 20, 3))
    whole = rng.integers(-2, 3, (20, 2)) * [RADIANS, turn]
    turned = before.copy()
    turned[:, [0, 2]] += whole
    expected = coordinates.difference(before, before + changes)
    np.testing.assert_allclose(coordinates.difference(turned, before + changes), expected, atol=1e-9 * turn)
    assert np.array_equal(expected[:, 1], ((before + changes) - before)[:, 1])
