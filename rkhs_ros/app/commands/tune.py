"""``rkhs tune``: search for settings with a high return."""

from __future__ import annotations

import argparse
import csv
import sys
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from rkhs_ros.app.inline import runner_of, warn_of_horizon
from rkhs_ros.app.seeds import parse_seeds
from rkhs_ros.app.study import add_worker_arguments, require_all_used, study_folder, workers_of
from rkhs_ros.base.endings import INTERRUPTED, RunError
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.lock import locked
from rkhs_ros.base.validation import require, require_extra
from rkhs_ros.learning.state import first_state
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.report import resolved
from rkhs_ros.studies.grid import require_evaluated
from rkhs_ros.studies.parallel import progress_bar
from rkhs_ros.studies.search_space import search_space

if TYPE_CHECKING:  # Optuna is an extra
    from optuna.trial import FrozenTrial

    from rkhs_ros.app.trials import Search

MOST_TRIALS = 100_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("config", type=Path, metavar="CONFIG", help="YAML file with the initial settings; see config/")
    add("--trials", type=int, required=True, metavar="N", help="total number of trials, including earlier ones")
    about = (
        "settings to search, such as algorithm.ridge or algorithm.ridge=1e-4:1 (default: numbers of algorithm, kernel)"
    )
    add("--over", nargs="+", action="extend", default=[], metavar="KEY", help=about)
    about = "seeds of the runs of each trial, such as 0-9 or 0,2,5 (default: %(default)s)"
    add("--seeds", default="0-2", metavar="SEEDS", help=about)
    add("--set", nargs="+", action="extend", default=[], metavar="KEY=VALUE", help="fixed settings to replace")
    add("--storage", metavar="URL", help="database in which Optuna stores the trials (default: SQLite in the folder)")
    add_worker_arguments(parser, "trials")
    about = "folder for the results (default: results/tuned/NAME); pass the same folder to continue a search"
    add("--out", type=Path, metavar="DIR", help=about)
    add("--quiet", action="store_true", help="no progress bar")


def run(options: argparse.Namespace) -> int:
    """Run the missing trials, write the trials and the best configuration, and print a summary."""
    require_extra("optuna", "sweeps", "tune")
    require(1 <= options.trials <= MOST_TRIALS, "--trials", f"a number in [1, {MOST_TRIALS}]", options.trials)
    workers, search = workers_of(options), _search(options)
    trials = import_module("rkhs_ros.app.trials")
    search.folder.mkdir(parents=True, exist_ok=True)
    with locked(search.folder):
        study = trials.begin(search)
        missing = max(options.trials - len(trials.ended(study)), 0)
        title, asking = search.first.training.name, trials.Asking(search, study, options.trials)
        try:
            with workers.opened(missing) as pool, progress_bar(title, missing, quiet=options.quiet) as advance:
                for measured in pool.results(trials.measure, asking.take, most=pool.width):
                    if asking.tell(measured):
                        advance()
        except KeyboardInterrupt:
            print("interrupted; run the same command to continue", file=sys.stderr)
            return INTERRUPTED
        _write(search, trials.ended(study))
    return 0


def _search(options: argparse.Namespace) -> Search:
    """Return the search that the options describe.

    Raises:
        ValueError: the initial settings are invalid, or there is nothing to search.
    """
    from rkhs_ros.app.trials import Search  # here, since the import needs Optuna

    require_all_used(options.set, {"--seeds": ["seed"]})
    config = load_config(options.config, options.set)
    require_evaluated(config)
    with runner_of(config.environment) as runner:
        first_state(config.training, runner.spaces)
        if not options.quiet:
            warn_of_horizon(runner.simulation, config.training.horizon, given=config.sets_horizon)
    folder = study_folder(options.out, "tuned", config.training.name)
    storage = options.storage or f"sqlite:///{folder / 'study.db'}"
    space = search_space(config, options.over)
    return Search(options.config.resolve(), tuple(options.set), parse_seeds(options.seeds), space, folder, storage)


def _write(search: Search, trials: list[FrozenTrial]) -> None:
    """Write the trials and the best configuration.

    Raises:
        RunError: no trial is complete.
    """
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    names = [each.name for each in search.space]
    writer.writerow(["trial", "state", "return", *names, "why"])
    for trial in trials:
        found = [trial.params[name] for name in names]
        writer.writerow([trial.number, trial.state.name.lower(), trial.value, *found, trial.user_attrs.get("why", "")])
    write_whole(search.folder / "trials.csv", text.getvalue().encode())
    complete = [trial for trial in trials if trial.state.name == "COMPLETE"]
    if not complete:
        raise RunError(f"{search.folder / 'trials.csv'}: expected at least one complete trial, got none")
    best = max(complete, key=_value)
    evidence = _evidence(search, trials, best)
    content = "".join(f"# {line}\n" for line in evidence) + resolved(search.config(best.params))
    write_whole(search.folder / "best.yaml", content.encode())
    print("\n".join([*evidence, f"Configuration: {search.folder / 'best.yaml'}"]))


def _value(trial: FrozenTrial) -> float:
    return float(trial.value) if trial.value is not None else -float("inf")


def _evidence(search: Search, trials: list[FrozenTrial], best: FrozenTrial) -> list[str]:
    """Return the lines that report the best settings and the evidence for them."""
    states = [trial.state.name for trial in trials]
    iterations, seeds = search.first.training.iterations, ", ".join(map(str, search.seeds))
    before = search.first_parameters
    first = next((trial for trial in trials if trial.params == before), None)
    initial = "none" if first is None or first.value is None else f"{first.value:.5g}"
    return [
        f"Evaluation return after {iterations} iterations, median over the seeds {seeds}: {_value(best):.5g}",
        f"in trial {best.number}; with the initial settings: {initial}",
        f"{len(trials)} trials: {states.count('PRUNED')} pruned, {states.count('FAIL')} failed",
        *(f"{name}: {before[name]} -> {value}" for name, value in best.params.items()),
    ]
