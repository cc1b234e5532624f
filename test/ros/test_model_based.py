"""Model-based training over topics: bit-identical to training in process, while the other nodes wait."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest

from test.ros.conftest import ROOT, Process
from test.ros.test_same_bits import assert_same_bits, curve

Start = Callable[..., Process]
CONFIG = ROOT / "config" / "pendulum_wrap_model_nac.yaml"
SHORT = ("--quiet", "--seed", 7, "--iterations", 2)


@pytest.mark.nightly
def test_nodes_wait_while_the_learner_trains_longer_than_the_timeout(start: Start, tmp_path: Path) -> None:
    folder, timeout = tmp_path / "run", 1.0
    small = ("horizon=40", "evaluation_episodes=1", f"timeout={timeout}")
    long = ("model.updates=150", "model.rollouts=40", "model.centres=60", "algorithm.centres=30")
    run = start("rkhs", "train", CONFIG, *SHORT, "--out", folder, "--set", *small, *long)
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
    arrays = assert_same_bits(start, tmp_path, (config, *SHORT, "--set", *small, *model, *more), 2)
    inputs = json.loads(str(arrays["inputs"]))
    assert inputs["angles"] == [0.0]
    assert inputs["turns"] == [2.0 * math.pi]
    assert arrays["weights"].any()
    first, second = curve(tmp_path / "ros")
    assert float(first["model_return"]) > 0.0
    assert first["model_error"] == "nan"  # there was no model before
    assert float(second["model_error"]) > 0.0
