"""Exploration noise that is correlated over time: its spectrum, variance and independence."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from rkhs_ros.policies.streams import TAPS, Batch, pink
from test.unit.conftest import random_policy

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
