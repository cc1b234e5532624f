"""``rkhs train``: train a policy, or one policy for each of several seeds."""

import argparse
import sys
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import NamedTuple

from rkhs_ros.app.commands.view import page_beside, require_viser, stay_with
from rkhs_ros.app.domain import reserved_domain
from rkhs_ros.app.inline import check_environment, runner_of, untuned_config, warn_of_horizon
from rkhs_ros.app.launcher import launch, resuming, write_parameters
from rkhs_ros.app.named import configuration, named
from rkhs_ros.app.robots import check_robot, default_domain
from rkhs_ros.app.study import (
    add_jobs_argument,
    begin_seeds,
    make_missing,
    parse_seeds,
    report_failures,
    seed_folders,
)
from rkhs_ros.base.endings import BAD_INPUT, FAILED, INTERRUPTED, Lossy, RunError, print_error
from rkhs_ros.base.ros import missing_ros, require_ros
from rkhs_ros.base.validation import pick, require
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.state import first_state
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.runs.checkpoint import start_from
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.curve import Curve, has_events
from rkhs_ros.runs.report import (
    begin,
    interruption_summary,
    is_started,
    new_folder,
    old_folder,
    resume_hint,
    summary,
)
from rkhs_ros.runs.run import run_training
from rkhs_ros.studies.comparison import compare


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("config", type=configuration, nargs="?", metavar="CONFIG", help="YAML file; see config/")
    add("--env", type=named, metavar="ID", help="an environment instead of CONFIG (module:Id-v0 imports the module)")
    add("--resume", type=Path, metavar="DIR", help="a run, or the runs of --seeds, to resume instead of CONFIG")
    add("--algorithm", metavar="NAME", help="an algorithm with its defaults, instead of the configuration's")
    add("--policy", type=Path, metavar="FILE", help="initial policy, for example from `rkhs imitate`")
    add(
        "--runner",
        choices=("ros", "composed", "inline"),
        help="ros: three node processes that communicate over topics; composed: simulator and policy node share a "
        "process; inline: this process only (default: ros if the interfaces are built, otherwise inline)",
    )
    add("--seed", type=int, metavar="N", help="seed of all randomness")
    add("--seeds", metavar="SEEDS", help="one run per seed, such as 0-9 or 0,2,5, in the folders DIR/seed_N")
    add_jobs_argument(parser, "runs of --seeds")
    add("--iterations", type=int, metavar="N", help="number of policy updates")
    about = "settings to replace, such as algorithm.ridge=0.1"
    add("--set", nargs="+", type=named, action="extend", default=[], metavar="KEY=VALUE", help=about)
    add("--out", type=Path, metavar="DIR", help="folder for the results (default: results/NAME/TIME)")
    add("--view", action="store_true", help="show the run in the browser")
    add("--tensorboard", action="store_true", help="log each iteration for TensorBoard as well, in DIR/tensorboard")
    add("--quiet", action="store_true", help="no progress bar")


def run(options: argparse.Namespace) -> int:
    """Train, plot the run and print a summary."""
    _check_source(options)
    if options.view:
        require_viser()
    has_events(options.resume, options.tensorboard)
    if _has_several_seeds(options):
        require(not options.view, "--view", "a single run", "several seeds")
        return _train_several(options)
    require(options.jobs is None, "--jobs", "--seeds, or --resume of runs with several seeds", "one run")
    try:
        prepared = _prepared(options)
    except KeyboardInterrupt:
        if not options.resume:
            raise
        print(f"interrupted; resume with: rkhs train --resume {options.resume}", file=sys.stderr)
        return INTERRUPTED
    beside = page_beside(prepared.folder) if options.view else nullcontext()
    with prepared.runner or nullcontext(), beside as page:
        code = _train_one(options, prepared)
        if page and code == 0:
            stay_with(page)
    return code


