"""Columns that wrap around are found with the value of a full turn; other columns are not."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.learning.discovery import TURNS, with_angles, with_wrapped_angles
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.rkhs.kernels import Array

COUNT, HORIZON = 4, 100
SEEDS = st.integers(0, 999)
SIZES = st.floats(1e-3, 1e4)
FULL = 2.0 * np.pi


def episodes_of(*columns: Array) -> Episodes:
    """Return episodes whose observations have the given columns, each of shape (count, horizon + 1)."""
    observed = np.stack(columns, axis=2)
    count, horizon = observed.shape[0], observed.shape[1] - 1
    zeros = np.zeros((count, horizon))
    mask = np.ones((count, horizon), dtype=bool)
    return Episodes(observed[:, :-1], zeros[:, :, None], zeros, mask, observed[:, -1], mask[:, 0] & False)


def counted_turns(seed: int) -> Array:
    """Return smooth rotations in turns that are not wrapped, each of at least two turns."""
    rng = np.random.default_rng(seed)
    kicks = 0.02 * rng.standard_normal((COUNT, HORIZON + 1))
    rates = 0.03 + 0.02 * np.tanh(np.cumsum(kicks, axis=1))
    return np.asarray(rng.random((COUNT, 1)) + np.cumsum(rates, axis=1))


def smooth(seed: int) -> Array:
    walk = np.cumsum(np.random.default_rng(seed).standard_normal((COUNT, HORIZON + 1)), axis=1)
    return np.asarray((walk - walk.mean()) / walk.std())


def found(*columns: Array) -> dict[int, float]:
    """Return the value of a full turn of each column that is found to be an angle."""
    inputs = with_wrapped_angles(Inputs(), episodes_of(*columns))
    return dict(zip(inputs.columns, inputs.full_turns.tolist(), strict=True))


@given(seed=SEEDS, turn=st.sampled_from(TURNS), lowest=st.sampled_from([-0.5, 0.0]), shift=st.floats(-3.0, 3.0))
def test_wrapped_columns_are_found_with_their_turn(seed: int, turn: float, lowest: float, shift: float) -> None:
    wrapped = turn * ((counted_turns(seed) % 1.0) + lowest)
    expected = {1: pytest.approx(turn)}
    for column in (wrapped, wrapped + shift * turn, wrapped.astype(np.float32).astype(float), -wrapped):
        assert found(smooth(seed), column) == expected


@given(seed=SEEDS, turn=st.sampled_from(TURNS))
def test_wrapped_columns_are_found_despite_noise(seed: int, turn: float) -> None:
    noise = 0.01 * np.random.default_rng(seed).standard_normal((COUNT, HORIZON + 1))
    assert found(turn * (counted_turns(seed) % 1.0 + noise)) == {0: pytest.approx(turn)}  # noise after wrapping
    assert found(turn * ((counted_turns(seed) + noise) % 1.0)) == {0: pytest.approx(turn)}


@given(seed=SEEDS, size=SIZES)
def test_other_columns_are_not_found(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((COUNT, HORIZON + 1))
    flags = (rng.random((COUNT, HORIZON + 1)) < 0.5).astype(float)
    filtered = smooth(seed)
    velocities = np.diff(filtered, axis=1, prepend=filtered[:, :1])
    columns = (filtered, velocities, noise, rng.random(noise.shape), np.ones_like(noise), np.cumsum(noise**2, axis=1))
    assert found(flags, *(size * column for column in columns)) == {}
    assert found(size * (2.0 * np.pi * filtered + 100.0)) == {}


@given(seed=SEEDS, size=st.sampled_from([0.01, 0.05, 0.5, 1.0, 5.0, 10.0, 100.0, 1000.0]))
def test_velocities_that_change_their_sign_at_a_bounce_are_not_found(seed: int, size: float) -> None:
    """Use sizes whose double is not about a turn of a usual unit; such a velocity cannot be told from an angle."""
    signs = np.cumprod(np.where(np.random.default_rng(seed).random((COUNT, HORIZON + 1)) < 0.1, -1.0, 1.0), axis=1)
    assert found(size * signs * (1.0 + 0.1 * np.tanh(smooth(seed)))) == {}


@given(seed=SEEDS, turn=st.sampled_from(TURNS), share=st.floats(0.92, 1.09), noise=st.sampled_from([0.0, 0.003]))
def test_a_switch_between_two_values_about_a_turn_apart_is_not_found(
    seed: int, turn: float, share: float, noise: float
) -> None:
    """Use values that differ by more than the noise modulo a turn; other values cannot be told from an angle."""
    rng = np.random.default_rng(seed)
    switched = np.cumsum(rng.random((COUNT, HORIZON + 1)) < 0.05, axis=1) % 2
    share = share if abs(share - 1.0) > 0.05 or noise == 0.0 else 0.92
    assert found(turn * (share * switched + noise * np.tanh(rng.standard_normal(switched.shape)))) == {}


def rotation(*rates: float) -> Array:
    """Return one rotation with the given rates, repeated, in turns that are not wrapped."""
    return np.cumsum(np.resize(rates, (1, HORIZON + 1)), axis=1)


@pytest.mark.parametrize(
    ("turns", "is_angle"),
    [
        (rotation(0.13) % 1.0, True),  # turns per step
        (rotation(0.17) % 1.0, False),
        (rotation(*[0.03] * 30, 0.2, 0.35) % 1.0, True),  # the longest step
        (rotation(*[0.03] * 30, 0.2, 0.45) % 1.0, False),
        (rotation(*[0.02] * 48, 0.05) % 1.0, True),  # the step that wraps, relative to the others
        (rotation(*[0.02] * 47, 0.07) % 1.0, False),
        (rotation(0.1) % 1.07, True),  # a range of more than a turn, as noise may cause
        (rotation(0.1) % 1.2, False),
    ],
)
def test_an_angle_moves_in_short_steps_within_one_turn(turns: Array, is_angle: bool) -> None:
    assert bool(found(FULL * turns)) == is_angle


def test_an_angle_that_does_not_wrap_in_the_data_is_not_found() -> None:
    assert found(FULL * (0.2 * np.tanh(smooth(0)) + 0.5)) == {}
    assert found(FULL * counted_turns(0)) == {}


@given(seed=SEEDS)
def test_known_angles_keep_their_turn(seed: int) -> None:
    wrapped = 360.0 * (counted_turns(seed) % 1.0)
    known = Inputs(history=2, angles=(2.0, 0.0), turns=(7.0, 5.0))
    inputs = with_wrapped_angles(known, episodes_of(smooth(seed), wrapped, wrapped))
    assert inputs.history == 2
    assert dict(zip(inputs.columns, inputs.turns, strict=True)) == {0: 5.0, 1: 360.0, 2: 7.0}
    radians = with_wrapped_angles(Inputs(angles=(0.0,)), episodes_of(wrapped, wrapped))
    assert dict(zip(radians.columns, radians.turns, strict=True)) == {0: FULL, 1: 360.0}
    nothing_new = Inputs(angles=(1.0,))
    assert with_wrapped_angles(nothing_new, episodes_of(smooth(seed), wrapped)) is nothing_new


def test_angles_are_listed_in_the_order_of_the_columns() -> None:
    inputs = with_angles(Inputs(), {3: 360.0, 1: FULL})
    assert (inputs.angles, inputs.turns) == ((1.0, 3.0), (FULL, 360.0))
    assert with_angles(inputs, {1: FULL, 3: 360.0}) is inputs


@given(seed=SEEDS)
def test_steps_end_with_their_episode(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 6, 3)
    mask = np.arange(5) < lengths[:, None]
    observed, final = rng.normal(size=(3, 5, 2)) * mask[:, :, None], rng.normal(size=(3, 2))
    zeros = np.zeros((3, 5))
    episodes = Episodes(observed, zeros[:, :, None], zeros, mask, final, mask[:, 0] & False)
    before, after = episodes.flat(episodes.observations), episodes.flat(episodes.next_observations)
    each = zip(observed, lengths, final, strict=True)
    expected = [(o[t], o[t + 1] if t + 1 < n else end) for o, n, end in each for t in range(n)]
    assert np.array_equal(before, [step[0] for step in expected])
    assert np.array_equal(after, [step[1] for step in expected])
