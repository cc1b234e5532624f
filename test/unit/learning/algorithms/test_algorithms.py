from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from rkhs_ros.learning.algorithms.actor_critic import ActorCritic
from rkhs_ros.learning.algorithms.algorithm import Algorithm
from rkhs_ros.learning.algorithms.critics import ValueBaseline, pursuit_critic, step_critic, trajectory_critic
from rkhs_ros.learning.algorithms.function_spaces import Grid
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.algorithms.rkhs_npg import RKHSNPG
from rkhs_ros.learning.algorithms.step_rules import FixedStep, KLStep
from rkhs_ros.learning.algorithms.weighted_exploration import WeightedExploration
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from test.unit.conftest import arrays_of, kl_between, learn, random_episodes, random_policy

over_algorithms = pytest.mark.parametrize("algorithm", [cls() for cls in ALGORITHMS.values()], ids=list(ALGORITHMS))


def bandit(seed: int, best: float) -> tuple[GaussianPolicy, Episodes]:
    """Return one-step episodes in one state; the closer an action to the best, the higher its reward."""
    policy = GaussianPolicy(Function.constant(RBF((1.0,)), 1, 1), ConstantVariance(np.ones(1)))
    actions = np.random.default_rng(seed).standard_normal((200, 1, 1))
    rewards = np.exp(-0.5 * (actions[:, :, 0] - best) ** 2)
    return policy, Episodes.without_ends(np.zeros((200, 1, 1)), actions, rewards, np.ones((200, 1), dtype=bool))


@over_algorithms
def test_the_mean_moves_towards_better_actions(algorithm: Algorithm) -> None:
    policy, episodes = bandit(0, best=-1.5)
    if isinstance(algorithm, ActorCritic | RKHSNPG):
        algorithm = replace(algorithm, step=KLStep(0.02))
    moved, *_ = learn(algorithm, policy, episodes)
    # A divergence of 0.02 is a step of 0.2; PoWER takes longer steps.
    assert moved.mean(np.zeros((1, 1)))[0, 0] < -0.15


@over_algorithms
def test_an_update_modifies_no_input_and_is_deterministic(algorithm: Algorithm, rng: np.random.Generator) -> None:
    policy = random_policy(rng)
    episodes = random_episodes(rng, policy, masked=True)
    memory = random_episodes(rng, policy, 3, masked=True)
    inputs = {f"{i}{k}": v for i, given in enumerate((policy, episodes, memory)) for k, v in arrays_of(given).items()}
    for array in inputs.values():
        array.setflags(write=False)
    first, second = (learn(algorithm, policy, episodes, memory=memory) for _ in range(2))
    assert first.metrics == second.metrics
    got, expected = arrays_of(first.policy), arrays_of(second.policy)
    assert got.keys() == expected.keys()
    assert all(got[name].tobytes() == expected[name].tobytes() for name in expected)


@over_algorithms
def test_steps_after_the_end_of_an_episode_do_not_matter(algorithm: Algorithm, rng: np.random.Generator) -> None:
    policy = random_policy(rng)
    episodes = random_episodes(rng, policy, masked=True)
    over = ~episodes.mask[:, :, None]
    noise = [np.where(over, rng.normal(size=a.shape), a) for a in (episodes.observations, episodes.actions)]
    changed = replace(episodes, observations=noise[0], actions=noise[1])
    (first, *_), (second, *_) = (learn(algorithm, policy, e) for e in (episodes, changed))
    x = rng.normal(size=(9, 2))
    assert np.array_equal(first.mean(x), second.mean(x))
    assert np.array_equal(first.variance(x), second.variance(x))


@over_algorithms
def test_the_metrics_describe_the_update(algorithm: Algorithm, rng: np.random.Generator) -> None:
    policy = random_policy(rng, m=0 if isinstance(algorithm, Grid) else 5)
    episodes = random_episodes(rng, policy)
    small = {"grid": (-1.0, 1.0, 7.0, -1.0, 1.0, 1.0)} if isinstance(algorithm, Grid) else {"centres": 7}
    new, metrics = learn(replace(algorithm, **small), policy, episodes)
    assert metrics.centres == len(new.mean.centres) <= 7
    assert metrics.kl == pytest.approx(kl_between(policy, new, episodes.flat(episodes.observations)))


