"""Trials of a search for settings, and their storage and execution."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import blake2b
from math import isfinite, nan
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import optuna
from optuna.trial import FrozenTrial, TrialState

from rkhs_ros.app.study import advance
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.provenance import TASKS, provenance
from rkhs_ros.studies.grid import Outcome
from rkhs_ros.studies.run_index import indexed_folder
from rkhs_ros.studies.search_space import Dimension

RUNGS = 4  # points of a run at which its trial may be pruned
WHY = "why"  # attribute of a failed trial
Parameters = Mapping[str, Any]


@dataclass(frozen=True)
class Search:
    """A search for settings.

    Attributes:
        file: configuration with the initial settings.
        changes: settings that replace the file's.
        seeds: seeds of the runs of each trial.
        space: settings to search, with their ranges.
        folder: absolute folder of the runs.
        storage: Optuna's URL of the database of trials.
    """

    file: Path
    changes: tuple[str, ...]
    seeds: tuple[int, ...]
    space: tuple[Dimension, ...]
    folder: Path
    storage: str

    def config(self, parameters: Parameters, seed: int | None = None) -> Config:
        """Return the configuration of a run.

        Raises:
            ValueError: the settings contradict each other.
        """
        found = [f"{name}={json.dumps(value)}" for name, value in parameters.items()]
        return load_config(self.file, [*self.changes, *found, *([] if seed is None else [f"seed={seed}"])])

    @cached_property
    def first(self) -> Config:
        """Initial configuration."""
        return self.config({})

    @property
    def first_parameters(self) -> dict[str, Any]:
        """Initial values of the searched settings."""
        given = self.first.settings
        values = {each.name: given[each.name] for each in self.space}
        return {name: value[0] if isinstance(value, tuple) else value for name, value in values.items()}

    @property
    def name(self) -> str:
        """Name of the study in its storage; it depends on everything that determines the trials."""
        content = [self.first.settings, self.seeds, [str(each) for each in self.space], provenance(*TASKS)]
        digest = blake2b(json.dumps(content, default=str).encode(), digest_size=6).hexdigest()
        return f"{self.first.training.name}-{digest}"

    def study(self) -> optuna.Study:
        """Return the stored study, or a new one."""
        optuna.logging.set_verbosity(logging.ERROR)
        return optuna.create_study(
            study_name=self.name,
            storage=self.storage,
            load_if_exists=True,
            direction="maximize",
            sampler=sampler(0),
            pruner=optuna.pruners.MedianPruner(),
        )


def begin(search: Search) -> optuna.Study:
    """Return the study; enqueue the initial settings if it is new, otherwise the trials that were interrupted.

    Raises:
        ValueError: the storage cannot be used.
    """
    try:
        study = search.study()
    except Exception as error:  # from the database's library, which may also be missing
        why = " ".join(str(error).split())
        raise ValueError(f"--storage: expected a database URL for Optuna, got {search.storage} ({why})") from error
    trials = study.get_trials(deepcopy=False)
    if not trials:
        study.enqueue_trial(search.first_parameters)
    for trial in trials:
        if trial.state == TrialState.RUNNING:
            study.tell(trial.number, state=TrialState.FAIL)
            study.enqueue_trial(trial.params)
    return study


def ended(study: optuna.Study) -> list[FrozenTrial]:
    """Return the finished trials in order; interrupted trials have no attribute with an error."""
    states = (TrialState.COMPLETE, TrialState.PRUNED)
    return [trial for trial in study.get_trials(deepcopy=False) if trial.state in states or WHY in trial.user_attrs]


class Measured(NamedTuple):
    """Intermediate result of a trial.

    Attributes:
        trial: number of the trial in the study.
        iterations: number of iterations so far.
        value: median over the seeds of the last evaluation return.
        why: error of the trial; empty if it did not fail.
    """

    trial: int
    iterations: int
    value: float
    why: str = ""


class Asking:
    """Running trials of a search.

    Owns the study: only this class asks it for settings and reports results. Workers know neither the study nor its
    storage; each task for a worker ends at the next rung.

    Args:
        search: the search.
        study: study of the search.
        count: total number of trials.
    """

    def __init__(self, search: Search, study: optuna.Study, count: int) -> None:
        self._search = search
        self._study = study
        self._rungs = rungs(search.first.training.iterations)
        self._space = {each.name: _distribution(each) for each in search.space}
        self._numbers = iter(range(len(ended(study)), count))
        self._running: dict[int, optuna.Trial] = {}
        self._waiting: list[tuple[optuna.Trial, int]] = []  # each with the iteration of its next rung

    def take(self) -> tuple[Search, int, Parameters, int] | None:
        """Return the arguments of `measure` for a waiting trial or a new one; None if there is none at the moment."""
        ready = self._ready()
        if ready is None and (number := next(self._numbers, None)) is not None:
            self._study.sampler = sampler(number)
            self._waiting.append((self._study.ask(self._space), self._rungs[0]))
            ready = self._ready()
        if ready is None:
            return None
        self._waiting.remove(ready)
        trial, iterations = ready
        self._running[trial.number] = trial
        return self._search, trial.number, dict(trial.params), iterations

    def _ready(self) -> tuple[optuna.Trial, int] | None:
        """Return a waiting trial, unless a running one has the same settings and therefore the same runs."""
        running = [trial.params for trial in self._running.values()]
        return next((each for each in self._waiting if each[0].params not in running), None)

    def tell(self, measured: Measured) -> bool:
        """Report an intermediate result of a trial; return whether the trial is finished."""
        trial = self._running.pop(measured.trial)
        if measured.why:
            trial.set_user_attr(WHY, measured.why)
            self._study.tell(trial, state=TrialState.FAIL)
            return True
        trial.report(measured.value, measured.iterations)
        if measured.iterations == self._rungs[-1]:
            self._study.tell(trial, measured.value)
        elif trial.should_prune():
            self._study.tell(trial, state=TrialState.PRUNED)
        else:
            self._waiting.append((trial, self._rungs[self._rungs.index(measured.iterations) + 1]))
            return False
        return True


def measure(search: Search, trial: int, parameters: Parameters, iterations: int) -> Measured:
    """Advance the runs of a trial to a number of iterations; return their median return, or the error if one fails."""
    try:
        runs = {indexed_folder(search.folder, each, *TASKS): each for each in _configs(search, parameters)}
        value = median(_return_after(folder, config, iterations) for folder, config in runs.items())
        if not isfinite(value):
            raise ValueError(f"evaluation return: expected a number, got {value} after {iterations} iterations")
    except Exception as error:  # failing settings must not stop the search
        return Measured(trial, iterations, nan, " ".join(f"{type(error).__name__}: {error}".split()))
    return Measured(trial, iterations, value)


def sampler(number: int) -> optuna.samplers.BaseSampler:
    """Return a sampler of settings whose randomness depends only on the number of the trial."""
    return optuna.samplers.TPESampler(seed=number, constant_liar=True)


def _distribution(dimension: Dimension) -> optuna.distributions.BaseDistribution:
    if dimension.choices:
        return optuna.distributions.CategoricalDistribution(dimension.choices)
    low, high, log = dimension.low, dimension.high, dimension.is_log
    if dimension.is_whole:
        return optuna.distributions.IntDistribution(int(low), int(high), log=log)
    return optuna.distributions.FloatDistribution(low, high, log=log)


def _configs(search: Search, parameters: Parameters) -> Iterator[Config]:
    return (search.config(parameters, seed) for seed in search.seeds)


def rungs(iterations: int) -> Sequence[int]:
    """Return the numbers of iterations after which a trial may be pruned, and the last iteration."""
    return sorted({-(-iterations * k // RUNGS) for k in range(1, RUNGS + 1)})


def _return_after(folder: Path, config: Config, iterations: int) -> float:
    """Return the last evaluation return of a run within a number of iterations; run the missing ones first."""
    curve = Curve(folder / "curve.csv")
    if len(curve.rows()) < iterations:
        advance(folder, replace(config, training=replace(config.training, iterations=iterations)))
    return Outcome.of(curve.rows()[:iterations], ()).final
