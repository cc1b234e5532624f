"""Runs over topics and in process have bit-identical curves and policies."""

import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from rkhs_ros.app.cli import main
from rkhs_ros.learning.algorithms.function_spaces import GridSettings
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from sim_nodes.envs import TASKS
from test.ros.conftest import ROOT, Process

LEARNT = ("algorithm.variance=learnt", "algorithm.reuse=2")
Start = Callable[..., Process]
SHORT = ("--quiet", "--iterations", 3, "--seed", 7)


def curve(folder: Path) -> list[dict[str, str]]:
    rows = list(csv.DictReader((folder / "curve.csv").open()))
    return [{name: value for name, value in row.items() if name != "seconds"} for row in rows]


def settings(task: str, algorithm: str) -> Iterator[str]:
    """Yield settings of short runs that differ in all that goes over topics: inputs, kernels, variances, tries."""
    grid = issubclass(ALGORITHMS[algorithm], GridSettings)
    yield from ("episodes_per_iteration=3", "evaluation_episodes=1", "horizon=12", "timeout=60")
    yield from {
        "rkhs/Toy-v0": ["inputs.degree=2" if grid else "inputs.degree=5", "inputs.offset=0.2"],
        "rkhs/Pendulum-v0": ["environment.options.angle=wrap", "inputs.angles=[0]"],
        "rkhs/PendulumPOMDP-v0": ["inputs.history=3", "inputs.angles=[0]"],
        "rkhs/CartPoleSwingUp-v0": ["environment.options.observation=wrapped", "environment.options.rail=2.5"],
    }[task]
    if grid:
        yield from ("algorithm.grid_low=-2", "algorithm.grid_high=2", "kernel.bandwidth=3.0")
        yield f"algorithm.grid_counts={2 if task in ('rkhs/PendulumPOMDP-v0', 'rkhs/CartPoleSwingUp-v0') else 3}"
    else:
        yield "algorithm.centres=15"
        if task == "rkhs/Toy-v0":
            yield from ("kernel.form=polynomial", "kernel.offset=0", "kernel.degree=1")
    search = ["algorithm.step.rule=line_search", "algorithm.step.choices=3", "algorithm.step.episodes=2"]
    yield from {
        "rkhs_ac": search,
        "rkhs_npg": ["algorithm.baseline=value"],
        "rkhs_nac": ["algorithm.critic=trajectory", "algorithm.ridge_norm=scale_free", *LEARNT],
        "rkhs_power": ["algorithm.variance=as_published", "algorithm.reuse=2"],
        "ac": ["algorithm.regression=pursuit"],
        "enac": search,
        "power": ["algorithm.solution=diagonal", "exploration_sd=[2.0]"],
    }[algorithm]


def assert_same_bits(
    start: Start, folder: Path, arguments: tuple[object, ...], iterations: int, runner: str = "ros"
) -> dict[str, Any]:
    """Train over topics and in this process; return the arrays of the policy, which must be the same."""
    over_topics = start("rkhs", "train", *arguments, "--runner", runner, "--out", folder / "ros")
    with threadpool_limits(1), pytest.raises(SystemExit) as end:  # as many threads as the processes have
        main(["train", *map(str, arguments), "--runner", "inline", "--out", str(folder / "inline")])
    assert end.value.code == 0
    code, out, err = over_topics.finish()
    assert (code, err) == (0, "")
    assert out.count("\n") == 4
    assert curve(folder / "ros") == curve(folder / "inline")
    assert len(curve(folder / "ros")) == iterations
    with np.load(folder / "ros" / "policy.npz") as a, np.load(folder / "inline" / "policy.npz") as b:
        assert a.files == b.files
        assert all(np.array_equal(a[name], b[name]) for name in a.files)
        arrays = dict(a)
    assert (folder / "ros" / "config.yaml").read_text() == (folder / "inline" / "config.yaml").read_text()
    return arrays


def pairs() -> Iterator[Any]:
    """Yield every algorithm with every task; one for each task is for `make test`."""
    for i, algorithm in enumerate(ALGORITHMS):
        for k, task in enumerate(TASKS):
            yield pytest.param(algorithm, task, marks=() if (i + k) % len(ALGORITHMS) == 0 else pytest.mark.faults)


