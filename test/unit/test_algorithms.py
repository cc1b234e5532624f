from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rkhs_ros.learning.algorithm import Algorithm
from rkhs_ros.learning.critics import CRITICS, value
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.features import Samples
from rkhs_ros.learning.registry import ALGORITHMS
from rkhs_ros.learning.rkhs_nac import RKHSNAC
from rkhs_ros.learning.rkhs_power import RKHSPoWER
from rkhs_ros.learning.steps import FixedStep, KLStep
from rkhs_ros.policies.gaussian import GaussianPolicy, mean_kl
from rkhs_ros.policies.variance import ConstantVariance, KernelVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF

MakePolicy = Callable[..., GaussianPolicy]
MakeEpisodes = Callable[..., Episodes]
over_algorithms = pytest.mark.parametrize("algorithm", [cls() for cls in ALGORITHMS.values()], ids=list(ALGORITHMS))


def bandit(seed: int, best: float) -> tuple[GaussianPolicy, Episodes]:
    """One-step episodes in one state; the nearer an action to the best, the higher its reward."""
    policy = GaussianPolicy(Function.zero(RBF((1.0,)), 1, 1), ConstantVariance(np.ones(1)))
    actions = np.random.default_rng(seed).standard_normal((200, 1, 1))
    rewards = np.exp(-0.5 * (actions[:, :, 0] - best) ** 2)
    return policy, Episodes(np.zeros((200, 1, 1)), actions, rewards, np.ones((200, 1), dtype=bool))


@over_algorithms
@pytest.mark.parametrize("best", [-1.5, 1.5])
def test_the_mean_moves_towards_better_actions(algorithm: Algorithm, best: float) -> None:
    policy, episodes = bandit(0, best)
    moved, _ = algorithm.update(policy, episodes, 0.99)
    # The divergence of NAC's step, 0.02, is a move of 0.2; PoWER goes farther.
    assert np.sign(best) * moved.mean(np.zeros((1, 1)))[0, 0] > 0.15


@over_algorithms
@pytest.mark.parametrize("masked", [False, True], ids=["whole", "masked"])
def test_an_update_edits_nothing_and_repeats_to_the_bit(
    algorithm: Algorithm,
    masked: bool,
    random_policy: MakePolicy,
    random_episodes: MakeEpisodes,
    arrays_of: Callable[[Any], dict[str, np.ndarray]],
) -> None:
    policy = random_policy()
    episodes = random_episodes(policy, masked=masked)
    inputs = {**arrays_of(policy), **arrays_of(episodes)}
    before = {name: array.tobytes() for name, array in inputs.items()}
    for array in inputs.values():
        array.setflags(write=False)
    (first, metrics), (second, again) = (algorithm.update(policy, episodes, 0.99) for _ in range(2))
    assert {name: array.tobytes() for name, array in inputs.items()} == before
    assert metrics == again
    got, expected = arrays_of(first), arrays_of(second)
    assert all(got[name].tobytes() == expected[name].tobytes() for name in expected)


@over_algorithms
def test_steps_after_the_end_of_an_episode_do_not_matter(
    algorithm: Algorithm, random_policy: MakePolicy, random_episodes: MakeEpisodes, rng: np.random.Generator
) -> None:
    policy = random_policy()
    episodes = random_episodes(policy, masked=True)
    over = ~episodes.mask[:, :, None]
    noise = [np.where(over, rng.normal(size=a.shape), a) for a in (episodes.observations, episodes.actions)]
    changed = replace(episodes, observations=noise[0], actions=noise[1])
    (first, _), (second, _) = (algorithm.update(policy, e, 0.99) for e in (episodes, changed))
    x = rng.normal(size=(9, 2))
    assert np.array_equal(first.mean(x), second.mean(x))
    assert np.array_equal(first.variance(x), second.variance(x))


@over_algorithms
def test_the_metrics_are_what_happened(
    algorithm: Algorithm, random_policy: MakePolicy, random_episodes: MakeEpisodes
) -> None:
    policy = random_policy()
    episodes = random_episodes(policy)
    new, metrics = replace(algorithm, centres=7).update(policy, episodes, 0.99)
    assert metrics.centres == len(new.mean.centres) <= 7
    assert metrics.kl == pytest.approx(mean_kl(policy, new, episodes.flat(episodes.observations)))


@pytest.mark.parametrize("critic", list(CRITICS))
def test_nac_goes_just_as_far_as_its_divergence(
    critic: str, random_policy: MakePolicy, random_episodes: MakeEpisodes
) -> None:
    policy = random_policy()
    algorithm = RKHSNAC(centres=60, critic=critic, step=KLStep(0.07, cap=1e6))
    _, metrics = algorithm.update(policy, random_episodes(policy), 0.99)
    assert metrics.kl == pytest.approx(0.07, rel=1e-3)  # the sparsification's ridge takes 1e-4


