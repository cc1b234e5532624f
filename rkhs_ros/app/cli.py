"""The command line ``rkhs``."""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import gymnasium

from rkhs_ros.app.inline import iterations
from rkhs_ros.app.launcher import NodeProcess, launch
from rkhs_ros.base.validation import require
from rkhs_ros.learning.kernel_choice import KERNELS
from rkhs_ros.learning.registry import ALGORITHMS
from rkhs_ros.paper.experiment import known, load_experiment
from rkhs_ros.paper.figures import draw_experiment
from rkhs_ros.paper.reproduce import reproduce
from rkhs_ros.paper.results import results
from rkhs_ros.paper.table import load_table
from rkhs_ros.pictures.film import USUAL, shoot
from rkhs_ros.pictures.film_files import animate, draw_strip
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.storage import Task, load_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.report import new_folder, old_folder, resolved, summary
from rkhs_ros.runs.rollout import InlineRunner
from rkhs_ros.runs.run import run_training
from rkhs_ros.runs.simulation import Simulation

OURS = "rkhs/"  # what the names of the tasks begin with
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
    _check_train(options)
    names = ("seed", "iterations", "simulators")
    changes = [f"{name}={value}" for name in names if (value := getattr(options, name)) is not None]
    file = options.config or old_folder(options.resume) / "config.yaml"
    config = load_config(file, [*changes, *options.set])
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
    folder = options.resume or new_folder(options.out, config.training.name)
    try:
        code = _run(options, config, simulation, folder)
    except KeyboardInterrupt:
        code = INTERRUPTED
    if code != BAD_INPUT and (folder / "policy.npz").is_file():
        draw_run(folder)
    if code == 0:
        print(summary(folder, config))
    return code


def _run(options: argparse.Namespace, config: Config, simulation: Simulation, folder: Path) -> int:
    if options.runner == "inline":
        run_training(config, InlineRunner(simulation), folder, quiet=options.quiet, resume=bool(options.resume))
        return 0
    more = [f"output:={folder.resolve()}", f"quiet:={options.quiet}".lower()]
    more += ["resume:=true"] if options.resume else []
    return launch(resolved(config), more, simulators=config.training.simulators)


def _check_train(options: argparse.Namespace) -> None:
    given = [name for name in ("CONFIG", "--resume") if getattr(options, name.strip("-").lower())]
    require(len(given) == 1, "train", "CONFIG or --resume DIR, one of them", " and ".join(given) or "none")
    fixed = {"--seed": options.seed is not None, "--set": bool(options.set), "--out": options.out is not None}
    wrong = [name for name, is_given in fixed.items() if is_given and options.resume]
    require(not wrong, "--resume", "the settings and the folder that the run began with", ", ".join(wrong))


def _loaded(path: Path) -> tuple[GaussianPolicy, Task, InlineRunner]:
    """Return a policy, its task and where it can act."""
    policy, task = load_policy(path)
    runner = InlineRunner(Simulation(task.environment, task.options))
    spaces = runner.spaces
    input_dim = policy.inputs.dimension(spaces.observation_dim, spaces.action_dim)
    require(
        (input_dim, spaces.action_dim) == (policy.mean.input_dim, policy.mean.output_dim),
        f"{path}",
        f"a policy from {input_dim} to {spaces.action_dim} dimensions, as {task.environment} has",
        f"{policy.mean.input_dim} to {policy.mean.output_dim}",
    )
    return policy, task, runner


def _evaluate(options: argparse.Namespace) -> int:
    require(options.episodes >= 1, "--episodes", "at least 1", options.episodes)
    policy, task, runner = _loaded(options.policy)
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


def _render(options: argparse.Namespace) -> int:
    film = shoot(*_loaded(options.policy), seed=options.seed, frames=options.frames)
    folder = options.out or options.policy.parent
    folder.mkdir(parents=True, exist_ok=True)
    for write, name in ((draw_strip, "film.png"), (animate, "film.gif")):
        write(folder / name, film)
        print(folder / name)
    return 0


