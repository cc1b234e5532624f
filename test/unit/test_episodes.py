import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rkhs_ros.learning.episodes import Episodes


def episodes_of(rewards: np.ndarray, ends: np.ndarray) -> Episodes:
    n, horizon = rewards.shape
    mask = np.arange(horizon) < ends[:, None]
    steps = np.arange(n * horizon, dtype=float).reshape(n, horizon, 1)
    return Episodes(steps, -steps, np.where(mask, rewards, 0.0), mask)


@given(n=st.integers(1, 5), horizon=st.integers(1, 12), discount=st.floats(0, 1), seed=st.integers(0, 999))
def test_rewards_to_go_and_returns_are_their_sums(n: int, horizon: int, discount: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    episodes = episodes_of(rng.normal(size=(n, horizon)), rng.integers(1, horizon + 1, n))
    to_go = episodes.rewards_to_go(discount)
    for i in range(n):
        for t in range(horizon):
            expected = sum(discount ** (k - t) * episodes.rewards[i, k] for k in range(t, horizon))
            assert to_go[i, t] == pytest.approx(expected, abs=1e-12)
    np.testing.assert_allclose(episodes.returns(discount), to_go[:, 0], atol=1e-12)


def test_samples_are_the_steps_before_an_episodes_end() -> None:
    episodes = episodes_of(np.ones((3, 4)), np.array([4, 1, 2]))
    assert episodes.steps.tolist() == [0, 1, 2, 3, 0, 0, 1]
    assert episodes.flat(episodes.observations)[:, 0].tolist() == [0, 1, 2, 3, 4, 8, 9]
    assert episodes.flat(episodes.rewards_to_go(1.0)).tolist() == [4, 3, 2, 1, 1, 2, 1]
    assert episodes.returns(1.0).tolist() == [4, 1, 2]


@pytest.mark.parametrize("wrong", ["observations", "actions", "mask"])
def test_arrays_of_different_lengths_are_refused(wrong: str) -> None:
    good = {
        "observations": np.zeros((2, 3, 1)),
        "actions": np.zeros((2, 3, 1)),
        "rewards": np.zeros((2, 3)),
        "mask": np.ones((2, 3), dtype=bool),
    }
    with pytest.raises(ValueError, match=f"episodes' {wrong}: expected"):
        Episodes(**{**good, wrong: good[wrong][:, :2]})
