from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.learning.episodes import Episodes, Execution
from rkhs_ros.policies.inputs import Inputs


def episodes_of(rewards: np.ndarray, ends: np.ndarray) -> Episodes:
    n, horizon = rewards.shape
    mask = np.arange(horizon) < ends[:, None]
    steps = np.arange(n * horizon, dtype=float).reshape(n, horizon, 1)
    return Episodes.without_ends(steps, -steps, np.where(mask, rewards, 0.0), mask)


@given(n=st.integers(1, 5), horizon=st.integers(1, 12), discount=st.floats(0, 1), seed=st.integers(0, 999))
def test_rewards_to_go_and_returns_match_their_sums(n: int, horizon: int, discount: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    episodes = episodes_of(rng.normal(size=(n, horizon)), rng.integers(1, horizon + 1, n))
    to_go = episodes.rewards_to_go(discount)
    for i in range(n):
        for t in range(horizon):
            expected = sum(discount ** (k - t) * episodes.rewards[i, k] for k in range(t, horizon))
            assert to_go[i, t] == pytest.approx(expected, abs=1e-12)
    np.testing.assert_allclose(episodes.returns(discount), to_go[:, 0], atol=1e-12)


@given(
    n=st.integers(1, 4),
    horizon=st.integers(1, 9),
    discount=st.floats(0, 1),
    trace=st.floats(0, 1),
    seed=st.integers(0, 999),
)
def test_lambda_returns_are_mixtures_of_n_step_returns(
    n: int, horizon: int, discount: float, trace: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    episodes = episodes_of(rng.normal(size=(n, horizon)), rng.integers(1, horizon + 1, n))
    value = np.where(episodes.mask, rng.normal(size=(n, horizon)), 0.0)
    got = episodes.lambda_returns(value, discount, trace)
    for i in range(n):
        end = int(episodes.mask[i].sum())
        for t in range(end):
            # k rewards and then the value; the last of these returns has the remaining weight.
            after = [
                sum(discount**j * episodes.rewards[i, t + j] for j in range(k))
                + (discount**k * value[i, t + k] if t + k < end else 0.0)
                for k in range(1, end - t + 1)
            ]
            mixture = (
                sum((1 - trace) * trace**k * r for k, r in enumerate(after[:-1])) + trace ** (end - t - 1) * after[-1]
            )
            assert got[i, t] == pytest.approx(mixture, abs=1e-9)


def test_samples_are_the_steps_before_the_end_of_an_episode() -> None:
    episodes = episodes_of(np.ones((3, 4)), np.array([4, 1, 2]))
    assert episodes.steps.tolist() == [0, 1, 2, 3, 0, 0, 1]
    assert episodes.flat(episodes.observations)[:, 0].tolist() == [0, 1, 2, 3, 4, 8, 9]
    assert episodes.flat(episodes.rewards_to_go(1.0)).tolist() == [4, 3, 2, 1, 1, 2, 1]
    assert episodes.returns(1.0).tolist() == [4, 1, 2]


@pytest.mark.parametrize("wrong", ["actions", "mask", "terminated"])
def test_arrays_of_different_lengths_are_rejected(wrong: str) -> None:
    good = {
        "observations": np.zeros((2, 3, 1)),
        "actions": np.zeros((2, 3, 1)),
        "rewards": np.zeros((2, 3)),
        "mask": np.ones((2, 3), dtype=bool),
        "final_observations": np.zeros((2, 1)),
        "terminated": np.zeros(2, dtype=bool),
    }
    short = good[wrong][:, :2] if wrong in ("observations", "actions", "mask") else good[wrong][:1]
    with pytest.raises(ValueError, match=f"episodes' {wrong}: expected"):
        Episodes(**{**good, wrong: short})


@given(ends=st.lists(st.integers(1, 6), min_size=0, max_size=5))
def test_begins_are_the_first_samples_of_each_episode(ends: list[int]) -> None:
    episodes = episodes_of(np.ones((len(ends), 6)), np.array(ends, dtype=int))
    numbers = episodes.flat(np.broadcast_to(np.arange(len(ends))[:, None], (len(ends), 6))).tolist()
    assert episodes.begins.tolist() == [numbers.index(number) for number in range(len(ends))]


def random_episodes(seed: int, n: int) -> Episodes:
    rng = np.random.default_rng(seed)
    observations, actions = rng.normal(size=(n, 5, 2)), rng.normal(size=(n, 5, 1))
    return Episodes.without_ends(observations, actions, rng.normal(size=(n, 5)), rng.uniform(size=(n, 5)) > 0.5)


NAMES = ("observations", "actions", "rewards", "mask")


@given(n=st.integers(0, 4), m=st.integers(0, 4), seed=st.integers(0, 999))
def test_adding_episodes_concatenates_them(n: int, m: int, seed: int) -> None:
    one, other = random_episodes(seed, n), random_episodes(seed + 1, m)
    together = one + other
    assert len(together) == n + m
    for name in NAMES:
        assert np.array_equal(getattr(together.take(slice(n)), name), getattr(one, name))
        assert np.array_equal(getattr(together.take(slice(n, None)), name), getattr(other, name))


def test_with_inputs_replaces_only_the_observations() -> None:
    episodes, inputs = random_episodes(0, 3), Inputs(history=2, angles=(0.0,))
    converted = episodes.with_inputs(inputs)
    assert np.array_equal(converted.observations, inputs.unfold(episodes.observations, episodes.actions))
    assert converted.observations.shape == (3, 5, inputs.dimension(2, 1))
    assert all(np.array_equal(getattr(converted, name), getattr(episodes, name)) for name in NAMES[1:])
    assert np.array_equal(episodes.with_inputs(Inputs()).observations, episodes.observations)


@pytest.mark.parametrize("inputs", [Inputs(), Inputs(history=3, degree=2)], ids=str)
def test_inputs_are_contiguous_in_memory(inputs: Inputs) -> None:
    converted = random_episodes(0, 6).with_inputs(inputs)
    assert converted.observations.flags.c_contiguous
    assert converted.take(np.array([4, 1])).observations.flags.c_contiguous


def test_episodes_are_concatenated_in_order() -> None:
    parts = [episodes_of(np.full((n, 4), float(n)), np.full(n, 2)) for n in (1, 3, 2)]
    joined = Episodes.concatenate(iter(parts))
    assert joined.rewards[:, 0].tolist() == [1.0, 3.0, 3.0, 3.0, 2.0, 2.0]
    for name in ("observations", "actions", "rewards", "mask", "final_observations", "terminated"):
        expected = getattr(parts[0] + parts[1] + parts[2], name)
        assert getattr(joined, name).tobytes() == expected.tobytes()
    assert Episodes.concatenate(parts[:1]) is parts[0]
    with pytest.raises(ValueError, match="expected at least one part to join, got none"):
        Episodes.concatenate([])
    with pytest.raises(ValueError, match="dimension"):
        Episodes.concatenate([parts[0], episodes_of(np.ones((1, 5)), np.array([5]))])


TWO_STEPS = Execution(np.arange(3), np.zeros((2, 1)), np.zeros(2, dtype=np.uint32))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stamps": np.arange(2)}, "execution's stamps: expected 3, one more than steps, got 2"),
        ({"stamps": np.arange(4)}, "execution's stamps: expected 3, one more than steps, got 4"),
        ({"executed": np.zeros((1, 1))}, "executed commands: expected 2, one per step, got 1"),
    ],
)
def test_an_execution_has_one_more_stamp_than_steps_and_commands(changes: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(TWO_STEPS, **changes)