def _reproduce(options: argparse.Namespace) -> int:
    require(options.runs is None or options.runs >= 1, "--runs", "at least 1", options.runs)
    require(options.jobs == -1 or options.jobs >= 1, "--jobs", "at least 1, or -1 for all cores", options.jobs)
    names = list(known()) if options.figure == "all" else [options.figure]
    for experiment in [load_experiment(name) for name in names]:
        runs = options.runs or experiment.runs
        table = reproduce(experiment, options.out, iterations, runs=runs, jobs=options.jobs, quiet=options.quiet)
        picture = table.with_suffix(".png")
        draw_experiment(picture, experiment, load_table(table))
        print(f"{experiment.name}: {table} and {picture}")
    return 0


def _results(options: argparse.Namespace) -> int:
    options.out.write_text(results(options.folder, options.out))
    print(options.out)
    return 0


def _status(options: argparse.Namespace) -> int:
    return NodeProcess("status").process.wait()


def _list(options: argparse.Namespace) -> int:
    tasks = [name for name in gymnasium.registry if name.startswith(OURS)]
    kinds: dict[str, Iterable[str]] = {"tasks": tasks, "algorithms": ALGORITHMS, "kernels": KERNELS, "figures": known()}
    for title, names in kinds.items():
        print(f"{title}: {', '.join(names)}")
    print("Any other Gymnasium environment with continuous actions is a task too, by its id.")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="rkhs", description="Policy search in reproducing kernel Hilbert spaces.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    train = commands.add_parser("train", help="learn a policy")
    train.set_defaults(command=_train)
    train.add_argument("config", type=Path, nargs="?", metavar="CONFIG", help="a YAML file, see config/")
    train.add_argument("--resume", type=Path, metavar="DIR", help="in place of CONFIG, a run to go on with")
    train.add_argument(
        "--runner", choices=("ros", "inline"), default="ros", help="over topics in three processes, or in this one"
    )
    train.add_argument("--seed", type=int, metavar="N", help="seed of all randomness")
    train.add_argument("--iterations", type=int, metavar="N", help="number of policy updates")
    train.add_argument("--simulators", type=int, metavar="K", help="simulator nodes that share the episodes")
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

    render = commands.add_parser("render", help="film an episode without exploration")
    render.set_defaults(command=_render)
    render.add_argument("policy", type=Path, metavar="POLICY.npz", help="a policy that was learnt")
    render.add_argument("--out", type=Path, metavar="DIR", help="folder for film.png and film.gif (the policy's)")
    render.add_argument("--seed", type=int, default=0, metavar="N", help="seed of all randomness (0)")
    render.add_argument("--frames", type=int, default=USUAL, metavar="N", help="pictures at most (%(default)s)")

    again = commands.add_parser("reproduce", help="make the paper's figures again")
    again.set_defaults(command=_reproduce)
    again.add_argument("figure", metavar="FIGURE", help=f"{', '.join(known())}, or all")
    again.add_argument("--runs", type=int, metavar="N", help="independent runs of each curve (the paper's number)")
    again.add_argument("--jobs", type=int, default=-1, metavar="J", help="processes side by side (all cores)")
    again.add_argument(
        "--out", type=Path, default=Path("results/reproduce"), metavar="DIR", help="where the results go (%(default)s)"
    )
    again.add_argument("--quiet", action="store_true", help="no progress bar")

    report = commands.add_parser("results", help="say which of the paper's claims hold, from reproduced figures")
    report.set_defaults(command=_results)
    report.add_argument("folder", type=Path, metavar="DIR", help="folder with the figures' csv files")
    report.add_argument("--out", type=Path, default=Path("results.md"), metavar="FILE", help="(%(default)s)")

    commands.add_parser("status", help="what the nodes of a run say of themselves").set_defaults(command=_status)
    commands.add_parser("list", help="tasks, algorithms, kernels and figures").set_defaults(command=_list)
    return parser


if __name__ == "__main__":
    main()
