"""``rkhs train``: learn a policy, or one for each of several seeds."""

from __future__ import annotations

import argparse
import sys
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import NamedTuple

from rkhs_ros.app.commands.view import page_beside, require_viser, stay_with
from rkhs_ros.app.domain import own_domain
from rkhs_ros.app.inline import runner_of, warn_of_horizon
from rkhs_ros.app.launcher import journal_in, launch
from rkhs_ros.app.robots import check_robot, default_domain
from rkhs_ros.app.seeds import begin_seeds, parse_seeds, seed_folders
from rkhs_ros.app.study import add_worker_arguments, make_missing, report_failures, workers_of
from rkhs_ros.app.trust import add_trust_argument, reads_data
from rkhs_ros.base.endings import BAD_INPUT, FAILED, INTERRUPTED, RunError, print_error
from rkhs_ros.base.files import read_whole, write_whole
from rkhs_ros.base.ros import missing_ros, require_ros
from rkhs_ros.base.streams import Lossy
from rkhs_ros.base.validation import pick, require
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.state import first_state
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.rollouts.environments import own_horizon
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.runs.checkpoint import ACCEPT
from rkhs_ros.runs.config import Config, config_for, load_config
from rkhs_ros.runs.report import (
    FIRST_POLICY,
    Report,
    how_to_go_on,
    is_begun,
    new_folder,
    old_folder,
    resolved,
    summary,
    what_was_kept,
)
from rkhs_ros.runs.run import run_training
from rkhs_ros.studies.comparison import compare

RECORDS = ("episodes", "raw")  # what is recorded


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("config", type=Path, nargs="?", metavar="CONFIG", help="a YAML file, see config/")
    add("--env", metavar="ID", help="in place of CONFIG, an environment (module:Id-v0 imports the module)")
    add("--resume", type=Path, metavar="DIR", help="in place of CONFIG, a run or the runs of --seeds to go on with")
    add(
        ACCEPT,
        action="store_true",
        help="go on though code, libraries or threads changed since, which config.yaml notes",
    )
    add("--algorithm", metavar="NAME", help="an algorithm with its defaults, in place of the configuration's")
    add("--policy", type=Path, metavar="FILE", help="a policy to begin from, as one that was imitated")
    add(
        "--runner",
        choices=("ros", "composed", "inline"),
        help="over topics in three processes, or with simulator and policy node in one, or in this process (ros where "
        "the interfaces are built)",
    )
    add("--seed", type=int, metavar="N", help="seed of all randomness")
    add("--seeds", metavar="SEEDS", help="a run for each, as 0-9 or 0,2,5, in the folders DIR/seed_N")
    add_worker_arguments(parser, "runs of --seeds")
    add("--iterations", type=int, metavar="N", help="number of policy updates")
    add("--simulators", type=int, metavar="K", help="simulator nodes that share the episodes")
    add("--set", nargs="+", action="extend", default=[], metavar="KEY=VALUE", help="settings, as algorithm.ridge=0.1")
    add("--out", type=Path, metavar="DIR", help="folder for the results (results/NAME/TIME)")
    add(
        "--record",
        nargs="?",
        const=RECORDS[0],
        choices=RECORDS,
        help="write recording.mcap, to replay, learn from and look at; raw: all topics as well",
    )
    add("--view", action="store_true", help="record, and show the run in the browser")
    add_trust_argument(parser)
    add("--quiet", action="store_true", help="no progress bar")


def run(options: argparse.Namespace) -> int:
    """Train, draw the pictures and print what was learnt."""
    _check_source(options)
    options.trust |= options.resume is None  # a configuration is chosen as a program, a run's folder may be data
    return _train(options)


@reads_data
def _train(options: argparse.Namespace) -> int:
    if options.view:
        require_viser()
        options.record = options.record or RECORDS[0]
    if _has_several_seeds(options):
        require(not options.view, "--view", "one run, as of --seed", "several")
        return _train_several(options)
    for name in ("jobs", "scheduler", "ray"):
        given = getattr(options, name)
        require(given is None, f"--{name}", "it together with --seeds, or with --resume of such runs", given)
    begun = _begun(options)
    beside = page_beside(begun.folder, trust=options.trust) if options.view else nullcontext()
    with begun.runner or nullcontext(), beside as page:
        code = _train_one(options, begun)
        if page and code == 0:
            stay_with(page)
    return code


