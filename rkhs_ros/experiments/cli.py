"""The command line ``rkhs``."""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rkhs_ros.experiments.config import load_config
from rkhs_ros.experiments.launcher import launch
from rkhs_ros.experiments.report import new_folder, resolved, summary
from rkhs_ros.experiments.rollout import InlineRunner
from rkhs_ros.experiments.run import run_training
from rkhs_ros.learning.kernel_choice import KERNELS
from rkhs_ros.learning.registry import ALGORITHMS
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.validation import require
from sim_nodes.envs import TASKS
from sim_nodes.simulation import Simulation

BAD_INPUT = 2
INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; bad input ends with one line and exit code 2."""
    options = _parser().parse_args(arguments)
    try:
        code = options.command(options)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        code = BAD_INPUT
    except KeyboardInterrupt:
        code = INTERRUPTED
    sys.exit(code)


def _train(options: argparse.Namespace) -> int:
    changes = [f"{name}={value}" for name in ("seed", "iterations") if (value := getattr(options, name)) is not None]
    config = load_config(options.config, [*changes, *options.set])
    simulation = Simulation(config.environment.id, config.environment.options)  # refuses what cannot be served
    if options.runner == "ros":
        interfaces = importlib.util.find_spec(
            "rkhs_interfaces"
        )  # its source folder passes for a package without origin
        require(
            interfaces is not None and interfaces.origin is not None,
            "rkhs_interfaces",
            "the built interfaces (run 'make build', then 'source setup.bash')",
            "none",
        )
    folder = new_folder(options.out, config.training.name)
    if options.runner == "inline":
        run_training(config, InlineRunner(simulation), folder, quiet=options.quiet)
        code = 0
    else:
        code = launch(resolved(config), (f"output:={folder.resolve()}", f"quiet:={options.quiet}".lower()))
    if code == 0:
        print(summary(folder, config))
    return code


def _evaluate(options: argparse.Namespace) -> int:
    require(options.episodes >= 1, "--episodes", "at least 1", options.episodes)
    policy, task = load_policy(options.policy)
    runner = InlineRunner(Simulation(task.environment, task.options))
    require(
        (runner.observation_dim, runner.action_dim) == (policy.mean.input_dim, policy.mean.output_dim),
        f"{options.policy}",
        f"a policy from {runner.observation_dim} to {runner.action_dim} dimensions, as {task.environment} has",
        f"{policy.mean.input_dim} to {policy.mean.output_dim}",
    )
    episodes = runner.collect(policy, Batch(options.seed, 0, options.episodes, task.horizon, explore=False))
    returns = episodes.returns(task.discount)
    result = {
        "environment": task.environment,
        "episodes": options.episodes,
        "seed": options.seed,
        "discount": task.discount,
        "mean": float(returns.mean()),
        "sd": float(returns.std()),
    }
    print(json.dumps(result, indent=2))
    return 0


def _list(options: argparse.Namespace) -> int:
    for title, names in (("tasks", list(TASKS)), ("algorithms", list(ALGORITHMS)), ("kernels", list(KERNELS))):
        print(f"{title}: {', '.join(names)}")
    print("Any other Gymnasium environment with continuous actions is a task too, by its id.")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="rkhs", description="Policy search in reproducing kernel Hilbert spaces.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    train = commands.add_parser("train", help="learn a policy")
    train.set_defaults(command=_train)
    train.add_argument("config", type=Path, metavar="CONFIG", help="a YAML file, see config/")
    train.add_argument(
        "--runner", choices=("ros", "inline"), default="ros", help="over topics in three processes, or in this one"
    )
    train.add_argument("--seed", type=int, metavar="N", help="seed of all randomness")
    train.add_argument("--iterations", type=int, metavar="N", help="number of policy updates")
    train.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="KEY=VALUE", help="settings, as algorithm.ridge=0.1"
    )
    train.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (results/NAME/TIME)")
    train.add_argument("--quiet", action="store_true", help="no progress bar")

    evaluate = commands.add_parser("evaluate", help="measure a policy without exploration")
    evaluate.set_defaults(command=_evaluate)
    evaluate.add_argument("policy", type=Path, metavar="POLICY.npz", help="a policy that was learnt")
    evaluate.add_argument("--episodes", type=int, default=100, metavar="N", help="number of episodes (100)")
    evaluate.add_argument("--seed", type=int, default=0, metavar="N", help="seed of all randomness (0)")

    commands.add_parser("list", help="tasks, algorithms and kernels").set_defaults(command=_list)
    return parser


if __name__ == "__main__":
    main()
