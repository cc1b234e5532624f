"""Every algorithm on every registered task, and with every kernel."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from rkhs_ros.experiments.config import Training, training_from
from rkhs_ros.experiments.rollout import InlineRunner
from rkhs_ros.experiments.training import Iteration, train
from rkhs_ros.learning.kernel_choice import KERNELS
from rkhs_ros.learning.registry import ALGORITHMS
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.kernels import kernel_from_terms
from sim_nodes.envs import TASKS
from sim_nodes.simulation import Simulation

BUDGET = 15
FORMS = [*KERNELS, *(f"{a} {sign} {b}" for a in KERNELS for b in KERNELS for sign in "+*")]
over_algorithms = pytest.mark.parametrize("algorithm", ALGORITHMS)
over_tasks = pytest.mark.parametrize("task", TASKS)
over_forms = pytest.mark.parametrize("form", FORMS)


def settings(algorithm: str, form: str = "rbf", seed: int = 0) -> Training:
    tree: dict[str, Any] = {
        "seed": seed,
        "iterations": 2,
        "episodes_per_iteration": 4,
        "evaluation_episodes": 2,
        "horizon": 20,
        "kernel": {"form": form},
        "algorithm": {"name": algorithm, "centres": BUDGET},
    }
    return training_from(tree)


def run(task: str, training: Training) -> Iterator[Iteration]:
    return train(training, InlineRunner(Simulation(task)))


def bits(policy: GaussianPolicy, x: np.ndarray) -> bytes:
    arrays = (policy.mean.centres, policy.mean.weights, policy.mean(x), policy.variance(x))
    return b"".join(array.tobytes() for array in arrays)


def assert_sound(iteration: Iteration) -> None:
    mean, metrics = iteration.policy.mean, iteration.metrics
    points = iteration.evaluation.flat(iteration.evaluation.observations)
    assert np.isfinite(mean.weights).all()
    assert len(mean.centres) == metrics.centres <= BUDGET
    assert np.isfinite(mean(points)).all()
    assert (iteration.policy.variance(points) > 0).all()
    assert np.isfinite([metrics.kl, metrics.step_size, metrics.sparsification_error]).all()
    assert metrics.kl >= -1e-12
    assert np.isfinite(iteration.train_returns).all()
    assert np.isfinite(iteration.mean_policy_returns).all()
    assert kernel_from_terms(mean.kernel.terms()) == mean.kernel


@over_tasks
@over_algorithms
def test_an_algorithm_makes_sound_policies_on_a_task(task: str, algorithm: str) -> None:
    for iteration in run(task, settings(algorithm)):
        assert_sound(iteration)
        assert iteration.metrics.kl > 0.0


@over_tasks
@over_algorithms
@over_forms
def test_an_algorithm_works_with_any_kernel(task: str, algorithm: str, form: str) -> None:
    for iteration in run(task, settings(algorithm, form)):
        assert_sound(iteration)


@over_tasks
@over_algorithms
def test_the_seed_determines_every_bit(task: str, algorithm: str) -> None:
    (*_, one), (*_, again), (*_, other) = (run(task, settings(algorithm, seed=seed)) for seed in (5, 5, 6))
    x = one.evaluation.flat(one.evaluation.observations)
    assert bits(one.policy, x) == bits(again.policy, x)
    assert np.array_equal(one.train_returns, again.train_returns)
    assert np.array_equal(one.mean_policy_returns, again.mean_policy_returns)
    assert bits(one.policy, x) != bits(other.policy, x)
    assert not np.any(one.train_returns == other.train_returns)
