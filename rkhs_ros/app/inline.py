"""Runs and policies in this process, on any task: those of the project are registered here."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import sim_nodes.envs  # noqa: F401  # registers the tasks
from rkhs_ros.base.validation import require
from rkhs_ros.learning.training import Iteration, train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.storage import Task, load_policy
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.report import last_policy
from rkhs_ros.runs.rollout import InlineRunner
from rkhs_ros.runs.simulation import Simulation


def runner_of(environment: Environment) -> InlineRunner:
    """Return where policies can act in an environment.

    Raises:
        ValueError: the environment is unknown, its options do not fit, or a space is not continuous; or it is a robot.
    """
    where = "an environment of this process, not a robot, which is there over topics alone"
    require(not environment.nodes, environment.id, where, "a robot")
    return InlineRunner(Simulation(environment.id, environment.options, environment.rows_at_once))


def iterations(config: Config) -> Iterator[Iteration]:
    """Make the run of a configuration, yielding each iteration as it is done."""
    return train(config.training, runner_of(config.environment))


def load_acting(path: Path) -> tuple[GaussianPolicy, Task, InlineRunner]:
    """Return a policy, its task and where it can act.

    Args:
        path: a policy file, or a run's folder, of which it is the last policy.

    Raises:
        ValueError: the folder holds no policy yet, the file is damaged, or its policy does not fit its task.
        OSError: the file cannot be read.
    """
    path = last_policy(path) if path.is_dir() else path
    policy, task = load_policy(path)
    require(task.environment != "", f"{path}", "a policy that names its environment", "one of none (see imitate --env)")
    runner = runner_of(Environment(task.environment, task.options))
    spaces = runner.spaces
    input_dim = policy.inputs.dimension(spaces.observation_dim, spaces.action_dim)
    require(
        (input_dim, spaces.action_dim) == (policy.mean.input_dim, policy.mean.output_dim),
        f"{path}",
        f"a policy from {input_dim} to {spaces.action_dim} dimensions, as {task.environment} has",
        f"{policy.mean.input_dim} to {policy.mean.output_dim}",
    )
    return policy, task, runner
