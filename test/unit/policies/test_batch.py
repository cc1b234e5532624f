"""Batches of episodes: their numbers, seeds and splits."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import special

from rkhs_ros.policies.gaussian import Acting
from rkhs_ros.policies.streams import TAPS, Batch, pink
from test.unit.conftest import random_policy

numbers = st.integers(0, 2**63 - 100)  # the numbers of all parts must stay below 2^63


@given(numbers, st.integers(1, 40), st.booleans(), st.integers(1, 50))
def test_splitting_a_batch_keeps_the_order_and_seeds_of_its_episodes(
    first: int, num_envs: int, explore: bool, count: int
) -> None:
    batch = Batch(5, first, num_envs, 3, explore=explore)
    whole = [*zip(batch.episodes, batch.environment_seeds(), strict=True)]
    assert len(whole) == len(set(whole)) == num_envs
    parts = batch.parts(count)
    assert [row for part in parts for row in zip(part.episodes, part.environment_seeds(), strict=True)] == whole
    sizes = [part.num_envs for part in parts]
    assert max(sizes) <= min(count, min(sizes) + 1)


def test_without_exploration_the_actions_are_the_mean(rng: np.random.Generator) -> None:
    policy, batch, observed = random_policy(rng, d=2, n=1), Batch(0, 0, 2, 3, explore=True), np.ones((2, 2))
    still, moving = (Acting(policy, batch, explore=explore)(0, observed) for explore in (False, True))
    assert still.tobytes() == policy.mean(observed).tobytes()
    assert (still != moving).all()


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


@pytest.mark.parametrize("noise", ["white", "pink"])
def test_the_noise_of_an_episode_does_not_depend_on_other_episodes(rng: np.random.Generator, noise: str) -> None:
    policy = replace(random_policy(rng, n=3), noise=noise)
    together = policy.exploration(BATCH)
    for size in (1, 2, 4):
        apart = np.concatenate([policy.exploration(batch) for batch in BATCH.parts(size)])
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
    ],
)
def test_batches_that_a_message_may_not_request_are_rejected(changes: dict[str, int], message: str) -> None:
    largest = Batch(2**64 - 1, 2**63 - 1, 10_000, 1_000, explore=False)
    assert len(largest.episodes) == largest.num_envs
    with pytest.raises(ValueError, match=message):
        replace(Batch(0, 0, 4, 3, explore=True), **changes)
