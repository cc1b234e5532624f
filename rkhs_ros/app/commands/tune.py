"""``rkhs tune``: search for settings that learn well."""

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
from rkhs_ros.base.validation import require
from rkhs_ros.learning.state import first_state
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.report import resolved
from rkhs_ros.studies.grid import require_evaluated
from rkhs_ros.studies.parallel import progress_bar
from rkhs_ros.studies.search_space import search_space
from rkhs_ros.studies.workers import require_extra

if TYPE_CHECKING:  # Optuna is an extra
    from optuna.trial import FrozenTrial

    from rkhs_ros.app.trials import Search

MOST_TRIALS = 100_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("config", type=Path, metavar="CONFIG", help="a YAML file, see config/, where the search begins")
    add("--trials", type=int, required=True, metavar="N", help="settings that are tried, those of before included")
    about = "settings to search, as algorithm.ridge or algorithm.ridge=1e-4:1 (the numbers of algorithm and kernel)"
    add("--over", nargs="+", action="extend", default=[], metavar="KEY", help=about)
    add("--seeds", default="0-2", metavar="SEEDS", help="a run for each in every trial, as 0-9 or 0,2,5 (%(default)s)")
    add("--set", nargs="+", action="extend", default=[], metavar="KEY=VALUE", help="settings that are not searched")
    add("--storage", metavar="URL", help="where Optuna keeps the trials (sqlite in the folder)")
    add_worker_arguments(parser, "trials")
    add("--out", type=Path, metavar="DIR", help="folder for the results (results/tuned/NAME); the same one goes on")
    add("--quiet", action="store_true", help="no progress bar")


def run(options: argparse.Namespace) -> int:
    """Make the trials that are missing, write them and the best configuration, and print what that is."""
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
            print("interrupted; the same command goes on", file=sys.stderr)
            return INTERRUPTED
        _write(search, trials.ended(study))
    return 0


def _search(options: argparse.Namespace) -> Search:
    """Return what is to be searched.

    Raises:
        ValueError: the settings cannot be begun with, or there is nothing to search.
    """
    from rkhs_ros.app.trials import Search  # once it is known that Optuna is there

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
        RunError: no trial came to its end.
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
        raise RunError(f"{search.folder / 'trials.csv'}: expected a trial that came to its end, got none")
    best = max(complete, key=_value)
    evidence = _evidence(search, trials, best)
    content = "".join(f"# {line}\n" for line in evidence) + resolved(search.config(best.params))
    write_whole(search.folder / "best.yaml", content.encode())
    print("\n".join([*evidence, f"Configuration: {search.folder / 'best.yaml'}"]))


def _value(trial: FrozenTrial) -> float:
    return float(trial.value) if trial.value is not None else -float("inf")


def _evidence(search: Search, trials: list[FrozenTrial], best: FrozenTrial) -> list[str]:
    """Return in lines what the best settings are and what speaks for them."""
    states = [trial.state.name for trial in trials]
    iterations, seeds = search.first.training.iterations, ", ".join(map(str, search.seeds))
    before = search.first_parameters
    first = next((trial for trial in trials if trial.params == before), None)
    began = "none" if first is None or first.value is None else f"{first.value:.5g}"
    return [
        f"Evaluation return after {iterations} iterations, median over the seeds {seeds}: {_value(best):.5g}",
        f"of trial {best.number}; of the settings where the search began: {began}",
        f"{len(trials)} trials: {states.count('PRUNED')} given up on their way, {states.count('FAIL')} failed",
        *(f"{name}: {before[name]} -> {value}" for name, value in best.params.items()),
    ]
