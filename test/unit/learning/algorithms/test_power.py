"""PoWER and RKHS-PoWER match independent implementations of their equations."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.learning.algorithms.power import PoWER
from rkhs_ros.learning.algorithms.rkhs_power import RKHSPoWER
from rkhs_ros.learning.algorithms.weighted_exploration import WeightedExploration, as_published, learnt
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import ConstantVariance, FunctionVariance, KernelVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Kernel, Polynomial
from test.unit.conftest import learn, random_episodes, random_policy

DISCOUNT = 0.9
AS_IN_THE_PAPER: dict[str, Any] = {"variance": "learnt"}
over_variances = pytest.mark.parametrize("state", [False, True], ids=["constant variance", "learnt variance"])
over_weightings = pytest.mark.parametrize("weighting", ["positive", "returns"])


def rewards_to_go(episodes: Episodes) -> np.ndarray:
    return np.array(
        [
            sum(DISCOUNT**k * r for k, r in enumerate(rewards[t:]))
            for rewards, mask in zip(episodes.rewards, episodes.mask, strict=True)
            for t in range(int(mask.sum()))
        ]
    )


def steps_of(episodes: Episodes) -> np.ndarray:
    return np.concatenate([np.arange(mask.sum()) for mask in episodes.mask])


def advantages(features: np.ndarray, episodes: Episodes, ridge: float) -> np.ndarray:
    """Return the rewards to go minus their fit by the features, 1, t and t^2."""
    to_go, time = rewards_to_go(episodes), steps_of(episodes) / episodes.horizon
    rows = np.column_stack([features, np.ones_like(time), time, time**2])
    penalty = len(rows) * np.array([ridge] * features.shape[1] + [1e-6] * 3)
    design = np.concatenate([rows, np.diag(np.sqrt(penalty))])
    return to_go - rows @ np.linalg.lstsq(design, np.append(to_go, np.zeros(len(penalty))))[0]


def weights(weighting: str, features: np.ndarray, episodes: Episodes, ridge: float) -> np.ndarray:
    """Return the weights q of the samples, scaled to mean 1."""
    a = advantages(features, episodes, ridge)
    q = np.where(a > 0, a, 0.0) if weighting == "positive" else rewards_to_go(episodes)
    return q / np.mean(q)


def weighted_step(
    phi: np.ndarray, exploration: np.ndarray, variance: np.ndarray, q: np.ndarray, ridge: float
) -> np.ndarray:
    """Return (sum q phi phi' / g + ridge I)^-1 sum q phi e / g of each action dimension."""
    columns = []
    for j in range(exploration.shape[1]):
        matrix, vector = ridge * np.eye(phi.shape[1]), np.zeros(phi.shape[1])
        for row, e, g, weight in zip(phi, exploration[:, j], variance[:, j], q, strict=True):
            matrix += weight * np.outer(row, row) / g
            vector += weight * row * e / g
        columns.append(np.linalg.solve(matrix, vector))
    return np.stack(columns, axis=1)


@over_weightings
@over_variances
def test_power_on_a_grid_is_the_regression_of_kober_and_peters(
    rng: np.random.Generator, weighting: str, state: bool
) -> None:
    policy = random_policy(rng, m=0)
    policy = replace(policy, variance=random_policy(rng, learnt=state).variance)
    episodes = random_episodes(rng, policy, 6, 8, masked=True)
    size: dict[str, Any] = {"grid": (-1.0, 1.0, 3.0), "reuse": 0}
    algorithm = PoWER(weighting=weighting, ridge=0.7, value_ridge=0.2, **size, **AS_IN_THE_PAPER)
    moved, metrics = learn(algorithm, policy, episodes, DISCOUNT)
    assert metrics.sparsification_error == 0.0
    x = episodes.flat(episodes.observations)
    centres = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    phi = np.array([[np.exp(-0.5 * np.sum((s - c) ** 2)) for c in np.array(centres)] for s in x])
    exploration = episodes.flat(episodes.actions) - policy.mean(x)
    step = weighted_step(phi, exploration, policy.variance(x), weights(weighting, phi, episodes, 0.2), 0.7)
    np.testing.assert_allclose(moved.mean.weights, step, rtol=1e-8, atol=1e-8)


def test_the_diagonal_solution_is_the_mean_of_each_parameters_exploration(rng: np.random.Generator) -> None:
    policy = random_policy(rng, m=0)
    episodes = random_episodes(rng, policy, 6, 8, masked=True)
    algorithm = PoWER(weighting="as_published", grid=(-1.0, 1.0, 3.0), reuse=0)
    moved, *_ = learn(algorithm, policy, episodes, DISCOUNT)
    x, q = episodes.flat(episodes.observations), rewards_to_go(episodes)
    total = np.zeros((9, 2))
    for s, a, weight in zip(x, episodes.flat(episodes.actions), q, strict=True):
        phi = policy.mean.kernel(s[None], moved.mean.centres)[0]
        explored = a - policy.mean.bias
        parameters = np.linalg.pinv(phi[None]) @ explored[None]  # the smallest epsilon with phi' epsilon = a - b
        np.testing.assert_allclose(phi @ parameters, explored, rtol=1e-9)
        total += weight * parameters
    np.testing.assert_allclose(moved.mean.weights, total / q.sum(), rtol=1e-8, atol=1e-10)


@over_variances
def test_power_on_a_full_dictionary_is_the_full_kernel_system(rng: np.random.Generator, state: bool) -> None:
    policy = random_policy(rng, kernel=RBF((0.4,)), learnt=state)
    episodes = random_episodes(rng, policy, 4, 5, masked=True)
    algorithm = RKHSPoWER(centres=60, ridge=0.5, value_ridge=0.2, **AS_IN_THE_PAPER)
    moved, *_ = learn(algorithm, policy, episodes, DISCOUNT)
    x, gram = full_gram(policy, episodes)
    # Any square root of the Gram matrix is a feature matrix of the full system.
    q = weights("positive", np.linalg.cholesky(gram), episodes, 0.2)
    exploration, variance = episodes.flat(episodes.actions) - policy.mean(x), policy.variance(x)
    step = np.zeros_like(exploration)
    for j in range(2):
        d = np.diag(np.sqrt(q / variance[:, j]))
        alpha = d @ np.linalg.solve(d @ gram @ d + 0.5 * np.eye(len(x)), d @ exploration[:, j])
        step[:, j] = gram @ alpha
    np.testing.assert_allclose(moved.mean(x), policy.mean(x) + step, rtol=1e-8, atol=1e-8)


def full_gram(policy: GaussianPolicy, episodes: Episodes) -> tuple[np.ndarray, np.ndarray]:
    x = episodes.flat(episodes.observations)
    return x, policy.mean.kernel(x, x)


@over_variances
def test_the_published_weighting_solves_the_papers_system(rng: np.random.Generator, state: bool) -> None:
    policy = random_policy(rng, kernel=RBF((0.4,)), learnt=state)
    episodes = random_episodes(rng, policy, 4, 5, masked=True)
    algorithm = RKHSPoWER(centres=60, ridge=0.5, value_ridge=0.2, weighting="as_published", variance="learnt")
    moved, *_ = learn(algorithm, policy, episodes, DISCOUNT)
    x, gram = full_gram(policy, episodes)
    advantage = advantages(np.linalg.cholesky(gram), episodes, 0.2)
    assert (advantage < 0).any()
    assert (advantage > 0).any()
    exploration, variance = episodes.flat(episodes.actions) - policy.mean(x), policy.variance(x)
    elsewhere = rng.normal(size=(9, 2))
    step = np.zeros((9, 2))
    for j in range(2):
        a1 = np.diag(advantage / variance[:, j])
        alpha = np.linalg.inv(0.5 * np.linalg.inv(a1) + gram) @ exploration[:, j]
        step[:, j] = policy.mean.kernel(elsewhere, x) @ alpha
    np.testing.assert_allclose(moved.mean(elsewhere), policy.mean(elsewhere) + step, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("kernel", [RBF((0.02,)), RBF((0.02,)) * Polynomial(2.0, 1)], ids=["rbf", "product"])
def test_the_published_variance_matches_the_papers_formula(rng: np.random.Generator, kernel: Kernel) -> None:
    # The kernel functions are nearly orthogonal; the ridge of the sparsification changes them by 1e-7.
    policy = random_policy(rng, kernel=kernel)
    samples = Samples.in_newton_basis(policy, random_episodes(rng, policy, 3, 5, masked=True), 60)
    signed = rng.normal(size=len(samples.observations))
    variance = as_published(samples, signed, (0.1, 2.0))
    values = np.zeros((len(signed), 2))
    for i in range(2):
        total = sum(e**2 * a for e, a in zip(samples.exploration[:, i], signed, strict=True))
        for s, e, a in zip(samples.observations, samples.exploration[:, i], signed, strict=True):
            beta = e**2 * a / (kernel(s[None], s[None])[0, 0] * total)
            values[:, i] += beta * kernel(samples.observations, s[None])[:, 0]
    assert isinstance(variance, FunctionVariance)
    np.testing.assert_allclose(variance.function(samples.observations), values, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(variance(samples.observations), np.clip(values, 0.01, 4.0), rtol=1e-5)


@given(
    seed=st.integers(0, 10_000),
    scale=st.sampled_from([1e-12, 1.0, 1e12]),
    zeros=st.floats(0, 0.95),
    form=st.sampled_from(["newton", "grid", "quadratic"]),
    rule=st.sampled_from([learnt, as_published]),
)
def test_a_learnt_variance_is_within_its_bounds_for_any_weights(
    seed: int, scale: float, zeros: float, form: str, rule: Callable[..., KernelVariance | FunctionVariance]
) -> None:
    rng = np.random.default_rng(seed)
    kernel = Polynomial(0.0, 2) if form == "quadratic" else RBF((0.5,))
    policy = GaussianPolicy(Function.constant(kernel, 2, 2), ConstantVariance(np.ones(2)))
    shape = (4, 6)
    states, done = rng.normal(size=(*shape, 2)), rng.normal(scale=3, size=(*shape, 2))
    episodes = Episodes.without_ends(states, done, np.ones(shape), np.ones(shape, dtype=bool))
    samples = (
        Samples.in_newton_basis(policy, episodes, 8)
        if form == "newton"
        else Samples.on_centres(policy, episodes, np.eye(2))
    )
    q = scale * rng.uniform(size=24) * (rng.uniform(size=24) > zeros)
    q[0] = scale
    variance = rule(samples, q, (0.6, 0.9))(10 * rng.normal(size=(50, 2)))
    assert variance.shape == (50, 2)
    assert np.all((variance >= 0.6**2) & (variance <= 0.9**2))  # false for nan


def test_the_learnt_variance_is_a_kernel_weighted_mean_of_squared_exploration(rng: np.random.Generator) -> None:
    policy = random_policy(rng, kernel=RBF((0.4,)))
    samples = Samples.in_newton_basis(
        policy, random_episodes(rng, policy, 4, 5, masked=True), 60
    )  # each sample is a centre
    q = rng.uniform(size=len(samples.observations))
    x = rng.normal(size=(9, 2))
    expected = np.zeros((9, 2))
    for row, point in zip(expected, x, strict=True):
        near = q * np.exp(-0.5 * np.sum((samples.observations - point) ** 2, axis=1) / 0.4**2)
        row[:] = near @ samples.exploration**2 / near.sum()
    np.testing.assert_allclose(learnt(samples, q, (1e-3, 1e3))(x), expected, rtol=1e-8)


def test_each_sample_adds_to_the_variance_at_its_nearest_centre() -> None:
    policy = GaussianPolicy(Function.constant(RBF((1.0,)), 1, 1), ConstantVariance(np.ones(1)))
    states = np.array([[[0.1], [0.2], [3.8], [4.1]]])
    done = np.array([[[1.0], [2.0], [3.0], [5.0]]])
    episodes = Episodes.without_ends(states, done, np.ones((1, 4)), np.ones((1, 4), dtype=bool))
    samples = Samples.on_centres(policy, episodes, np.array([[0.0], [4.0], [8.0]]))
    variance = learnt(samples, np.array([1.0, 3.0, 2.0, 2.0]), (1e-3, 1e3))
    assert variance.centres.tolist() == [[0.0], [4.0]]  # no sample is close to the third
    np.testing.assert_allclose(variance.mass, [4.0, 4.0])
    np.testing.assert_allclose(variance.values[:, 0], [(1 + 3 * 4) / 4, (2 * 9 + 2 * 25) / 4])


over_powers = pytest.mark.parametrize("algorithm", [RKHSPoWER(reuse=3), PoWER(reuse=3)], ids=["rkhs_power", "power"])


@over_powers
def test_the_best_episodes_so_far_are_stored(rng: np.random.Generator, algorithm: WeightedExploration) -> None:
    policy, memory = random_policy(rng), None
    collected = [random_episodes(rng, policy, n, 8, masked=True) for n in (2, 6, 6)]
    for k, episodes in enumerate(collected):
        memory = algorithm.remembered(episodes if memory is None else episodes + memory, DISCOUNT)
        everything = [
            (sum(DISCOUNT**t * r for t, r in enumerate(rewards)), observations.tobytes())
            for some in collected[: k + 1]
            for rewards, observations in zip(some.rewards, some.observations, strict=True)
        ]
        best = sorted(everything, reverse=True)[:3]
        assert [o.tobytes() for o in memory.observations] == [observations for _, observations in best]
        np.testing.assert_allclose(memory.returns(DISCOUNT), [value for value, _ in best], rtol=1e-12)


@over_powers
def test_reused_episodes_count_like_new_ones(rng: np.random.Generator, algorithm: WeightedExploration) -> None:
    policy = random_policy(rng)
    episodes = random_episodes(rng, policy, 8)
    whole, split, forgotten = (
        learn(algorithm, policy, episodes.take(slice(n)), DISCOUNT, memory=memory).policy
        for n, memory in ((8, None), (5, episodes.take(slice(5, 8))), (5, None))
    )
    x = episodes.flat(episodes.observations)
    np.testing.assert_allclose(split.mean(x), whole.mean(x), rtol=1e-9)
    np.testing.assert_allclose(split.variance(x), whole.variance(x), rtol=1e-9)
    assert np.abs(split.mean(x) - forgotten.mean(x)).max() > 1e-3


def test_a_grid_has_as_many_numbers_as_the_policy_has_inputs(rng: np.random.Generator) -> None:
    policy = random_policy(rng, d=3)
    with pytest.raises(ValueError, match=r"algorithm\.grid: expected 3 numbers, or 3 for each of 3 inputs, got 6"):
        learn(PoWER(grid=(-1, 1, 3, -1, 1, 3)), policy, random_episodes(rng, policy))
    with pytest.raises(ValueError, match=r"algorithm\.grid: expected at most 100000 centres in total, got 1250"):
        learn(PoWER(grid=(-1, 1, 50)), policy, random_episodes(rng, policy))
    for grid in ((-1, 1, 2.5), (-1, 1, 0), (-1, 1)):
        with pytest.raises(ValueError, match=r"algorithm\.grid: expected lower end, upper end and whole number"):
            PoWER(grid=grid)
