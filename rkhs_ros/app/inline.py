"""Runs in this process, on any task: those of the project are registered here."""

from __future__ import annotations

from collections.abc import Iterator

import sim_nodes.envs  # noqa: F401  # registers the tasks
from rkhs_ros.learning.training import Iteration, train
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.rollout import InlineRunner
from rkhs_ros.runs.simulation import Simulation


def iterations(config: Config) -> Iterator[Iteration]:
    """Make the run of a configuration, yielding each iteration as it is done."""
    return train(config.training, InlineRunner(Simulation(config.environment.id, config.environment.options)))
