"""Runs in this process, on any task: those of the project are registered here."""

from __future__ import annotations

from collections.abc import Iterator

import sim_nodes.envs  # noqa: F401  # registers the tasks
from rkhs_ros.learning.training import Iteration, train
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.rollout import InlineRunner
from rkhs_ros.runs.simulation import Simulation


def simulation_of(environment: Environment) -> Simulation:
    """Return the simulation of a configured environment."""
    return Simulation(environment.id, environment.options, environment.rows_at_once)


def iterations(config: Config) -> Iterator[Iteration]:
    """Make the run of a configuration, yielding each iteration as it is done."""
    return train(config.training, InlineRunner(simulation_of(config.environment)))