def _has_several_seeds(options: argparse.Namespace) -> bool:
    if options.resume:
        return not is_begun(options.resume) and len(seed_folders(options.resume)) > 0
    return options.seeds is not None


def _check_source(options: argparse.Namespace) -> None:
    """Raise ValueError unless there is one source of the settings: a configuration, an environment or an old run."""
    given = [name for name in ("CONFIG", "--env", "--resume") if getattr(options, name.strip("-").lower())]
    expected = "one of CONFIG, --env ID and --resume DIR"
    require(len(given) == 1, "train", expected, " and ".join(given) or "none")
    names = ("seed", "seeds", "set", "out", "algorithm", "policy")
    wrong = [f"--{name}" for name in names if options.resume and getattr(options, name) not in (None, [])]
    require(
        bool(options.resume) or not options.allow_provenance_change, ACCEPT, "it together with --resume", "it alone"
    )
    require(not wrong, "--resume", "the settings and the folder that the run began with", ", ".join(wrong))


def _configuration(options: argparse.Namespace, file: Path | None) -> Config:
    """Return the settings of a file, or the defaults of an environment, with the changes that the options make."""
    names = ("seed", "iterations", "simulators")
    changes = [f"{name}={value}" for name in names if (value := getattr(options, name)) is not None]
    if options.algorithm is not None:
        pick(options.algorithm, ALGORITHMS, "algorithm")
        changes.append(
            f"algorithm.name={options.algorithm}" if file is None else f"algorithm={{name: {options.algorithm}}}"
        )
    changes += options.set
    if file is not None:
        return load_config(file, changes)
    return config_for(options.env, own_horizon(options.env), changes)


def _learnable(config: Config, first_policy: Path | None, *, quiet: bool = False) -> tuple[Spaces, InlineRunner | None]:
    """Return the spaces of a run that can be begun, and where policies can act in this process; nowhere on a robot.

    Args:
        config: the run.
        first_policy: the file of the policy that it begins with, if any.
        quiet: without a note on the horizon.

    Raises:
        ValueError: the environment cannot be served, or the settings or the first policy do not fit it.
    """
    runner = None if config.environment.nodes else runner_of(config.environment)
    spaces = runner.spaces if runner else check_robot(config)
    first_state(config.training, spaces, load_policy(first_policy)[0] if first_policy else None)
    if runner and not quiet:
        warn_of_horizon(runner.simulation, config.training.horizon, given=config.sets_horizon)
    return spaces, runner


class Begun(NamedTuple):
    """One run that can be made.

    Attributes:
        config: its settings.
        spaces: of its task.
        runner: where its policies act in this process; None over topics.
        folder: of its results.
    """

    config: Config
    spaces: Spaces
    runner: InlineRunner | None
    folder: Path


def _begun(options: argparse.Namespace) -> Begun:
    """Return a run that can be made, whose folder is there."""
    config = _configuration(options, old_folder(options.resume) / "config.yaml" if options.resume else options.config)
    spaces, runner = _learnable(config, options.policy, quiet=options.quiet)
    over_topics = _is_over_topics(options.runner)
    require(over_topics or options.record != "raw", "--record", "episodes in this process, which has no topics", "raw")
    if over_topics:
        if runner:
            runner.simulation.close()  # a robot, say, is open once only: the simulator node shall have it
            runner = None
        config.check_for_topics()
        if options.runner == "composed":
            _check_for_composition(config)
    else:
        runner = runner or runner_of(config.environment)
        if options.simulators:
            print("note: --simulators is of no use in this process, which is the only simulator", file=sys.stderr)
    folder = options.resume or new_folder(options.out, config.training.name)
    if options.policy:
        write_whole(folder / FIRST_POLICY, read_whole(options.policy))
    elif not options.resume:
        (folder / FIRST_POLICY).unlink(missing_ok=True)  # left by a run that was killed before it began
    return Begun(config, spaces, runner, folder)


def _check_for_composition(config: Config) -> None:
    """Raise ValueError where there is not the one simulator that can share a process with the policy node."""
    require(not config.environment.nodes, "--runner composed", "a simulator", "a robot")
    simulators = config.training.simulators
    require(simulators == 1, "--runner composed", "one simulator", simulators)