@pytest.mark.parametrize(("algorithm", "task"), pairs())
def test_training_over_topics_is_bit_identical_to_in_process(
    start: Start, tmp_path: Path, algorithm: str, task: str
) -> None:
    config = tmp_path / "run.yaml"
    simulator = f"simulator: {{ros__parameters: {{environment: {{id: {task}}}}}}}\n"
    config.write_text(simulator + f"learner: {{ros__parameters: {{algorithm: {{name: {algorithm}}}}}}}\n")
    arguments = ("--quiet", "--seed", 7, "--iterations", 2, "--set", *settings(task, algorithm))
    arrays = assert_same_bits(start, tmp_path, (config, *arguments), 2)
    kind = {"rkhs_power": "function", "power": "kernel"}.get(algorithm, "constant")
    assert ("variance_centres" in arrays, "variance_mass" in arrays) == (kind != "constant", kind == "kernel")
    assert arrays["weights"].any()


@pytest.mark.parametrize(
    ("config", "changes"),
    [
        ("toy_power", ("kernel.form=rbf + polynomial", "kernel.degree=2", "discount=0.9")),
        ("pendulum_v1", ("horizon=30", "episodes_per_iteration=5")),
    ],
)
def test_a_run_over_topics_equals_the_run_in_process(
    start: Start, tmp_path: Path, config: str, changes: tuple[str, ...]
) -> None:
    assert_same_bits(start, tmp_path, (ROOT / "config" / f"{config}.yaml", *SHORT, "--set", *changes), 3)


def test_composed_nodes_leave_the_results_bit_identical(start: Start, tmp_path: Path) -> None:
    config = ROOT / "config" / "pendulum_pomdp_nac.yaml"
    small = ("algorithm.centres=20", "horizon=20", "episodes_per_iteration=5", "evaluation_episodes=2", "timeout=60")
    assert_same_bits(start, tmp_path, (config, *SHORT, "--set", *small), 3, runner="composed")


@pytest.mark.parametrize("simulators", [pytest.param(2, marks=pytest.mark.faults), 3])
def test_the_number_of_simulators_leaves_the_results_bit_identical(
    start: Start, tmp_path: Path, simulators: int
) -> None:
    config = ROOT / "config" / "pendulum_pomdp_nac.yaml"
    small = ("algorithm.centres=20", "horizon=20", "episodes_per_iteration=5", "evaluation_episodes=2", "timeout=60")
    # With 3 simulators and 2 evaluation episodes one has nothing to do.
    assert_same_bits(start, tmp_path, (config, *SHORT, "--simulators", simulators, "--set", *small), 3)


@pytest.mark.parametrize("simulators", [pytest.param(1, marks=pytest.mark.faults), 2])
def test_the_pr2_moves_identically_over_topics_and_in_process(start: Start, tmp_path: Path, simulators: int) -> None:
    pytest.importorskip("pybullet", reason="the PR2 needs PyBullet")
    config = ROOT / "config" / "pr2_door_contextual.yaml"
    small = ("episodes_per_iteration=4", "evaluation_episodes=2", "timeout=60")
    assert_same_bits(start, tmp_path, (config, *SHORT, "--simulators", simulators, "--set", *small), 3)


@pytest.mark.faults
def test_parallel_runs_in_different_domains_are_isolated(
    start: Start, tmp_path: Path, domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = ROOT / "config" / "toy_nac.yaml"
    alone = start("rkhs", "train", config, *SHORT, "--out", tmp_path / "alone").finish()
    first = start("rkhs", "train", config, *SHORT, "--out", tmp_path / "first")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain + 101))  # outside the range that tests take theirs from
    second = start("rkhs", "train", config, *SHORT[:-1], 8, "--out", tmp_path / "second")
    assert [alone[0], first.finish()[0], second.finish()[0]] == [0, 0, 0]
    assert curve(tmp_path / "first") == curve(tmp_path / "alone")
    assert curve(tmp_path / "second") != curve(tmp_path / "alone")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [(("action_repeat=auto",), 4), (("action_repeat=3", "inputs.history=2"), 3)],
)
def test_held_actions_are_bit_identical_over_topics_and_in_process(
    start: Start, tmp_path: Path, changes: tuple[str, ...], expected: int
) -> None:
    config = tmp_path / "run.yaml"
    config.write_text("simulator: {ros__parameters: {environment: {id: rkhs/Pendulum-v0}}}\n")
    small = ("episodes_per_iteration=4", "evaluation_episodes=1", "horizon=200", "timeout=60", "algorithm.centres=15")
    arrays = assert_same_bits(start, tmp_path, (config, *SHORT, "--set", *small, *changes), 3)
    assert arrays["action_repeat"] == expected
