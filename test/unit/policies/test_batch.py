"""Batches of episodes: their numbers, seeds and splits."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.streams import TAPS, Batch, pink, stream, stream_seed
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from test.unit.conftest import random_policy
from test.unit.rollouts.test_inline_runner import ARRAYS

numbers = st.integers(0, 2**63 - 100)  # the numbers of all parts must stay below 2^63


@st.composite
def batches(draw: st.DrawFn) -> Batch:
    """Draw a batch of exploration episodes, evaluation episodes or both."""
    exploring = Batch(5, draw(numbers), draw(st.integers(1, 20)), 3, explore=True)
    evaluation = Batch(5, draw(numbers), draw(st.integers(1, 20)), 3, explore=False)
    return draw(st.sampled_from([exploring, evaluation, exploring.with_evaluation(evaluation)]))


def rows_of(parts: list[Batch]) -> Iterator[tuple[bool, int, int]]:
    for part in parts:
        yield from ((*key, seed) for key, seed in zip(part.keys, part.environment_seeds(), strict=True))


@given(batches(), st.integers(1, 50))
def test_splitting_a_batch_keeps_the_order_and_seeds_of_its_episodes(batch: Batch, count: int) -> None:
    whole = list(rows_of([batch]))
    assert len(whole) == len(set(whole)) == batch.num_envs
    for parts in (batch.split(count), batch.parts(count), [kind for kind, _ in batch.kinds]):
        assert list(rows_of(parts)) == whole
    assert max(part.num_envs for part in batch.parts(count)) <= count
    sizes = [part.num_envs for part in batch.split(count)]
    assert max(sizes) - min(sizes) <= 1


@given(batches())
def test_the_kinds_of_a_batch_cover_its_environments(batch: Batch) -> None:
    for kind, rows in batch.kinds:
        assert kind.keys == batch.keys[rows]
        assert {explore for explore, _ in kind.keys} == {kind.explore}
        assert kind.num_evaluation == 0
    draws = [kind.exploration(2) for kind, _ in batch.kinds]
    assert np.concatenate(draws).tobytes() == batch.exploration(2).tobytes()


def test_streams_have_stable_names() -> None:
    # Replaying a recording needs the same names, because other names draw other actions.
    exploring, num_evaluation = Batch(5, 10, 2, 3, explore=True), Batch(5, 7, 2, 3, explore=False)
    draws = [stream(5, "training/exploration", number).standard_normal((3, 2)) for number in (10, 11)]
    assert np.array_equal(exploring.exploration(2), draws)
    for batch, kind in ((exploring, "training"), (num_evaluation, "evaluation")):
        seeds = [stream_seed(5, f"{kind}/environment", number) for number in batch.episodes]
        assert batch.environment_seeds() == seeds


@pytest.mark.parametrize("learnt", [False, True], ids=["constant variance", "learnt variance"])
@pytest.mark.parametrize("num_envs", [0, 4])
def test_a_mixed_batch_is_bit_identical_to_separate_batches(
    rng: np.random.Generator, learnt: bool, num_envs: int
) -> None:
    runner = InlineRunner(Simulation("rkhs/Pendulum-v0", num_envs=num_envs))
    policy = random_policy(rng, n=1, m=40, learnt=learnt)
    recorded: list[Batch] = []
    runner.record = lambda batch, episodes, _: recorded.append(batch)
    exploring, num_evaluation = Batch(0, 10, 3, 30, explore=True), Batch(0, 7, 4, 30, explore=False)
    both = runner.collect(policy, exploring.with_evaluation(num_evaluation))
    assert all(batch.num_evaluation == 0 for batch in recorded)
    assert {key for batch in recorded for key in batch.keys} == {*num_evaluation.keys, *exploring.keys}
    assert num_envs or recorded == [num_evaluation, exploring]
    first, last = runner.collect(policy, exploring), runner.collect(policy, num_evaluation)
    for name in ARRAYS:
        apart = np.concatenate([getattr(first, name), getattr(last, name)])
        assert apart.tobytes() == getattr(both, name).tobytes()


def test_without_exploration_all_environments_use_the_mean(rng: np.random.Generator) -> None:
    policy: GaussianPolicy = random_policy(rng, d=2, n=1)
    both = Batch(0, 0, 2, 3, explore=True).with_evaluation(Batch(0, 0, 2, 3, explore=False))
    observed = np.ones((4, 2))
    still, moving = (Acting(policy, both, explore=explore)(0, observed) for explore in (False, True))
    assert still.tobytes() == policy.mean(observed).tobytes()
    assert (still == moving).ravel().tolist() == [False, False, True, True]


BATCH = Batch(seed=3, first_episode=5, num_envs=7, horizon=50, explore=True)


@pytest.mark.parametrize("horizon", [1, 2, 3, 50, TAPS - 1, TAPS, TAPS + 1, 2500])
def test_pink_noise_matches_its_formula(rng: np.random.Generator, horizon: int) -> None:
    k = np.arange(min(horizon, TAPS))
    response = special.poch(k + 1, -0.5) / special.gamma(0.5)  # the coefficients of (1 - z)^(-1/2)
    white = rng.standard_normal((2, horizon, 3))
    noise = pink(white)
    for t in {*range(min(horizon, 5)), horizon // 2, horizon - 1}:
        part = response[: t + 1]
        newest_first = white[:, t::-1][:, : len(part)]
        expected = np.einsum("k,rkj->rj", part, newest_first) / np.sqrt(part @ part)
        np.testing.assert_allclose(noise[:, t], expected, rtol=0, atol=1e-11)


def test_each_step_has_variance_one_and_depends_on_no_later_draw() -> None:
    horizon = TAPS + 100
    made_of = pink(np.eye(horizon)[:, :, None])[:, :, 0]  # contribution of each draw (row) to each step (column)
    np.testing.assert_allclose((made_of**2).sum(axis=0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(np.tril(made_of, -1), 0.0, atol=1e-14)


@pytest.mark.parametrize("noise", ["white", "pink"])
def test_the_noise_of_an_episode_does_not_depend_on_other_episodes(rng: np.random.Generator, noise: str) -> None:
    policy = replace(random_policy(rng, n=3), noise=noise)
    together = policy.exploration(BATCH)
    for parts in (2, 3, 7):
        apart = np.concatenate([policy.exploration(batch) for batch in BATCH.split(parts)])
        assert apart.tobytes() == together.tobytes()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": -1}, "seed: expected"),
        ({"first_episode": 2**63}, "first_episode: expected"),
        ({"num_envs": 0}, "num_envs: expected 1 to 10000 episodes"),
        ({"num_envs": 10_001}, "num_envs: expected 1 to 10000 episodes"),
        ({"horizon": 0}, "horizon: expected 1 to 1000000 steps"),
        ({"num_envs": 10_000, "horizon": 1_001}, "expected at most 10000000 samples, got 10010000"),
        ({"num_evaluation": 4}, "num_evaluation: expected at most 3 episodes"),
        ({"first_evaluation": 1}, "first_evaluation: expected 0 to 0, got 1"),
    ],
)
def test_batches_that_a_message_may_not_request_are_rejected(changes: dict[str, int], message: str) -> None:
    largest = Batch(2**64 - 1, 2**63 - 1, 10_000, 1_000, explore=False)
    assert len(largest.keys) == largest.num_envs
    with pytest.raises(ValueError, match=message):
        replace(Batch(0, 0, 4, 3, explore=True), **changes)