def _has_several_seeds(options: argparse.Namespace) -> bool:
    if options.resume:
        return not is_started(options.resume) and len(seed_folders(options.resume)) > 0
    return options.seeds is not None


def _check_source(options: argparse.Namespace) -> None:
    """Raise ValueError unless there is one source of the settings: a configuration, an environment or an old run."""
    given = [name for name in ("CONFIG", "--env", "--resume") if getattr(options, name.strip("-").lower())]
    expected = "exactly one of CONFIG, --env ID and --resume DIR"
    sources = [name for name in given if name != "--env" or not options.resume]  # which repeats the old run's
    require(len(sources) == 1, "train", expected, " and ".join(given) or "none")
    names = ("seed", "seeds", "set", "out", "algorithm", "policy")
    wrong = [f"--{name}" for name in names if options.resume and getattr(options, name) not in (None, [])]
    remedy = f". To change settings, train {options.resume}/config.yaml in another folder"
    require(not wrong, "--resume", "the settings and the folder of the run", f"{', '.join(wrong)}{remedy}")


def _configuration(options: argparse.Namespace, file: Path | None) -> Config:
    """Return the settings of a file, or the defaults for an environment, with the changes of the options."""
    names = ("seed", "iterations")
    changes = [f"{name}={value}" for name in names if (value := getattr(options, name)) is not None]
    if options.algorithm is not None:
        pick(options.algorithm, ALGORITHMS, "algorithm")
        changes.append(
            f"algorithm.name={options.algorithm}" if file is None else f"algorithm={{name: {options.algorithm}}}"
        )
    changes += options.set
    if file is None:
        return untuned_config(options.env, changes)
    config = load_config(file, changes)
    check_environment(options.env, config.environment.id, f"{file.parent}")
    return config


def _learnable(config: Config, first_policy: Path | None, *, quiet: bool = False) -> tuple[Spaces, InlineRunner | None]:
    """Check that a run can start; return its spaces and its runner in this process, which is None for a robot.

    Args:
        config: configuration of the run.
        first_policy: file of the initial policy, if any.
        quiet: do not print a note about the horizon.

    Raises:
        ValueError: the environment cannot be used, or the settings or the initial policy do not fit it.
    """
    runner = None if config.environment.nodes else runner_of(config.environment)
    spaces = runner.spaces if runner else check_robot(config)
    first_state(config.training, spaces, load_policy(first_policy)[0] if first_policy else None)
    if runner and not quiet:
        warn_of_horizon(runner.simulation, config.training.horizon, given=config.sets_horizon)
    return spaces, runner


class PreparedRun(NamedTuple):
    """A run that is ready to start.

    Attributes:
        config: its configuration.
        spaces: spaces of its task.
        runner: runs its episodes in this process; None if the run uses topics.
        folder: folder of its results.
    """

    config: Config
    spaces: Spaces
    runner: InlineRunner | None
    folder: Path


def _prepared(options: argparse.Namespace) -> PreparedRun:
    """Check the options; return a run that is ready to start, with an existing folder."""
    config = _configuration(options, old_folder(options.resume) / "config.yaml" if options.resume else options.config)
    spaces, runner = _learnable(config, options.policy, quiet=options.quiet)
    over_topics = _is_over_topics(options.runner)
    if over_topics:
        if runner:
            runner.simulation.close()  # hardware can be open only once, and the simulator node opens it
            runner = None
        config.check_for_topics()
        is_composable = options.runner != "composed" or not config.environment.nodes
        require(is_composable, "--runner composed", "a simulator", "a robot")
    else:
        runner = runner or runner_of(config.environment)
    folder = options.resume or new_folder(options.out, config.training.name)
    if not options.resume:
        start_from(folder, config, load_policy(options.policy)[0] if options.policy else None)
    return PreparedRun(config, spaces, runner, folder)


