"""``rkhs check``, ``rkhs simulate`` and ``rkhs list``: explore, run and list tasks."""

import argparse
import os
import sys
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory

import gymnasium

from rkhs_ros.app.inline import add_settings_argument, runner_of, spaces_of, untuned_config
from rkhs_ros.app.launcher import DOMAIN, launch_worlds, write_parameters
from rkhs_ros.app.robots import check_robot
from rkhs_ros.app.task_check import TaskCheck
from rkhs_ros.base.validation import require, require_ros
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.kernel_choice import KERNELS
from rkhs_ros.learning.state import first_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import load_config

EPISODES, MOST_EPISODES = 3, 100  # default and maximum of --episodes
UNKNOWN_S = 1.0  # duration of a step that an environment does not state
OUR_NAMESPACE = "rkhs/"  # of the ids of our tasks
REMOTE = "rkhs/Remote-v0"  # stands for any task that runs in another process


def add_check(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs check``."""
    add = parser.add_argument
    add("task", metavar="ENV|CONFIG", help="an environment (module:Id-v0 imports the module), or a YAML file")
    add("--episodes", type=int, default=EPISODES, metavar="N", help="exploring episodes (default: %(default)s)")
    add("--seed", type=int, metavar="N", help="seed of all randomness")
    add_settings_argument(parser, "horizon=500")


def run_check(options: argparse.Namespace) -> int:
    """Explore with the first policy; print the findings, and what to do about them."""
    episodes, file = options.episodes, Path(options.task)
    require(1 <= episodes <= MOST_EPISODES, "--episodes", f"1 to {MOST_EPISODES}", episodes)
    changes = [*([] if options.seed is None else [f"seed={options.seed}"]), *options.set]
    is_file = file.suffix in (".yaml", ".yml") or file.is_file()
    config = load_config(file, changes) if is_file else untuned_config(options.task, changes)
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
        print(f"nothing to change in the {'settings of the file' if is_file else 'defaults'} was found")
    return 0


def add_simulate(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs simulate``."""
    add = parser.add_argument
    about = "YAML file of a simulator or a robot; see config/"
    add("config", type=Path, nargs="?", metavar="CONFIG", help=about)
    add("--env", metavar="ID", help="an environment instead of CONFIG (module:Id-v0 imports the module)")
    add_settings_argument(parser, "robot.period=0.1")


def run_simulate(options: argparse.Namespace) -> int:
    """Run the nodes until Ctrl-C, or until one of them exits."""
    require_ros("rkhs simulate")
    given = " and ".join(name for name in ("CONFIG", "--env") if getattr(options, name.strip("-").lower()))
    require(given in ("CONFIG", "--env"), "simulate", "either CONFIG or --env ID", given or "none")
    make, source = (load_config, options.config) if options.config else (untuned_config, options.env)
    config = make(source, options.set)
    if config.environment.nodes:
        check_robot(config)
    else:
        spaces_of(config.environment)
    config.check_for_topics()
    domain = os.environ.setdefault(DOMAIN, "0")
    print(f"{config.environment.id} in ROS domain {domain}; stop with Ctrl-C", file=sys.stderr)
    with TemporaryDirectory() as place:
        return launch_worlds(config, write_parameters(config, Path(place) / "parameters.yaml"))


def add_list(parser: argparse.ArgumentParser) -> None:
    """Declare ``rkhs list``, which has no arguments."""


def run_list(options: argparse.Namespace) -> int:
    """Print the tasks, algorithms, kernels and figures."""
    from rkhs_ros.paper.experiment import known  # here, since no other command of this module needs it

    tasks = [name for name in gymnasium.registry if name.startswith(OUR_NAMESPACE) and name != REMOTE]
    kinds = {"tasks": tasks, "algorithms": ALGORITHMS, "kernels": KERNELS, "figures": known()}
    for title, names in kinds.items():
        print(f"{title}: {', '.join(names)}")
    print("Any other Gymnasium environment with continuous actions can also be used, by its id.")
    return 0
