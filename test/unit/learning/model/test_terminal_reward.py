"""The reward of terminal steps, as a mean or as a function of where the episode ends."""

import numpy as np
import pytest

from rkhs_ros.learning.model.termination import TerminalReward

CRASH, LANDING = -100.0, 100.0


def two_kinds(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where episodes end, and +100 for slow ends and -100 for fast ones."""
    points = rng.normal(size=(count, 4))
    points[:, 0] = rng.choice([0.2, 3.0], count) + 0.1 * rng.normal(size=count)
    return points, np.where(points[:, 0] < 1.0, LANDING, CRASH)


def test_two_kinds_of_ends_are_told_apart(rng: np.random.Generator) -> None:
    points, rewards = two_kinds(rng, 30)
    terminal = TerminalReward.fit(points, rewards - 1.0, rewards, 2.0, 50)
    others, expected = two_kinds(rng, 200)
    np.testing.assert_allclose(terminal.add(np.ones(200), others), expected, atol=10.0)


def test_no_reward_is_beyond_the_observed_ones(rng: np.random.Generator) -> None:
    points, rewards = two_kinds(rng, 30)
    terminal = TerminalReward.fit(points, rewards, rewards, 2.0, 50)
    earned = terminal.add(rng.normal(scale=50.0, size=200), 10.0 * rng.normal(size=(200, 4)))
    assert (earned >= CRASH).all()
    assert (earned <= LANDING).all()


@pytest.mark.parametrize(("ordinary", "differences"), [(0.0, 0.0), (0.0, 0.09), (2.0, 1.9)])
def test_ends_that_are_alike_have_the_mean(rng: np.random.Generator, ordinary: float, differences: float) -> None:
    points, step_rewards = rng.normal(size=(30, 4)), rng.normal(size=30)
    extra = -1.0 + 0.5 * differences * np.tanh(points[:, 0])
    terminal = TerminalReward.fit(points, extra, step_rewards + extra, ordinary, 50)
    np.testing.assert_array_equal(terminal.add(step_rewards, points), step_rewards + extra.mean())
    more = -1.0 + 0.06 * np.tanh(4.0 * points[:, 0])  # 12 % of the mean
    assert TerminalReward.fit(points, more, more, 0.0, 50).posterior is not None


def test_few_ends_and_ends_without_a_pattern_have_the_mean(rng: np.random.Generator) -> None:
    few, rewards = two_kinds(rng, 4)
    assert TerminalReward.fit(few, rewards, rewards, 0.1, 50) == TerminalReward(float(rewards.mean()))
    functions = 0
    for _ in range(4):
        points, (_, rewards) = rng.normal(size=(10, 3)), two_kinds(rng, 10)
        functions += TerminalReward.fit(points, rewards, rewards, 2.0, 50).posterior is not None
    assert functions <= 1  # a pattern by chance


@pytest.mark.parametrize(
    ("count", "noise", "explained"), [(4, 0.0, False), (5, 0.0, True), (40, 15.0, True), (40, 22.0, False)]
)
def test_a_pattern_needs_five_ends_and_a_good_prediction(
    rng: np.random.Generator, count: int, noise: float, explained: bool
) -> None:
    points = rng.normal(size=(count, 1)) if noise else np.linspace(-1.0, 1.0, count)[:, None]
    extra = 50.0 * points[:, 0] + noise * rng.normal(size=count)  # errors of 0.51 and 0.68 of those of the mean
    assert (TerminalReward.fit(points, extra, extra, 1.0, 50).posterior is not None) == explained


def test_each_reward_depends_on_its_own_end_only(rng: np.random.Generator) -> None:
    points, rewards = two_kinds(rng, 30)
    terminal = TerminalReward.fit(points, rewards, rewards, 2.0, 50)
    assert terminal.posterior is not None
    ends, zeros = rng.normal(size=(9, 4)), np.zeros(9)
    each = [terminal.add(zeros[:1], end[None])[0] for end in ends]
    np.testing.assert_array_equal(terminal.add(zeros, ends), each)
    assert terminal.add(zeros[:0], ends[:0]).shape == (0,)