def _train_one(options: argparse.Namespace, prepared: PreparedRun) -> int:
    config, spaces, runner, folder = prepared
    try:
        code = _in_process(config, folder, options, runner) if runner else _over_topics(config, folder, options)
    except KeyboardInterrupt:
        code = INTERRUPTED
    if code == 0:
        draw_run(folder)
        print(summary(folder, config), file=Lossy(sys.stdout), flush=True)
    elif code != BAD_INPUT:
        with suppress(OSError):  # a full disk is already reported
            _leave_resumable(config, folder, spaces)
    if code == INTERRUPTED:
        print(interruption_summary(folder, config), file=sys.stderr)
    return code


def _leave_resumable(config: Config, folder: Path, spaces: Spaces) -> None:
    """Make an unfinished run resumable, and plot the policy that it learnt so far."""
    if not is_started(folder):
        begin(folder, config)
    if (folder / "policy.npz").is_file():
        draw_run(folder)


def _is_over_topics(asked: str | None) -> bool:
    """Return whether the run uses topics: as requested, otherwise if this Python can run nodes.

    Raises:
        ValueError: topics are requested, and this Python cannot run nodes.
    """
    if asked == "inline":
        return False
    if asked is not None:
        require_ros(f"--runner {asked}")
    missing = missing_ros()
    if missing:
        print(f"note: training with --runner inline, since {missing}", file=sys.stderr)
    return not missing


def _over_topics(config: Config, folder: Path, options: argparse.Namespace) -> int:
    with reserved_domain(folder, default_domain(config)):
        # The learner resumes a run that has started, so that one file serves all attempts.
        given = {"quiet": options.quiet, "tensorboard": options.tensorboard, "resume": True}
        file = write_parameters(config, folder / "parameters.yaml", output=str(folder.resolve()), **given)
        return resuming(
            lambda: launch(config, file, composed=options.runner == "composed"),
            lambda: len(Curve(folder / "curve.csv").rows()),
        )


def _in_process(config: Config, folder: Path, options: argparse.Namespace, runner: InlineRunner) -> int:
    try:
        run_training(
            config,
            runner,
            folder,
            quiet=options.quiet,
            resume=bool(options.resume),
            tensorboard=options.tensorboard,
        )
    except (ValueError, OSError, RunError) as error:
        return print_error(error)
    return 0


def _train_several(options: argparse.Namespace) -> int:
    """Run several seeds in parallel; return 1 and report the runs that failed, if any."""
    require(options.runner in (None, "inline"), "--runner", "inline for several seeds", options.runner)
    require(options.seed is None, "--seed", "either --seed or --seeds", "both")
    folder, runs = _runs_to_resume(options) if options.resume else _new_runs(options)
    title = next(iter(runs.values())).training.name
    try:
        failures = make_missing(
            runs,
            jobs=options.jobs,
            title=title,
            quiet=options.quiet,
            drawn=True,
            tensorboard=options.tensorboard,
        )
    except KeyboardInterrupt:
        print(f"interrupted; {resume_hint(folder, next(iter(runs.values())))}", file=sys.stderr)
        return INTERRUPTED
    report_failures(failures)
    done = [path for path in runs if path not in failures]
    if done:
        print(compare(done).curves[0].summary())
        print(f"Compare: rkhs compare {folder}")
    return FAILED if failures else 0


def _runs_to_resume(options: argparse.Namespace) -> tuple[Path, dict[Path, Config]]:
    folders = seed_folders(options.resume)
    return options.resume, {folder: _configuration(options, folder / "config.yaml") for folder in folders}


def _new_runs(options: argparse.Namespace) -> tuple[Path, dict[Path, Config]]:
    seeds, config = parse_seeds(options.seeds), _configuration(options, options.config)
    _, runner = _learnable(config, options.policy, quiet=options.quiet)
    if runner:
        runner.simulation.close()
    folder = new_folder(options.out, config.training.name)
    return folder, begin_seeds(folder, config, seeds, options.policy)