@pytest.mark.parametrize("critic", list(CRITICS))
def test_nac_adds_the_critics_weight_times_the_step(
    critic: str, random_policy: MakePolicy, random_episodes: MakeEpisodes
) -> None:
    policy = random_policy(m=3)
    episodes = random_episodes(policy)
    moved, _ = RKHSNAC(centres=60, critic=critic, ridge=0.1, step=FixedStep(0.3)).update(policy, episodes, 0.9)
    samples = Samples.of(policy, episodes, 60)
    w = samples.features @ CRITICS[critic](samples, 0.9, 0.1)
    x = samples.observations
    np.testing.assert_allclose(moved.mean(x), policy.mean(x) + 0.3 * w, atol=1e-4)


@pytest.mark.parametrize("critic", list(CRITICS))
@pytest.mark.parametrize("step", [KLStep(), FixedStep(0.5)], ids=["kl", "fixed"])
def test_nac_without_rewards_stays_where_it_is(
    critic: str, step: KLStep, random_policy: MakePolicy, random_episodes: MakeEpisodes, rng: np.random.Generator
) -> None:
    policy = random_policy()
    episodes = random_episodes(policy)
    still = replace(episodes, rewards=np.zeros_like(episodes.rewards))
    moved, metrics = RKHSNAC(critic=critic, step=step).update(policy, still, 0.99)
    x = episodes.flat(episodes.observations)
    np.testing.assert_allclose(moved.mean(x), policy.mean(x), atol=1e-5)
    assert metrics.kl < 1e-9


def test_nac_narrows_the_exploration(random_policy: MakePolicy, random_episodes: MakeEpisodes) -> None:
    policy = random_policy()
    moved, _ = RKHSNAC(exploration_decay=0.9).update(policy, random_episodes(policy), 0.99)
    np.testing.assert_allclose(moved.variance.values, 0.81 * policy.variance.values, rtol=1e-12)


def test_nac_refuses_a_variance_that_depends_on_the_state(
    random_policy: MakePolicy, random_episodes: MakeEpisodes
) -> None:
    policy = random_policy(learnt=True)
    with pytest.raises(ValueError, match="RKHS-NAC: expected a constant variance"):
        RKHSNAC().update(policy, random_episodes(policy), 0.99)


@pytest.mark.parametrize("learnt", [False, True], ids=["constant variance", "learnt variance"])
def test_power_on_a_full_dictionary_is_the_full_kernel_system(
    learnt: bool, random_policy: MakePolicy, random_episodes: MakeEpisodes
) -> None:
    policy = random_policy(kernel=RBF((0.4,)), learnt=learnt)
    episodes = random_episodes(policy, 4, 5, masked=True)
    algorithm = RKHSPoWER(centres=60, ridge=0.5)
    moved, _ = algorithm.update(policy, episodes, 0.9)
    samples = Samples.of(policy, episodes, 60)
    assert samples.features.shape[1] == len(samples.observations)  # the dictionary is full
    to_go = episodes.flat(episodes.rewards_to_go(0.9))
    q = np.maximum(to_go - value(samples, 0.9, algorithm.value_ridge), 0.0)
    q /= q.mean()
    x = samples.observations
    gram, step = policy.mean.kernel(x, x), np.zeros_like(samples.exploration)
    for j in range(2):
        d = np.diag(np.sqrt(q / samples.variance[:, j]))
        alpha = d @ np.linalg.solve(d @ gram @ d + 0.5 * np.eye(len(x)), d @ samples.exploration[:, j])
        step[:, j] = gram @ alpha
    np.testing.assert_allclose(moved.mean(x), policy.mean(x) + step, atol=1e-4)


def test_power_learns_a_variance_within_its_bounds(
    random_policy: MakePolicy, random_episodes: MakeEpisodes, rng: np.random.Generator
) -> None:
    policy = random_policy()
    algorithm = RKHSPoWER(sd_minimum=0.6, sd_maximum=0.9)
    new, _ = algorithm.update(policy, random_episodes(policy), 0.99)
    variance = new.variance(10 * rng.normal(size=(50, 2)))
    assert isinstance(new.variance, KernelVariance)
    assert np.all((variance >= 0.36 - 1e-12) & (variance <= 0.81 + 1e-12))


def test_power_in_one_state_learns_the_weighted_mean_of_squared_exploration() -> None:
    policy, episodes = bandit(1, 1.5)
    new, _ = RKHSPoWER().update(policy, episodes, 0.99)
    rewards, exploration = episodes.rewards[:, 0], episodes.actions[:, 0, 0]
    q = np.maximum(rewards - rewards.mean(), 0.0)  # the value of the only state is the mean, up to its ridge
    expected = np.sum(q * exploration**2) / np.sum(q)
    assert new.variance(np.zeros((1, 1)))[0, 0] == pytest.approx(expected, rel=1e-3)


def test_crossed_bounds_of_the_deviation_are_refused() -> None:
    with pytest.raises(ValueError, match=r"algorithm\.sd_minimum: expected at most 1\.0, got 2\.0"):
        RKHSPoWER(sd_minimum=2.0, sd_maximum=1.0)
