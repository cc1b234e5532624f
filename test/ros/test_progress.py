"""The progress of a run, as viewers receive it."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from rkhs_interfaces.msg import LearningProgress
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from test.ros.conftest import PATIENCE, ROOT, Probe, Process

ITERATIONS = 12


def test_the_progress_equals_the_curve(start: Callable[..., Process], probe: Probe, tmp_path: Path) -> None:
    heard: list[Any] = []
    probe.create_subscription(LearningProgress, "progress", heard.append, LATCHED_QOS)
    folder, config = tmp_path / "out", ROOT / "config" / "toy_nac.yaml"
    run = start("rkhs", "train", config, "--quiet", "--iterations", ITERATIONS, "--out", folder)
    probe.until(lambda: bool(heard) and heard[-1].iteration == ITERATIONS, 2 * PATIENCE)
    run.finish()
    rows, last = list(csv.DictReader((folder / "curve.csv").open())), heard[-1]
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