@pytest.mark.parametrize("name", ["enac", "power", "ac"])
def test_a_grid_is_added_once_to_an_initial_policy(name: str, rng: np.random.Generator) -> None:
    policy = random_policy(rng, m=4)
    algorithm = replace(ALGORITHMS[name](), grid=(-1.0, 1.0, 3.0))
    x = rng.normal(size=(9, 2))
    for _ in range(3):
        before = policy
        policy, *_ = learn(algorithm, before, random_episodes(rng, before))
        assert len(policy.mean.centres) == 4 + 3**2
        assert not np.allclose(policy.mean(x), before.mean(x))


BASELINE = ValueBaseline(0.3, trace=0.6)
ESTIMATORS = {
    "step": partial(step_critic, ridge=0.1, baseline=BASELINE),
    "pursuit": partial(pursuit_critic, ridge=0.1, baseline=BASELINE),
    "trajectory": partial(trajectory_critic, ridge=0.1),
}


@pytest.mark.parametrize("critic", ESTIMATORS)
def test_nac_adds_the_critics_estimate_times_the_step_size(critic: str, rng: np.random.Generator) -> None:
    policy = random_policy(rng, m=3)
    episodes = random_episodes(rng, policy)
    algorithm = RKHSNAC(centres=60, step=FixedStep(0.3), critic=critic, ridge=0.1, value_ridge=0.3, trace=0.6)
    moved, *_ = learn(algorithm, policy, episodes, 0.9)
    samples = Samples.in_newton_basis(policy, episodes, 60)
    w = samples.features @ ESTIMATORS[critic](samples, 0.9)
    x = samples.observations
    assert np.abs(w).max() > 1e-2
    np.testing.assert_allclose(moved.mean(x), policy.mean(x) + 0.3 * w, atol=1e-4)


@over_algorithms
def test_the_exploration_decays_to_its_minimum(algorithm: Algorithm, rng: np.random.Generator) -> None:
    policy = random_policy(rng)
    constant = {"variance": "constant"} if isinstance(algorithm, WeightedExploration) else {}
    for minimum, factor in ((1e-3, 0.81), (1e3, 1.0)):  # a standard deviation below the minimum does not change
        narrowing = replace(algorithm, exploration_decay=0.9, sd_range=(minimum, 1e6), **constant)
        moved, *_ = learn(narrowing, policy, random_episodes(rng, policy))
        np.testing.assert_allclose(moved.variance.values, factor * policy.variance.values, rtol=1e-12)


@over_algorithms
def test_a_variance_that_depends_on_the_state_does_not_decay(algorithm: Algorithm, rng: np.random.Generator) -> None:
    policy = random_policy(rng, learnt=True)
    constant = {"variance": "constant"} if isinstance(algorithm, WeightedExploration) else {}
    with pytest.raises(ValueError, match="variance: expected a constant variance, got one that depends"):
        learn(replace(algorithm, **constant), policy, random_episodes(rng, policy))


@pytest.mark.parametrize("name", ["rkhs_ac", "rkhs_npg", "rkhs_nac", "rkhs_power"])
def test_the_sparsification_error_is_the_distance_from_the_full_mean(name: str, rng: np.random.Generator) -> None:
    policy = random_policy(rng, m=7, kernel=RBF((0.5,)))
    episodes = random_episodes(rng, policy)
    # A direction with few centres is added to a mean with seven; the sum has too many centres and is sparsified.
    algorithm = replace(ALGORITHMS[name](), centres=7)
    if name == "rkhs_nac":
        algorithm = replace(algorithm, trace=1.0, value_ridge=algorithm.ridge)
    small, metrics = learn(algorithm, policy, episodes)
    x = episodes.flat(episodes.observations)
    samples = Samples.in_newton_basis(policy, episodes, 7)
    assert metrics.sparsification_error > 1e-4
    if name == "rkhs_nac":
        w = step_critic(samples, 0.99, algorithm.ridge, ValueBaseline(algorithm.ridge))
        whole = policy.mean(x) + metrics.step_size * samples.features @ w
        error = np.linalg.norm(whole - small.mean(x)) / np.linalg.norm(whole - policy.mean.bias)
        assert metrics.sparsification_error == pytest.approx(error, rel=1e-4)
    with_room = replace(algorithm, centres=200)
    assert learn(with_room, policy, episodes).metrics.sparsification_error == 0.0


@over_algorithms
def test_an_update_far_from_all_centres_returns_a_policy(algorithm: Algorithm, rng: np.random.Generator) -> None:
    policy = random_policy(rng, m=0, kernel=RBF((0.01,)))
    episodes = random_episodes(rng, policy)
    far = replace(episodes, observations=episodes.observations + 1000.0)
    new, *_ = learn(algorithm, policy, far)
    assert np.isfinite(new.mean(far.flat(far.observations))).all()
