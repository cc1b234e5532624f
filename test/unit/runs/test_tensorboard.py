"""TensorBoard reads the rows of curve.csv exactly once, also after a resume."""

from collections.abc import Callable
from math import isfinite
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.run import run_training
from test.unit.conftest import Result, assert_refused, model_free
from test.unit.runs.stopping import Stopping

TRAINING = model_free(name="short", iterations=4, episodes_per_iteration=2, evaluation_episodes=1, horizon=4)
CONFIG = Config(Environment("rkhs/Toy-v0", {}), TRAINING)
CONFIG_FILE = Path(__file__).parents[3] / "config" / "toy_nac.yaml"


@pytest.mark.parametrize("from_start", [True, False])
def test_tensorboard_reads_each_row_once_after_a_resume(from_start: bool, tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    with pytest.raises(KeyboardInterrupt):
        run_training(CONFIG, Stopping(5), tmp_path, quiet=True, tensorboard=from_start)
    run_training(CONFIG, Stopping(), tmp_path, quiet=True, resume=True, tensorboard=not from_start)
    read = reader.EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    rows = Curve(tmp_path / "curve.csv").rows()
    for name in read.Tags()["scalars"]:
        expected = [(row.iteration, np.float32(getattr(row, name))) for row in rows if isfinite(getattr(row, name))]
        assert [(scalar.step, scalar.value) for scalar in read.Scalars(name)] == expected


def test_a_missing_package_is_reported_before_the_run(
    rkhs: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rkhs_ros.base.validation.find_spec", lambda name: None)
    expected = "--tensorboard: expected tensorboardX to be installed"
    assert_refused(rkhs("train", CONFIG_FILE, "--tensorboard", "--out", "run"), expected)
    assert not (tmp_path / "run").exists()
