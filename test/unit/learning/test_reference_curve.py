"""The learning curve of one run, stored to detect changes of its results."""

import csv
from pathlib import Path

import numpy as np

from rkhs_ros.learning.training import train
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import columns

ROOT = Path(__file__).parents[3]
KEPT = Path(__file__).with_name("pendulum_nac_seed_0.csv")
# Processors and versions of libraries round differently, so only the first iterations agree to these digits.
SOME, DIGITS = 5, 1e-6


def test_the_pendulum_curve_agrees_with_the_reference() -> None:
    config = load_config(ROOT / "config" / "pendulum_nac.yaml", ["seed=0"])
    runner = InlineRunner(Simulation(config.environment.id, config.environment.options))
    got = columns([iteration.row(0.0) for iteration in train(config.training, runner)])
    with KEPT.open(newline="") as file:
        lines = list(csv.DictReader(file))
    # The optimum is 51.8 and the first policy earns about 5; this seed ends at 51.5, so the margin is wide.
    assert got["evaluation_return"][-1] > 50.0
    for name in lines[0]:
        expected = [float(line[name]) for line in lines[:SOME]]
        np.testing.assert_allclose(got[name][:SOME], expected, rtol=DIGITS, atol=DIGITS, err_msg=name)
