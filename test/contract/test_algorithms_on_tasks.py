"""All algorithms on one task, with all pairs of their choices; one of each kind with all kernels and on all tasks.

Choices, kernels and tasks are independent of each other: what an algorithm sees of a task are dimensions and rewards.
"""

from collections.abc import Iterator
from dataclasses import fields
from itertools import product
from typing import Any

import numpy as np
import pytest

from rkhs_ros.base.settings import build
from rkhs_ros.learning.algorithms.function_spaces import Grid
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.kernel_choice import KERNELS, MONOMIALS
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.kernels import kernel_from_terms
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from sim_nodes.envs import TASKS

SIZES = {"rkhs/PendulumPOMDP-v0": 2, "rkhs/CartPoleSwingUp-v0": 2}  # of the grid, per dimension
WINDOWS = {"rkhs/PendulumPOMDP-v0": 3}
TASK = "rkhs/Pendulum-v0"
BUDGET = 15
TRIES = 50  # of a line search
JOINED = [form for form in KERNELS if form != MONOMIALS]
FORMS = [*KERNELS, *(f"{a} {sign} {b}" for a in JOINED for b in JOINED for sign in "+*")]
FREE, ON_GRID = "rkhs_nac", "power"  # an algorithm with centres of its own, and one with a grid


def choices() -> Iterator[Any]:
    """Yield the combinations of an algorithm's choices and step rules in which at most two are not the first one."""
    for name, cls in ALGORITHMS.items():
        offered: dict[str, list[Any]] = {}
        for f in fields(cls):
            if f.metadata.get("choices"):
                offered[f.name] = list(f.metadata["choices"])
            elif f.name == "step":
                offered[f.name] = [{"rule": rule} for rule in f.metadata["table"]]
        for values in product(*offered.values()):
            if sum(value != all_of[0] for value, all_of in zip(values, offered.values(), strict=True)) > 2:
                continue
            words = [value["rule"] if isinstance(value, dict) else value for value in values]
            yield pytest.param(name, dict(zip(offered, values, strict=True)), id="-".join([name, *words]))


def settings(task: str, algorithm: str, form: str = "rbf", seed: int = 0, **changes: Any) -> Training:
    on_grid = issubclass(ALGORITHMS[algorithm], Grid)
    size = {"grid": [-4.0, 4.0, SIZES.get(task, 3)]} if on_grid else {"centres": BUDGET}
    # A window contains the policy's unclipped actions, of which a polynomial can grow without bound.
    history = WINDOWS.get(task, 1) if "polynomial" not in form and form != "linear * linear" else 1
    tree: dict[str, Any] = {
        "seed": seed,
        "iterations": 2,
        "episodes_per_iteration": 3,
        "evaluation_episodes": 1,
        "horizon": 12,
        "inputs": {"history": history},
        "kernel": {"form": form, "degree": 2, **({"bandwidth": 4.0} if on_grid else {})},
        "algorithm": {"name": algorithm, **size, **changes},
        "action_repeat": 1,
        "model": {"form": "none"},
    }
    return build(Training, tree)


def run(task: str, training: Training) -> Iterator[Iteration]:
    return train(training, InlineRunner(Simulation(task)))


def bits(policy: GaussianPolicy, x: np.ndarray) -> bytes:
    arrays = (policy.mean.centres, policy.mean.weights, policy.mean(x), policy.variance(x))
    return b"".join(array.tobytes() for array in arrays)


def assert_sound(iteration: Iteration, task: str, training: Training) -> None:
    mean, metrics = iteration.policy.mean, iteration.metrics
    evaluation = iteration.evaluation.with_inputs(iteration.policy.inputs)
    points = evaluation.flat(evaluation.observations)
    on_grid = isinstance(training.algorithm, Grid)
    assert np.isfinite(mean.weights).all()
    assert len(mean.centres) == metrics.centres <= (SIZES.get(task, 3) ** mean.input_dim if on_grid else BUDGET)
    assert np.isfinite(mean(points)).all()
    assert (iteration.policy.variance(points) > 0).all()
    assert np.isfinite([metrics.kl, metrics.step_size, metrics.sparsification_error]).all()
    assert metrics.kl >= -1e-12
    assert np.isfinite(iteration.exploration_returns).all()
    assert np.isfinite(iteration.evaluation_returns).all()
    assert kernel_from_terms(mean.kernel.terms()) == mean.kernel


@pytest.mark.parametrize(("algorithm", "chosen"), choices())
def test_every_choice_of_an_algorithm_gives_sound_policies(algorithm: str, chosen: dict[str, Any]) -> None:
    training = settings(TASK, algorithm, **chosen)
    tried = TRIES if chosen.get("step") == {"rule": "line_search"} else 0
    for iteration in run(TASK, training):
        assert_sound(iteration, TASK, training)
        assert iteration.metrics.kl > 0.0
        assert iteration.episodes_used == iteration.number * (3 + tried)


@pytest.mark.parametrize(
    ("algorithm", "form"), sorted({*product([FREE], FORMS), *product(ALGORITHMS, KERNELS), (ON_GRID, FORMS[-1])})
)
def test_algorithms_work_with_all_kernels(algorithm: str, form: str) -> None:
    learns_variance = "variance" in {f.name for f in fields(ALGORITHMS[algorithm])}
    # Kernels with negative values cannot be weights of a mean.
    constant = {"variance": "constant"} if learns_variance and "linear" in form else {}
    training = settings(TASK, algorithm, form, **constant)
    for iteration in run(TASK, training):
        assert_sound(iteration, TASK, training)


@pytest.mark.parametrize(
    ("task", "algorithm"), sorted({*product(TASKS, [FREE, ON_GRID]), *product([TASK], ALGORITHMS)})
)
def test_equal_seeds_give_bit_identical_results(task: str, algorithm: str) -> None:
    training = settings(task, algorithm, seed=5)
    one, again = list(run(task, training)), list(run(task, training))
    *_, other = run(task, settings(task, algorithm, seed=6))
    for iteration in one:
        assert_sound(iteration, task, training)
        assert iteration.metrics.kl > 0.0 or task == "rkhs/Furuta-v0"  # its rewards are tiny at first
    evaluation = one[-1].evaluation.with_inputs(one[-1].policy.inputs)
    x = evaluation.flat(evaluation.observations)
    assert bits(one[-1].policy, x) == bits(again[-1].policy, x)
    assert np.array_equal(one[-1].exploration_returns, again[-1].exploration_returns)
    assert np.array_equal(one[-1].evaluation_returns, again[-1].evaluation_returns)
    assert bits(one[-1].policy, x) != bits(other.policy, x)
    assert not np.any(one[-1].exploration_returns == other.exploration_returns)
