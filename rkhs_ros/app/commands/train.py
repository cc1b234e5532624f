"""``rkhs train``: train a policy, or one policy for each of several seeds."""

import argparse
import sys
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path

from rkhs_ros.app.commands.view import page_beside, stay_with
from rkhs_ros.app.inline import add_settings_argument, runner_of, untuned_config, warn_of_horizon
from rkhs_ros.app.launcher import launch, reserved_domain, resuming, write_parameters
from rkhs_ros.app.robots import check_robot, default_domain
from rkhs_ros.app.study import PREFIX, add_jobs_argument, make_missing, parse_seeds, report_failures, seed_folders
from rkhs_ros.base.endings import BAD_INPUT, FAILED, INTERRUPTED, RunError, print_error
from rkhs_ros.base.validation import missing_ros, pick, require, require_extra, require_ros
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.state import first_state
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.curve import Curve, has_events
from rkhs_ros.runs.report import (
    advice_in,
    begin,
    interruption_summary,
    is_started,
    new_folder,
    old_folder,
    resume_hint,
    start_from,
    summary,
)
from rkhs_ros.runs.run import run_training
from rkhs_ros.studies.comparison import compare


def add_train(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs train``."""
    add = parser.add_argument
    add("config", type=Path, nargs="?", metavar="CONFIG", help="YAML file; see config/")
    add("--env", metavar="ID", help="an environment instead of CONFIG (module:Id-v0 imports the module)")
    add("--resume", type=Path, metavar="DIR", help="a run, or the runs of --seeds, to resume instead of CONFIG")
    add("--algorithm", metavar="NAME", help="an algorithm with its defaults, instead of the configuration's")
    add("--policy", type=Path, metavar="FILE", help="initial policy, for example from `rkhs imitate`")
    add(
        "--runner",
        choices=("ros", "inline"),
        help="ros: three node processes that communicate over topics; inline: this process only (default: ros if the "
        "interfaces are built, otherwise inline)",
    )
    add("--seed", type=int, metavar="N", help="seed of all randomness")
    add("--seeds", metavar="SEEDS", help="one run per seed, such as 0-9 or 0,2,5, in the folders DIR/seed_N")
    add_jobs_argument(parser, "runs of --seeds")
    add("--iterations", type=int, metavar="N", help="number of policy updates")
    add_settings_argument(parser, "algorithm.ridge=0.1")
    add("--out", type=Path, metavar="DIR", help="folder for the results (default: results/NAME/TIME)")
    add("--view", action="store_true", help="show the run in the browser")
    add("--tensorboard", action="store_true", help="log each iteration for TensorBoard as well, in DIR/tensorboard")
    add("--quiet", action="store_true", help="no progress bar")


def run_train(options: argparse.Namespace) -> int:
    """Train, plot the run and print a summary."""
    _check_source(options)
    if options.view:
        require_extra("viser", "view", "--view")
    has_events(options.resume, options.tensorboard)
    if options.seeds is not None or (
        options.resume and not is_started(options.resume) and seed_folders(options.resume)
    ):
        require(not options.view, "--view", "a single run", "several seeds")
        return _train_several(options)
    require(options.jobs is None, "--jobs", "--seeds, or --resume of runs with several seeds", "one run")
    config, runner, folder = _prepared(options)
    beside = page_beside(folder) if options.view else nullcontext()
    with runner or nullcontext(), beside as page:
        code = _train_one(options, config, runner, folder)
        if page and code == 0:
            stay_with(page)
    return code


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
    names, name = ("seed", "iterations"), options.algorithm
    changes = [f"{each}={value}" for each in names if (value := getattr(options, each)) is not None]
    if name is not None:
        pick(name, ALGORITHMS, "algorithm")
        changes.append(f"algorithm={{name: {name}}}" if file else f"algorithm.name={name}")
    changes += options.set
    if file is None:
        return untuned_config(options.env, changes)
    config = load_config(file, changes)
    known = config.environment.id
    require(options.env in (None, known), "--env", f"{known}, the environment of {file.parent}", options.env)
    return config


def _checked(options: argparse.Namespace, config: Config) -> tuple[InlineRunner | None, GaussianPolicy | None, Spaces]:
    """Check that a run can start; return its runner in this process, None for a robot, initial policy and spaces."""
    runner = None if config.environment.nodes else runner_of(config.environment)
    policy = load_policy(options.policy)[0] if options.policy else None
    spaces = runner.spaces if runner else check_robot(config)
    first_state(config.training, spaces, policy)
    if runner and not options.quiet and not options.resume:  # a resumed run has printed it
        warn_of_horizon(runner.simulation, config.training.horizon)
    return runner, policy, spaces


def _prepared(options: argparse.Namespace) -> tuple[Config, InlineRunner | None, Path]:
    """Return the configuration of a run, its runner in this process, None over topics, and its existing folder."""
    config = _configuration(options, old_folder(options.resume) / "config.yaml" if options.resume else options.config)
    runner, policy, spaces = _checked(options, config)
    if _is_over_topics(options.runner):
        if runner:
            runner.simulation.close()  # hardware can be open only once, and the simulator node opens it
            runner = None
        config.check_for_topics()
    else:
        runner = runner or runner_of(config.environment)
    folder = options.resume or new_folder(options.out, config.training.name)
    if not options.resume:
        start_from(folder, config, policy, spaces)
    return config, runner, folder


def _train_one(options: argparse.Namespace, config: Config, runner: InlineRunner | None, folder: Path) -> int:
    """Train, plot what was learnt, and print a summary; an unfinished run can be resumed."""
    how = {"quiet": options.quiet, "tensorboard": options.tensorboard}
    try:
        if runner:
            run_training(config, runner, folder, resume=bool(options.resume), **how)
            code = 0
        else:
            code = _over_topics(config, folder, **how)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except (ValueError, OSError, RunError) as error:
        code = print_error(error)
    if code == 0:
        draw_run(folder)
        print(summary(folder, config), flush=True)
    elif code != BAD_INPUT:
        with suppress(OSError):  # a full disk is already reported
            if not is_started(folder):
                begin(folder, config)
            if (folder / "policy.npz").is_file():
                draw_run(folder)
    if code == INTERRUPTED or (code == FAILED and (folder / "policy.npz").is_file()):
        print(interruption_summary(folder, config), file=sys.stderr)
    return code


def _is_over_topics(asked: str | None) -> bool:
    """Return whether the run uses topics: as requested, otherwise if this Python can run nodes."""
    if asked == "inline":
        return False
    if asked is not None:
        require_ros(f"--runner {asked}")
    missing = missing_ros()
    if missing:
        print(f"note: training with --runner inline, since there is {missing}", file=sys.stderr)
    return not missing


def _over_topics(config: Config, folder: Path, *, quiet: bool, tensorboard: bool) -> int:
    with reserved_domain(folder, default_domain(config)):
        how = {"quiet": quiet, "tensorboard": tensorboard, "resume": True}  # all attempts, if the run has started
        file = write_parameters(config, folder / "parameters.yaml", output=str(folder.resolve()), **how)
        stored = Curve(folder / "curve.csv")
        return resuming(lambda: launch(config, file), lambda: len(stored.rows()))


def _train_several(options: argparse.Namespace) -> int:
    """Run several seeds in parallel; return 1 and report the runs that failed, if any."""
    require(options.runner in (None, "inline"), "--runner", "inline for several seeds", options.runner)
    require(options.seed is None, "--seed", "either --seed or --seeds", "both")
    if options.resume:
        folder = options.resume
        runs = {path: _configuration(options, path / "config.yaml") for path in seed_folders(folder)}
    else:
        folder, runs = _begun(options)
    config = next(iter(runs.values()))
    how = {"title": config.training.name, "quiet": options.quiet, "tensorboard": options.tensorboard}
    try:
        failures = make_missing(runs, jobs=options.jobs, drawn=True, **how)
    except KeyboardInterrupt:
        print(f"interrupted; {resume_hint(folder, config)}", file=sys.stderr)
        return INTERRUPTED
    report_failures(failures)
    done = [path for path in runs if path not in failures]
    if done:
        print(compare(done).curves[0].summary())
        for path in done:
            for line in advice_in(path):
                print(f"{path.name}: {line}")
        print(f"Compare: rkhs compare {folder}")
    return FAILED if failures else 0


def _begun(options: argparse.Namespace) -> tuple[Path, dict[Path, Config]]:
    """Start a run for each seed, so that each can be resumed; return their parent, and the runs by absolute folder."""
    seeds, config = parse_seeds(options.seeds), _configuration(options, options.config)
    runner, policy, spaces = _checked(options, config)
    if runner:
        runner.simulation.close()
    folder = new_folder(options.out, config.training.name)
    runs = {}
    for seed in seeds:
        path = folder.resolve() / f"{PREFIX}{seed}"
        runs[path] = replace(config, training=replace(config.training, seed=seed))
        path.mkdir()
        start_from(path, runs[path], policy, spaces)
        begin(path, runs[path])
    return folder, runs
