"""Gradient updates match independent implementations of their equations with loops and explicit features."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rkhs_ros.learning.algorithms.ac import AC
from rkhs_ros.learning.algorithms.algorithm import Algorithm
from rkhs_ros.learning.algorithms.enac import ENAC
from rkhs_ros.learning.algorithms.power import PoWER
from rkhs_ros.learning.algorithms.rkhs_ac import RKHSAC
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.algorithms.rkhs_npg import RKHSNPG
from rkhs_ros.learning.algorithms.rkhs_power import RKHSPoWER
from rkhs_ros.learning.algorithms.step_rules import FixedStep, KLStep, LineSearch
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Kernel, Polynomial
from test.unit.conftest import learn, random_episodes, random_policy

LINEAR = Polynomial(0.0, 1)
DISCOUNT = 0.9


def scores(policy: GaussianPolicy, episodes: Episodes) -> list[list[tuple[np.ndarray, np.ndarray]]]:
    """Return s and u = (a - h(s)) / sigma^2 of each step of each episode."""
    found = []
    for i in range(len(episodes)):
        found.append([])
        for t in range(int(episodes.mask[i].sum())):
            s, a = episodes.observations[i, t], episodes.actions[i, t]
            found[i].append((s, (a - policy.mean(s[None])[0]) / policy.variance(s[None])[0]))
    return found


def returns(episodes: Episodes) -> np.ndarray:
    return np.array([sum(DISCOUNT**t * r for t, r in enumerate(rewards)) for rewards in episodes.rewards])


def ridge_with_intercept(features: np.ndarray, targets: np.ndarray, ridge: float) -> np.ndarray:
    """Minimise |features w + b - targets|^2 + ridge |w|^2 by least squares on rows for the penalty; return w."""
    n, p = features.shape
    design = np.block([[features, np.ones((n, 1))], [np.sqrt(ridge) * np.eye(p), np.zeros((p, 1))]])
    return np.linalg.lstsq(design, np.append(targets, np.zeros(p)))[0][:p]


def test_npg_with_the_gram_matrix_is_ridge_regression_in_explicit_features(rng: np.random.Generator) -> None:
    policy = random_policy(rng, d=3, kernel=LINEAR)
    episodes = random_episodes(rng, policy, 5, 8, masked=True)
    moved, *_ = learn(RKHSNPG(ridge=0.2, step=FixedStep(0.7)), policy, episodes, DISCOUNT)
    phi = np.array([sum(np.kron(s, u) for s, u in steps) for steps in scores(policy, episodes)])
    w = ridge_with_intercept(phi, returns(episodes), 0.2 * np.mean(np.sum(phi**2, axis=1)))
    x = episodes.flat(episodes.observations)
    np.testing.assert_allclose(moved.mean(x), policy.mean(x) + 0.7 * x @ w.reshape(3, 2), rtol=1e-8, atol=1e-8)


def test_npg_with_a_full_dictionary_is_the_published_sum_of_kernel_functions(rng: np.random.Generator) -> None:
    policy = random_policy(rng, m=3, kernel=RBF((0.4,)))
    episodes = random_episodes(rng, policy, 4, 6, masked=True)
    algorithm = RKHSNPG(centres=60, baseline="as_published", ridge=0.2, step=FixedStep(0.7))
    moved, *_ = learn(algorithm, policy, episodes, DISCOUNT)
    steps = scores(policy, episodes)
    kappa = policy.mean.kernel

    def compatible(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> float:
        return float(kappa(a[0][None], b[0][None])[0, 0] * (a[1] @ b[1]))

    gram = np.array([[sum(compatible(a, b) for a in one for b in two) for two in steps] for one in steps])
    weights = np.linalg.solve(gram + 0.2 * np.trace(gram) / 4 * np.eye(4), returns(episodes))
    x = rng.normal(size=(9, 2))
    direction = sum(weights[i] * kappa(x, s[None]) * u for i, episode in enumerate(steps) for s, u in episode)
    np.testing.assert_allclose(moved.mean(x), policy.mean(x) + 0.7 * direction, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("algorithm", [RKHSNPG(), RKHSNAC(critic="trajectory")])
def test_equal_returns_have_no_direction(algorithm: Algorithm, rng: np.random.Generator) -> None:
    policy = random_policy(rng)
    episodes = random_episodes(rng, policy, 5, 8)
    equal = replace(episodes, rewards=np.broadcast_to(episodes.rewards[0], episodes.rewards.shape))
    moved, metrics = learn(algorithm, policy, equal, DISCOUNT)
    assert metrics.kl == 0.0
    np.testing.assert_array_equal(
        moved.mean(equal.flat(equal.observations)), policy.mean(equal.flat(equal.observations))
    )


def test_a_learnt_variance_follows_the_gradient_of_the_unexplained_advantage(rng: np.random.Generator) -> None:
    policy = random_policy(rng, d=3, kernel=LINEAR)
    newest, older = (random_episodes(rng, policy, n, 8, masked=True) for n in (5, 3))
    algorithm = RKHSNAC(variance="learnt", reuse=4, trace=0.8, step=FixedStep(0.3))
    moved, _ = learn(algorithm, policy, newest, DISCOUNT, memory=older)
    memory = algorithm.remembered(newest + older, DISCOUNT)
    w = (moved.mean(np.eye(3)) - policy.mean(np.eye(3))) / 0.3  # for a linear mean
    samples = algorithm.samples(policy, newest + older)
    left, count = iter(algorithm.value_baseline.advantages(samples, DISCOUNT)), 0
    v, variance = np.zeros(2), policy.variance(np.zeros((1, 3)))[0]
    for steps in scores(policy, newest):
        for s, u in steps:
            v += (next(left) - s @ w @ u) * (u**2 * variance - 1.0) / np.sqrt(2.0)  # u^2 sigma^4 / sigma^2
            count += 1
    np.testing.assert_allclose(moved.variance.values, variance * np.exp(np.sqrt(2.0) * 0.3 * v / count), rtol=1e-7)
    np.testing.assert_array_equal(memory.rewards, (newest + older).take(slice(4)).rewards)


def test_the_joint_step_of_mean_and_variance_has_the_given_divergence(rng: np.random.Generator) -> None:
    policy = random_policy(rng)
    algorithm = RKHSNAC(variance="learnt", step=KLStep(divergence=1e-6))
    moved, metrics = learn(algorithm, policy, random_episodes(rng, policy, 20, 8), DISCOUNT)
    assert (moved.variance.values != policy.variance.values).all()
    assert metrics.kl == pytest.approx(1e-6, rel=0.01)  # up to the order of the step, 1e-3


@pytest.mark.filterwarnings("error")
def test_a_learnt_variance_stays_within_its_bounds_for_any_step(rng: np.random.Generator) -> None:
    policy = random_policy(rng)
    moved, *_ = learn(RKHSNAC(variance="learnt", step=FixedStep(1e6)), policy, random_episodes(rng, policy))
    assert set(moved.variance.values) <= {0.01**2, 10.0**2}  # relative to the first one, 1


def test_an_enac_step_matches_the_textbook(rng: np.random.Generator) -> None:
    centres = np.array([[a, b] for a in (-1.0, 0.5, 2.0) for b in (0.0, 1.0)])
    theta, kernel = rng.normal(size=(6, 2)), RBF((0.9,))
    policy = GaussianPolicy(Function(kernel, centres, theta), ConstantVariance(np.array([0.5, 2.0])))
    episodes = random_episodes(rng, policy, 30, 8, masked=True)
    algorithm = ENAC(grid=(-1.0, 2.0, 3.0, 0.0, 1.0, 2.0), ridge=0.05, step=FixedStep(0.4))
    moved, *_ = learn(algorithm, policy, episodes, DISCOUNT)
    # R(xi) = <w, sum_t gamma^t grad log pi> + J, by least squares over the episodes
    psi = np.zeros((30, 12))
    for i, steps in enumerate(scores(policy, episodes)):
        for t, (s, u) in enumerate(steps):
            phi = [np.exp(-0.5 * np.sum((s - c) ** 2) / 0.9**2) for c in centres]
            psi[i] += DISCOUNT**t * np.outer(phi, u).ravel()
    w = ridge_with_intercept(psi, returns(episodes), 0.05 * np.mean(np.sum(psi**2, axis=1)))
    np.testing.assert_allclose(moved.mean.weights, theta + 0.4 * w.reshape(6, 2), rtol=1e-8, atol=1e-8)
    assert np.array_equal(moved.mean.centres, centres)


def on_a_lattice(rng: np.random.Generator) -> tuple[GaussianPolicy, Episodes]:
    """Return episodes that visit the points of a grid, whose kernel functions are nearly orthonormal."""
    points = np.array([[a, b] for a in (0.0, 1.0, 2.0) for b in (0.0, 1.0, 2.0)])
    mean = Function(RBF((0.1,)), points, rng.normal(size=(9, 2)))
    policy = GaussianPolicy(mean, ConstantVariance(np.array([0.5, 2.0])))
    visited = np.stack([rng.permutation(points) for _ in range(6)])
    actions = policy.act(visited.reshape(-1, 2), rng.standard_normal((54, 2))).reshape(6, 9, 2)
    return policy, Episodes.without_ends(visited, actions, rng.uniform(size=(6, 9)), np.ones((6, 9), dtype=bool))


GRID = {"grid": (0.0, 2.0, 3.0)}
CRITICS = ("step", "trajectory", "pursuit")
PAIRS: list[tuple[type[Algorithm], type[Algorithm], dict[str, Any]]] = [
    *((free, fixed, {"critic": c}) for free, fixed in ((RKHSNAC, ENAC), (RKHSAC, AC)) for c in CRITICS),
    *((RKHSPoWER, PoWER, {"weighting": weighting, "reuse": 0}) for weighting in ("positive", "returns")),
]


@pytest.mark.parametrize(("free", "fixed", "same"), PAIRS)
def test_with_orthonormal_kernel_functions_rkhs_and_parametric_algorithms_agree(
    rng: np.random.Generator, free: type[Algorithm], fixed: type[Algorithm], same: dict[str, Any]
) -> None:
    policy, episodes = on_a_lattice(rng)
    if "critic" in same:
        same = same | {"step": FixedStep(0.3), "value_ridge": 0.01, "trace": 0.9}
    algorithms = free(centres=200, ridge=0.1, **same), fixed(**GRID, ridge=0.1, **same)
    one, two = (learn(algorithm, policy, episodes, DISCOUNT).policy for algorithm in algorithms)
    x = episodes.flat(episodes.observations)
    assert np.abs(two.mean(x) - policy.mean(x)).max() > 1e-3
    np.testing.assert_allclose(one.mean(x), two.mean(x), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("kernel", [Polynomial(0.5, 1), RBF((0.4,))], ids=["linear", "rbf"])
def test_the_plain_gradient_is_the_sum_of_weighted_kernel_functions(rng: np.random.Generator, kernel: Kernel) -> None:
    policy = random_policy(rng, m=3, kernel=kernel)
    episodes = random_episodes(rng, policy, 4, 6, masked=True)
    algorithm = RKHSAC(centres=60, critic="step", step=FixedStep(0.5))
    moved, *_ = learn(algorithm, policy, episodes, DISCOUNT)
    same = RKHSNAC(centres=60, trace=algorithm.trace, value_ridge=algorithm.value_ridge, step=FixedStep(1.0))
    natural, *_ = learn(same, policy, episodes, DISCOUNT)  # h + w, the same critic
    x = rng.normal(size=(9, 2))
    total = np.zeros((9, 2))
    for steps in scores(policy, episodes):
        for s, u in steps:
            advantage = (natural.mean(s[None]) - policy.mean(s[None]))[0] @ u  # <w, K(s, .) u>
            total += advantage * kernel(x, s[None]) * u
    np.testing.assert_allclose(moved.mean(x), policy.mean(x) + 0.5 / 4 * total, rtol=1e-8, atol=1e-8)


def test_a_line_search_collects_episodes_for_each_candidate(rng: np.random.Generator) -> None:
    policy = random_policy(rng)
    episodes = random_episodes(rng, policy)
    tried: list[GaussianPolicy] = []

    def collect(candidate: GaussianPolicy, number: int) -> Episodes:
        """Return the highest reward for the third candidate."""
        assert number == 1
        tried.append(candidate)
        good = 1.0 if len(tried) == 3 else 0.0
        return replace(episodes, rewards=np.full_like(episodes.rewards, good)).take(slice(number))

    algorithm = RKHSNAC(centres=200, step=LineSearch(), exploration_decay=0.5)
    moved, metrics = learn(algorithm, policy, episodes, collect=collect)
    x = episodes.flat(episodes.observations)
    assert len(tried) == 50
    assert np.array_equal(moved.mean(x), tried[2].mean(x))
    lengths = [np.sqrt(np.mean(np.sum((t.mean(x) - policy.mean(x)) ** 2 / policy.variance(x), axis=1))) for t in tried]
    np.testing.assert_allclose(lengths, np.geomspace(0.01, 3.0, 50), rtol=1e-9)
    assert all(np.array_equal(t.variance.values, policy.variance.values) for t in tried)
    np.testing.assert_allclose(moved.variance.values, 0.25 * policy.variance.values)
    w = RKHSNAC(centres=200, step=FixedStep(metrics.step_size))
    np.testing.assert_allclose(learn(w, policy, episodes).policy.mean(x), moved.mean(x), rtol=1e-12)