def _train_one(options: argparse.Namespace, begun: Begun) -> int:
    config, spaces, runner, folder = begun
    try:
        code = _in_process(config, folder, options, runner) if runner else _over_topics(config, folder, options)
    except KeyboardInterrupt:
        code = INTERRUPTED
    if code == 0:
        draw_run(folder)
        print(summary(folder, config), file=Lossy(sys.stdout), flush=True)
    elif code != BAD_INPUT:
        with suppress(OSError):  # a full disk was told of
            _leave_resumable(config, folder, spaces)
    if code == INTERRUPTED:
        print(what_was_kept(folder, config), file=sys.stderr)
    return code


def _leave_resumable(config: Config, folder: Path, spaces: Spaces) -> None:
    """Draw what a run that did not come to its end learnt; have it begun in its folder if it had not."""
    if not is_begun(folder):
        Report(folder, config, spaces)
    if (folder / "policy.npz").is_file():
        draw_run(folder)


def _is_over_topics(asked: str | None) -> bool:
    """Return whether the run is made over topics: as asked, else if this Python can run nodes.

    Raises:
        ValueError: it is asked for, and this Python cannot.
    """
    if asked == "inline":
        return False
    if asked is not None:
        require_ros(f"--runner {asked}")
    missing = missing_ros()
    if missing:
        print(f"note: training in this process, since {missing}", file=sys.stderr)
    return not missing


def _over_topics(config: Config, folder: Path, options: argparse.Namespace) -> int:
    output = str(folder.resolve())
    given = {name: bool(getattr(options, name)) for name in ("quiet", "resume", "record")}
    given["provenance_may_change"] = options.allow_provenance_change
    further: dict[str, dict[str, str | bool]] = {"learner": {"output": output, **given}}
    if config.environment.nodes:
        further["robot"] = {"journal": journal_in(folder.resolve())}
    if options.record == "raw":
        further["recorder"] = {"output": output}
    with own_domain(folder, default_domain(config)):
        simulators, composed = config.training.simulators, options.runner == "composed"
        return launch(resolved(config), further, simulators=simulators, composed=composed)


def _in_process(config: Config, folder: Path, options: argparse.Namespace, runner: InlineRunner) -> int:
    try:
        run_training(
            config,
            runner,
            folder,
            quiet=options.quiet,
            resume=bool(options.resume),
            record=bool(options.record),
            provenance_may_change=options.allow_provenance_change,
        )
    except (ValueError, OSError, RunError) as error:
        return print_error(error)
    return 0


def _train_several(options: argparse.Namespace) -> int:
    """Make the runs of several seeds side by side; 1 where some failed, which are named."""
    workers = workers_of(options)
    require(options.runner in (None, "inline"), "--runner", "inline for several seeds", options.runner)
    require(options.record != "raw", "--record", "episodes for several seeds, which have no topics", "raw")
    require(options.seed is None, "--seed", "either it or --seeds", "both")
    folder, runs = _runs_to_go_on_with(options) if options.resume else _new_runs(options)
    title = next(iter(runs.values())).training.name
    try:
        failures = make_missing(
            runs,
            workers=workers,
            title=title,
            quiet=options.quiet,
            drawn=True,
            record=bool(options.record),
            provenance_may_change=options.allow_provenance_change,
        )
    except KeyboardInterrupt:
        print(f"interrupted; {how_to_go_on(folder, next(iter(runs.values())))}", file=sys.stderr)
        return INTERRUPTED
    report_failures(failures)
    done = [path for path in runs if path not in failures]
    if done:
        print(compare(done).curves[0].summary())
        print(f"Compare: rkhs compare {folder}")
    return FAILED if failures else 0


def _runs_to_go_on_with(options: argparse.Namespace) -> tuple[Path, dict[Path, Config]]:
    folders = seed_folders(options.resume)
    return options.resume, {folder: _configuration(options, folder / "config.yaml") for folder in folders}


def _new_runs(options: argparse.Namespace) -> tuple[Path, dict[Path, Config]]:
    seeds, config = parse_seeds(options.seeds), _configuration(options, options.config)
    _, runner = _learnable(config, options.policy, quiet=options.quiet)
    if runner:
        runner.simulation.close()
    folder = new_folder(options.out, config.training.name)
    return folder, begin_seeds(folder, config, seeds, options.policy)
