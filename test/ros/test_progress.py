"""The progress of a run, as viewers receive it."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rkhs_interfaces.msg import LearningProgress
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.lockstep.learner_node import PERIOD_S
from test.ros.conftest import PATIENCE, ROOT, Probe, Process

Start = Callable[..., Process]
TOY = ROOT / "config" / "toy_nac.yaml"
ITERATIONS = 12


def hear(probe: Probe) -> list[Any]:
    heard: list[Any] = []
    probe.create_subscription(LearningProgress, "progress", heard.append, LATCHED_QOS)
    return heard


def curve(folder: Path) -> list[dict[str, str]]:
    if not (folder / "curve.csv").exists():
        return []
    with (folder / "curve.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "out"


def test_the_progress_equals_the_curve(start: Start, probe: Probe, folder: Path) -> None:
    heard = hear(probe)
    run = start("rkhs", "train", TOY, "--quiet", "--iterations", ITERATIONS, "--out", folder)
    probe.until(lambda: bool(heard) and heard[-1].iteration == ITERATIONS, 2 * PATIENCE)
    run.finish()
    rows, last = curve(folder), heard[-1]
    assert (last.run, last.folder, last.iterations) == ("toy_nac", str(folder), ITERATIONS)
    for message in heard:
        if message.iteration == 0:
            assert np.isnan(message.exploration_return)
            continue
        for name, text in rows[message.iteration - 1].items():
            assert str(getattr(message, name)) == text
    assert list(last.last_iterations) == list(range(1, ITERATIONS + 1))
    for name in ("exploration_return", "evaluation_return", "model_return"):
        assert [str(value) for value in getattr(last, f"last_{name}s")] == [row[name] for row in rows]
    assert last.seconds_left == 0.0
    first, end = (message.stamp.sec + 1e-9 * message.stamp.nanosec for message in (heard[0], last))
    assert len(heard) <= 3 + (end - first) / PERIOD_S  # the first and the last come at once
