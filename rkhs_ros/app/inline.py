"""Runs and policies in this process; importing this module registers the project's tasks."""

import argparse
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
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.policy import Policy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, load_policy
from rkhs_ros.rollouts.environments import Source, time_limit
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import ENVIRONMENT, Config, Environment, config_for, tree_of
from rkhs_ros.runs.report import last_policy

OF_PYTHON = (
    "A command cannot create a class or function that was passed to rkhs_ros.train: pass it to rkhs_ros.evaluate, or "
    "to rkhs_ros.train with resume=True"
)


def runner_of(environment: Environment) -> InlineRunner:
    """Return a runner of policies in an environment; raise ValueError if it cannot be used here, such as a robot."""
    require(
        not environment.nodes,
        environment.id,
        "an environment of this process",
        "a robot, which needs topics (see rkhs status)",
    )
    try:
        return InlineRunner(Simulation(environment.id, environment.options, environment.num_envs))
    except ValueError as error:
        if ENVIRONMENT.search(environment.id) or environment.id in registry:
            raise
        raise ValueError(f"{error}. {OF_PYTHON}") from error


def spaces_of(environment: Environment) -> Spaces:
    """Return the spaces of an environment, and close it; raise ValueError if it cannot be used here."""
    with runner_of(environment) as runner:
        return runner.spaces


def untuned_config(environment: str, changes: Sequence[str]) -> Config:
    """Return the configuration of a run on an environment with its own time limit, the defaults and some changes."""
    section = tree_of(changes).get("environment")
    options = section.get("options") if isinstance(section, Mapping) else None
    limit = time_limit(environment, options if isinstance(options, Mapping) else {})
    return config_for(environment, limit, changes)


def warn_of_horizon(simulation: Simulation, horizon: int) -> None:
    """Print a note if the horizon differs from the environment's time limit, or both have been left open."""
    name, limit = simulation.environment, simulation.time_limit
    if limit is None and horizon == Training.horizon:
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


def add_environment_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the option that names the environment of a run or policy, for commands that read it from files."""
    about = "the environment, MODULE:ID, if its module is in the current folder, or if the file names none"
    parser.add_argument("--env", metavar="ID", help=about)


def add_settings_argument(parser: argparse.ArgumentParser, example: str) -> None:
    """Declare the option that replaces settings."""
    about = f"settings to replace, such as {example}"
    parser.add_argument("--set", nargs="+", action="extend", default=[], metavar="KEY=VALUE", help=about)


@contextmanager
def load_acting(
    policy: Policy | str | Path, source: Source | None = None
) -> Iterator[tuple[GaussianPolicy, Task, InlineRunner]]:
    """Load a policy; yield it with its task and a runner, which closes when the context exits."""
    if isinstance(policy, Policy):
        gaussian, task, what = policy.gaussian, policy.task, "policy"
    else:
        require(
            isinstance(policy, str | Path), "policy", "a policy, its file, or a run's folder", type(policy).__name__
        )
        path, what = Path(policy), f"{policy}"
        gaussian, task = load_policy(last_policy(path) if path.is_dir() else path)
    if source is not None and not isinstance(source, str):
        runner = InlineRunner(Simulation(source))
    else:
        require(
            bool(source or task.environment), what, "a policy that names its environment", "one without (see --env)"
        )
        if source not in (None, task.environment):
            task = replace(task, environment=source, options={})
        runner = runner_of(Environment(task.environment, task.options))
    with runner:
        spaces, mean = runner.spaces, gaussian.mean
        inputs = gaussian.inputs.dimension(spaces.observation_dim, spaces.action_dim)
        expected = f"a policy from {inputs} to {spaces.action_dim} dimensions for {runner.simulation.environment}"
        got = f"{mean.input_dim} to {mean.output_dim}"
        require((inputs, spaces.action_dim) == (mean.input_dim, mean.output_dim), what, expected, got)
        yield gaussian, task, runner
