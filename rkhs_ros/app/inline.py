"""Runs and policies in this process; importing this module registers the project's tasks."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from gymnasium import registry

import sim_nodes.envs  # noqa: F401  # registers the tasks
from rkhs_ros.base.validation import require
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.training import train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, load_policy
from rkhs_ros.rollouts.environments import time_limit
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import ENVIRONMENT, Config, Environment, config_for, tree_of
from rkhs_ros.runs.report import last_policy

OF_PYTHON = (
    "A command cannot create a class or function that was passed to rkhs_ros.train: pass it to rkhs_ros.evaluate, or "
    "to rkhs_ros.train with resume=True"
)


def runner_of(environment: Environment) -> InlineRunner:
    """Return a runner of policies in an environment.

    Raises:
        ValueError: the environment is unknown or a robot, its options do not fit, or a space is not continuous.
    """
    require(not environment.nodes, environment.id, "an environment of this process", "a robot, which needs topics")
    try:
        return InlineRunner(Simulation(environment.id, environment.options, environment.num_envs))
    except ValueError as error:
        if ENVIRONMENT.search(environment.id) or environment.id in registry:
            raise
        raise ValueError(f"{error}. {OF_PYTHON}") from error


def spaces_of(environment: Environment) -> Spaces:
    """Return the spaces of an environment, and close it.

    Raises:
        ValueError: the environment is unknown or a robot, its options do not fit, or a space is not continuous.
    """
    with runner_of(environment) as runner:
        return runner.spaces


def untuned_config(environment: str, changes: Sequence[str]) -> Config:
    """Return the configuration of a run on an environment with the default settings and its own time limit.

    Args:
        environment: Gymnasium id.
        changes: settings that replace the defaults, such as ``algorithm.ridge=0.1``.

    Raises:
        ValueError: the id is unknown, or a setting is unknown or invalid.
    """
    section = tree_of(changes).get("environment")
    options = section.get("options") if isinstance(section, Mapping) else None
    limit = time_limit(environment, options if isinstance(options, Mapping) else {})
    return config_for(environment, limit, changes)


def warn_of_horizon(simulation: Simulation, horizon: int, *, given: bool) -> None:
    """Print a note if the horizon differs from the time limit of the environment.

    Args:
        simulation: simulation of the environment.
        horizon: steps of an episode.
        given: whether the user set the horizon.
    """
    name, limit = simulation.environment, simulation.time_limit
    if limit is None and not given:
        note = f"{name} declares no time limit; episodes end after {horizon} steps. Set horizon=N to change that"
    elif limit not in (None, horizon):
        note = f"{horizon} steps, instead of the {limit} steps of {name}"
    else:
        return
    print(f"note: horizon: {note}", file=sys.stderr)


def iterations(config: Config) -> Iterator[Iteration]:
    """Run the training of a configuration, and yield each iteration."""
    with runner_of(config.environment) as runner:
        yield from train(config.training, runner)


@contextmanager
def load_acting(path: Path, environment: str | None = None) -> Iterator[tuple[GaussianPolicy, Task, InlineRunner]]:
    """Load a policy; yield it with its task and a runner, which closes when the context exits.

    Args:
        path: a policy file, or the folder of a run, which stands for its last policy.
        environment: id that the file must name if it names an environment.

    Raises:
        ValueError: the folder contains no policy yet, the file is damaged, or the policy does not fit its task.
    """
    path = policy_file(path)
    policy, task = load_policy(path)
    named = task.environment or environment or ""
    require(named != "", f"{path}", "a policy that names its environment", "one without (see --env)")
    check_environment(environment, named, f"{path}")
    task = replace(task, environment=named)
    with runner_of(Environment(task.environment, task.options)) as runner:
        check_fit(policy, runner, f"{path}")
        yield policy, task, runner


def check_environment(given: str | None, known: str, what: str) -> None:
    """Raise ValueError if ``--env`` names another environment than a run or a policy, which ``what`` names."""
    require(given in (None, known), "--env", f"{known}, the environment of {what}", given)


def policy_file(path: Path) -> Path:
    """Return a policy file; the folder of a run stands for its last policy.

    Raises:
        ValueError: there is no such file or folder, or the folder contains no policy yet.
    """
    require(path.exists(), f"{path}", "a policy file, or the folder of a run", "neither a file nor a folder")
    return last_policy(path) if path.is_dir() else path


def check_fit(policy: GaussianPolicy, runner: InlineRunner, what: str) -> None:
    """Raise ValueError, which begins with ``what``, unless a policy fits the environment of a runner."""
    spaces, mean = runner.spaces, policy.mean
    input_dim = policy.inputs.dimension(spaces.observation_dim, spaces.action_dim)
    require(
        (input_dim, spaces.action_dim) == (mean.input_dim, mean.output_dim),
        what,
        f"a policy from {input_dim} to {spaces.action_dim} dimensions for {runner.simulation.environment}",
        f"{mean.input_dim} to {mean.output_dim}",
    )
