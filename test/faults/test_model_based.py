"""Killing nodes during model-based training leaves the learning curve and the policy bit-identical."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from test.faults.runs import assert_same_bits, curve
from test.faults.test_kills import wait_for
from test.ros.conftest import ROOT, Process, kill, nodes_of

Start = Callable[..., Process]
CONFIG = ROOT / "config" / "pendulum_wrap_model_nac.yaml"
LONG = ("horizon=40", "timeout=60", "model.updates=60", "model.rollouts=50", "model.centres=60")
ARGUMENTS = ("--quiet", "--iterations", 4, "--seed", 3)


@pytest.fixture(scope="session")
def model_update(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train in one process; other tests show that a run over topics is bit-identical."""
    folder = tmp_path_factory.mktemp("runs") / "model_based"
    process = Process("rkhs", "train", CONFIG, *ARGUMENTS, "--runner", "inline", "--out", folder, "--set", *LONG)
    assert process.finish()[0] == 0
    return folder


def kill_during_training(run: Process, folder: Path, name: str, draws: np.random.Generator) -> None:
    """Kill nodes at random times of an iteration, most of which is model-based training."""
    wait_for(lambda: len(curve(folder)) > 1, run)
    for iteration in range(2, 4):
        time.sleep(draws.uniform(0.0, 0.6))
        victims = nodes_of(run, name)
        assert victims
        kill(int(draws.choice(victims)))
        wait_for(lambda: len(curve(folder)) > iteration, run)  # noqa: B023  # awaited here


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ["learner", "policy", "simulator"])
def test_nodes_killed_during_model_based_training_leave_the_results_bit_identical(
    start: Start, tmp_path: Path, model_update: Path, name: str
) -> None:
    folder = tmp_path / "killed"
    run = start("rkhs", "train", CONFIG, *ARGUMENTS, "--out", folder, "--set", *LONG)
    kill_during_training(run, folder, name, np.random.default_rng(len(name)))
    code, _, err = run.finish()
    assert code == 0, err
    assert "Traceback" not in err
    assert err.count("killed by signal 9") == 2
    assert_same_bits(folder, model_update)
