"""The model learns from few ends where the task terminates episodes."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.learning.model.termination import Limits, fit_termination
from rkhs_ros.learning.model.transitions import Transitions
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.posterior import Posterior

CENTRES = 40


def drawn(limits: Limits | Posterior | None, count: int = 200) -> Array:
    """Return limits of that many draws, shape (count, 2, q)."""
    assert isinstance(limits, Limits)
    rng = np.random.default_rng(0)
    return np.stack([limits.draw(rng) for _ in range(count)])


def is_beyond(limits: Array, points: Array) -> Array:
    """Return whether points, shape (n, q), are beyond the limits of a draw, shape (2, q)."""
    return np.asarray(((points < limits[0]) | (points > limits[1])).any(axis=1))


@given(st.lists(st.booleans(), min_size=1), st.integers(1, 30))
def test_thinned_transitions_are_evenly_spaced_and_keep_all_ends(ended: list[bool], most: int) -> None:
    terminated, numbers = np.array(ended), np.arange(float(len(ended)))
    rows = numbers[:, None]
    kept = Transitions(rows, rows, rows, rows, numbers, terminated).thinned(most)
    spaced = {number for number in numbers if number % np.ceil(len(ended) / most) == 0}
    assert len(spaced) <= most
    assert kept.rewards.tolist() == sorted(spaced | set(numbers[terminated]))
    assert kept.terminated.sum() == terminated.sum()


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_every_draw_explains_all_ends_and_no_other_observation(seed: int, dimension: int) -> None:
    rng = np.random.default_rng(seed)
    before, after = rng.normal(size=(2, 30, dimension))
    ended = (after[:, 0] > before[:, 0].max()) | (after[:, -1] < before[:, -1].min())
    limits = fit_termination(before, after, ended, CENTRES)
    if not ended.any():
        assert limits is None
        return
    for draw in drawn(limits, 20):
        np.testing.assert_array_equal(is_beyond(draw, after), ended)
        assert not is_beyond(draw, before).any()


def test_draws_differ_while_one_end_leaves_open_which_feature_explains_it() -> None:
    before = np.random.default_rng(0).uniform(-1.0, 1.0, (10, 3))
    fall = np.array([[2.0, -3.0, 0.0]])  # the third feature is within the range
    draws = drawn(Limits.of(fall, before))
    upper, lower = np.isfinite(draws[:, 1, 0]), np.isfinite(draws[:, 0, 1])
    assert (upper ^ lower).all()  # one feature is enough
    assert 0.4 < upper.mean() < 0.6
    values = draws[upper, 1, 0]
    assert before[:, 0].max() < values.min() < 1.1 < 1.9 < values.max() < 2.0
    assert np.isfinite(draws).sum() == len(draws)


def test_a_second_end_reveals_the_feature() -> None:
    before = np.random.default_rng(0).uniform(-1.0, 1.0, (10, 3))
    draws = drawn(Limits.of(np.array([[2.0, -3.0, 0.0], [-2.0, 0.0, 0.5]]), before))
    np.testing.assert_array_equal(np.isfinite(draws).all(axis=0), [[True, False, False], [True, False, False]])


def test_ends_that_no_single_feature_explains_are_explained_by_several() -> None:
    before = np.random.default_rng(0).uniform(-1.0, 1.0, (10, 2))
    draws = drawn(Limits.of(np.array([[2.0, 0.0], [3.0, 0.5], [0.0, 2.0]]), before))
    np.testing.assert_array_equal(np.isfinite(draws).all(axis=0), [[False, False], [True, True]])


@pytest.mark.parametrize("seed", range(3))
def test_ends_within_the_range_of_the_others_are_learnt_by_a_regression(seed: int) -> None:
    """Terminate within a disc, which no limit of a feature explains.

    Equal weights of all steps miss more ends, and equal weights of both classes end more of the other steps.
    """
    rng = np.random.default_rng(seed)
    before, after = rng.uniform(-2.0, 2.0, (2, 2000, 2))
    ended = np.hypot(*after.T) < 0.5
    new = rng.uniform(-2.0, 2.0, (2000, 2))
    truth = np.hypot(*new.T) < 0.5

    def errors(fit: Limits | Posterior | None) -> tuple[float, float]:
        assert isinstance(fit, Posterior)
        predicted = fit.mean(new)[:, 0] > 0
        return float(predicted[~truth].mean()), float((~predicted)[truth].mean())

    balanced = np.where(ended, 0.5 / ended.sum(), 0.5 / (~ended).sum()) * len(ended)
    targets = np.where(ended, 1.0, -1.0)[:, None]
    ends_others, misses = errors(fit_termination(before, after, ended, CENTRES))
    assert ends_others < 0.03 < errors(Posterior.fit(after, targets, CENTRES, balanced))[0]
    assert misses < 0.005 < errors(Posterior.fit(after, targets, CENTRES))[1]


def test_if_every_step_is_terminal_every_observation_is() -> None:
    before, after = np.random.default_rng(0).normal(size=(2, 5, 2))
    fit = fit_termination(before, 10.0 * after, np.ones(5, dtype=bool), CENTRES)
    assert isinstance(fit, Posterior)
    assert (fit.mean(before) > 0).all()
