"""``rkhs check``: explore a task for a few episodes, and print what they reveal."""

import argparse
from pathlib import Path
from shlex import quote

from rkhs_ros.app.inline import runner_of, untuned_config
from rkhs_ros.app.named import SUFFIXES, named, task
from rkhs_ros.base.validation import require
from rkhs_ros.learning.state import first_policy
from rkhs_ros.learning.task_check import TaskCheck
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import Config, load_config

EPISODES, MOST_EPISODES = 3, 100  # default and maximum of --episodes
UNKNOWN_S = 1.0  # duration of a step that an environment does not state


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add(
        "task", type=task, metavar="ENV|CONFIG", help="an environment (module:Id-v0 imports the module), or a YAML file"
    )
    add("--episodes", type=int, default=EPISODES, metavar="N", help="exploring episodes (default: %(default)s)")
    add("--seed", type=int, metavar="N", help="seed of all randomness")
    about = "settings to replace, such as horizon=500"
    add("--set", nargs="+", type=named, action="extend", default=[], metavar="KEY=VALUE", help=about)


def run(options: argparse.Namespace) -> int:
    """Explore with the first policy; print the findings, and what to do about them."""
    episodes = options.episodes
    require(1 <= episodes <= MOST_EPISODES, "--episodes", f"1 to {MOST_EPISODES}", episodes)
    config = _configuration(options)
    training = config.training
    with runner_of(config.environment) as runner:
        spaces, seconds = runner.spaces, runner.simulation.step_seconds
        policy = first_policy(training, spaces)
        collected = runner.collect(policy, Batch(training.seed, 0, episodes, training.horizon, explore=True))
    checked = TaskCheck.of(collected, training, spaces)
    lines = checked.lines(None if seconds == UNKNOWN_S else seconds)
    width = max(len(name) for name, _ in lines)
    for name, value in lines:
        print(f"{name:<{width}}  {value}")
    settings, problems = checked.settings(training), checked.problems()
    if settings:
        print(f"try: --set {' '.join(map(quote, settings))}")
    for problem in problems:
        print(f"mend: {problem}")
    if not settings and not problems:
        print(f"the {_kind(options.task)} will do")
    return 0


def _configuration(options: argparse.Namespace) -> Config:
    """Return the settings of a file, or the defaults for an environment.

    Raises:
        ValueError: the task or a setting is unknown or invalid.
    """
    changes = [*([] if options.seed is None else [f"seed={options.seed}"]), *options.set]
    if _is_file(options.task):
        return load_config(Path(options.task), changes)
    return untuned_config(options.task, changes)


def _is_file(task: str) -> bool:
    return Path(task).suffix in SUFFIXES or Path(task).is_file()


def _kind(task: str) -> str:
    return "settings of the file" if _is_file(task) else "defaults"
