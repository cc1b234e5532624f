"""Runs over topics and in process have bit-identical curves, policies and recordings."""

import csv
import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from rkhs_ros.app.cli import main
from rkhs_ros.recordings.recording import read_recording
from test.ros.conftest import ROOT, Process
from test.unit.recordings.recorded_runs import content

Start = Callable[..., Process]
SHORT = ("--quiet", "--iterations", 3, "--seed", 7)
WRAPPED = ROOT / "config" / "pendulum_wrap_model_nac.yaml"
MODEL = ("--quiet", "--seed", 7, "--iterations", 2)


def curve(folder: Path) -> list[dict[str, str]]:
    rows = list(csv.DictReader((folder / "curve.csv").open()))
    return [{name: value for name, value in row.items() if name != "seconds"} for row in rows]


def assert_same_bits(start: Start, folder: Path, arguments: tuple[object, ...], iterations: int) -> dict[str, Any]:
    """Train over topics and in this process; return the arrays of the policy, which must be the same."""
    over_topics = start("rkhs", "train", *arguments, "--runner", "ros", "--out", folder / "ros")
    with threadpool_limits(1), pytest.raises(SystemExit) as end:  # as many threads as the processes have
        main(["train", *map(str, arguments), "--runner", "inline", "--out", str(folder / "inline")])
    assert end.value.code == 0
    code, out, err = over_topics.finish()
    assert (code, err) == (0, "")
    assert out.count("\n") == 5
    assert curve(folder / "ros") == curve(folder / "inline")
    assert len(curve(folder / "ros")) == iterations
    with np.load(folder / "ros" / "policy.npz") as a, np.load(folder / "inline" / "policy.npz") as b:
        assert a.files == b.files
        assert all(np.array_equal(a[name], b[name]) for name in a.files)
        arrays = dict(a)
    for name in ("config.yaml", "final_evaluation.txt"):
        assert (folder / "ros" / name).read_text() == (folder / "inline" / name).read_text()
    recorded, alone = (read_recording(folder / name) for name in ("ros", "inline"))
    assert content(recorded) == content(alone)
    assert recorded.head.task == alone.head.task
    return arrays


SHORT_EPISODES = ("episodes_per_iteration=3", "evaluation_episodes=1", "timeout=60")
# Together these use all that goes over topics: inputs, kernels, the three variances, held actions,
# and options of an environment.
RUNS = {
    "function variance": (
        "rkhs/Toy-v0",
        "rkhs_power",
        ("kernel.form=monomials", "kernel.degree=5", "kernel.offset=0.2", "horizon=12",
         "algorithm.centres=15", "algorithm.variance=as_published", "algorithm.reuse=2", "discount=0.9"),
    ),
    "kernel variance": (
        "rkhs/Pendulum-v0",
        "power",
        ("environment.options.angle=wrap", "inputs.angles=[0]", "kernel.bandwidth=3.0", "horizon=200",
         "algorithm.grid=[-2,2,3]", "exploration_sd=[2.0]",
         "algorithm.variance=learnt", "action_repeat=auto"),
    ),
    "learnt variance": (
        "rkhs/PendulumPOMDP-v0",
        "rkhs_nac",
        ("inputs.history=3", "inputs.angles=[0]", "algorithm.centres=20", "algorithm.critic=trajectory", "horizon=20",
         "algorithm.variance=learnt", "algorithm.reuse=2"),
    ),
}  # fmt: skip
ARRAYS = {"function variance": {"variance_centres"}, "kernel variance": {"variance_centres", "variance_mass"}}


@pytest.mark.parametrize("name", RUNS)
def test_training_over_topics_is_bit_identical_to_in_process(start: Start, tmp_path: Path, name: str) -> None:
    task, algorithm, changes = RUNS[name]
    config = tmp_path / "run.yaml"
    simulator = f"simulator: {{ros__parameters: {{environment: {{id: {task}}}}}}}\n"
    parts = f"{{algorithm: {{name: {algorithm}}}, model: {{form: none}}, action_repeat: 1}}"
    config.write_text(simulator + f"learner: {{ros__parameters: {parts}}}\n")
    arrays = assert_same_bits(start, tmp_path, (config, *SHORT, "--set", *SHORT_EPISODES, *changes), 3)
    assert arrays.keys() & {"variance_centres", "variance_mass"} == ARRAYS.get(name, set())
    assert arrays["action_repeat"] == {"kernel variance": 2}.get(name, 1)
    assert arrays["weights"].any()


@pytest.mark.nightly
def test_nodes_wait_while_the_learner_trains_longer_than_the_timeout(start: Start, tmp_path: Path) -> None:
    folder, timeout = tmp_path / "run", 1.0
    small = ("horizon=40", "evaluation_episodes=1", f"timeout={timeout}")
    long = ("model.updates=150", "model.rollouts=40", "model.centres=60", "algorithm.centres=30")
    run = start("rkhs", "train", WRAPPED, *MODEL, "--out", folder, "--set", *small, *long)
    code, _, err = run.finish()
    assert (code, err) == (0, "")  # nor was a node started again
    first, second = (float(row) for row in seconds(folder))
    assert second - first > timeout, "training was too short for the test"


def seconds(folder: Path) -> list[str]:
    return [line.rpartition(",")[2] for line in (folder / "curve.csv").read_text().splitlines()[1:]]


def test_inputs_that_change_during_a_run_are_bit_identical_over_topics(start: Start, tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    environment = "{id: rkhs/Pendulum-v0, options: {angle: wrap}}"
    config.write_text(f"simulator: {{ros__parameters: {{environment: {environment}}}}}\n")
    small = ("horizon=60", "episodes_per_iteration=2", "evaluation_episodes=1", "timeout=60", "algorithm.centres=20")
    model = ("model.form=gaussian_process", "model.updates=3", "model.rollouts=10")
    more = ("model.centres=40", "exploration_sd=range")
    arrays = assert_same_bits(start, tmp_path, (config, *MODEL, "--set", *small, *model, *more), 2)
    inputs = json.loads(str(arrays["inputs"]))
    assert inputs["angles"] == [0.0]
    assert inputs["turns"] == [2.0 * math.pi]
    assert arrays["weights"].any()
    first, second = curve(tmp_path / "ros")
    assert float(first["model_return"]) > 0.0
    assert first["model_error"] == "nan"  # there was no model before
    assert float(second["model_error"]) > 0.0


def test_episodes_that_end_early_are_bit_identical_over_topics(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT), prepend=os.pathsep)
    env = ("--env", "test.unit.rollouts.test_env_batch:test/Countdown-v0")
    small = ("episodes_per_iteration=4", "evaluation_episodes=2", "horizon=20", "timeout=60", "model.form=none")
    assert_same_bits(start, tmp_path, (*env, *MODEL, "--set", *small), 2)
    episodes = read_recording(tmp_path / "ros").last_episodes()
    assert set(episodes.terminated) == {True, False}
    assert (episodes.mask.sum(axis=1) < 9).all()
