"""Trials of a search for settings: what each is, where all are stored, and how they are made."""

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

RUNGS = 4  # of a run, at which it may be given up
WHY = "why"  # attribute of a trial that failed
Parameters = Mapping[str, Any]


@dataclass(frozen=True)
class Search:
    """A search for settings.

    Attributes:
        file: the configuration where it begins.
        changes: settings that replace the file's.
        seeds: of the runs of a trial.
        space: what is searched.
        folder: where the runs go, as an absolute path.
        storage: where the trials are kept, a URL as Optuna has them.
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
            ValueError: the settings do not go together.
        """
        found = [f"{name}={json.dumps(value)}" for name, value in parameters.items()]
        return load_config(self.file, [*self.changes, *found, *([] if seed is None else [f"seed={seed}"])])

    @cached_property
    def first(self) -> Config:
        """The configuration where it begins."""
        return self.config({})

    @property
    def first_parameters(self) -> dict[str, Any]:
        """What is searched, as the configuration has it."""
        given = self.first.settings
        values = {each.name: given[each.name] for each in self.space}
        return {name: value[0] if isinstance(value, tuple) else value for name, value in values.items()}

    @property
    def name(self) -> str:
        """The name of the study in its storage; another one for all that its trials follow from."""
        content = [self.first.settings, self.seeds, [str(each) for each in self.space], provenance(*TASKS)]
        digest = blake2b(json.dumps(content, default=str).encode(), digest_size=6).hexdigest()
        return f"{self.first.training.name}-{digest}"

    def study(self) -> optuna.Study:
        """Return the study, a new one or that which is there."""
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
    """Return the study with its first trial to be made, or, where it goes on, those that were cut off.

    Raises:
        ValueError: the storage cannot be used.
    """
    try:
        study = search.study()
    except Exception as error:  # of the database's library, or of one that is not installed
        why = " ".join(str(error).split())
        raise ValueError(f"--storage: expected a URL as Optuna has them, got {search.storage} ({why})") from error
    trials = study.get_trials(deepcopy=False)
    if not trials:
        study.enqueue_trial(search.first_parameters)
    for trial in trials:
        if trial.state == TrialState.RUNNING:
            study.tell(trial.number, state=TrialState.FAIL)
            study.enqueue_trial(trial.params)
    return study


def ended(study: optuna.Study) -> list[FrozenTrial]:
    """Return the trials that came to an end, in their order; of those cut off nobody says why they failed."""
    came = (TrialState.COMPLETE, TrialState.PRUNED)
    return [trial for trial in study.get_trials(deepcopy=False) if trial.state in came or WHY in trial.user_attrs]


class Measured(NamedTuple):
    """What a trial came to on its way.

    Attributes:
        trial: its number in the study.
        iterations: after which it was measured.
        value: the median over the seeds of the last evaluation return.
        why: it cannot be learnt with these settings; empty where it can.
    """

    trial: int
    iterations: int
    value: float
    why: str = ""


class Asking:
    """The trials of a search that are under way.

    Owns the study: it alone asks for settings and tells what came of them. Who learns knows of no study, nor
    where it is stored, and is asked for no more than the way to the next rung.

    Args:
        search: what is looked for.
        study: its study.
        count: trials to be made.
    """

    def __init__(self, search: Search, study: optuna.Study, count: int) -> None:
        self._search = search
        self._study = study
        self._rungs = rungs(search.first.training.iterations)
        self._space = {each.name: _distribution(each) for each in search.space}
        self._numbers = iter(range(len(ended(study)), count))
        self._under_way: dict[int, optuna.Trial] = {}
        self._waiting: list[tuple[optuna.Trial, int]] = []  # and until which iteration they are to be measured

    def take(self) -> tuple[Search, int, Parameters, int] | None:
        """Return what is to be measured next: one that goes on, or a new trial; None where there is none for now."""
        ready = self._ready()
        if ready is None and (number := next(self._numbers, None)) is not None:
            self._study.sampler = sampler(number)
            self._waiting.append((self._study.ask(self._space), self._rungs[0]))
            ready = self._ready()
        if ready is None:
            return None
        self._waiting.remove(ready)
        trial, iterations = ready
        self._under_way[trial.number] = trial
        return self._search, trial.number, dict(trial.params), iterations

    def _ready(self) -> tuple[optuna.Trial, int] | None:
        """Return a trial that can go on; not one with the settings, and so the runs, of another at work."""
        at_work = [trial.params for trial in self._under_way.values()]
        return next((each for each in self._waiting if each[0].params not in at_work), None)

    def tell(self, measured: Measured) -> bool:
        """Take what a trial came to; return whether that is its end."""
        trial = self._under_way.pop(measured.trial)
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
    """Go on with the runs of a trial until they have made so many iterations; of settings that fail say why."""
    try:
        runs = {indexed_folder(search.folder, each, *TASKS): each for each in _configs(search, parameters)}
        value = median(_return_after(folder, config, iterations) for folder, config in runs.items())
        if not isfinite(value):
            raise ValueError(f"evaluation return: expected a number, got {value} after {iterations} iterations")
    except Exception as error:  # of these settings, which shall not end the search
        return Measured(trial, iterations, nan, " ".join(f"{type(error).__name__}: {error}".split()))
    return Measured(trial, iterations, value)


def sampler(number: int) -> optuna.samplers.BaseSampler:
    """Return what proposes settings, after a number of trials on which alone its randomness depends."""
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
    """Return the numbers of iterations after which a trial may be given up, and the last one."""
    return sorted({-(-iterations * k // RUNGS) for k in range(1, RUNGS + 1)})


def _return_after(folder: Path, config: Config, iterations: int) -> float:
    """Return the last evaluation return of a run after so many iterations, which is gone on with until then."""
    curve = Curve(folder / "curve.csv")
    if len(curve.rows()) < iterations:
        advance(folder, replace(config, training=replace(config.training, iterations=iterations)))
    return Outcome.of(curve.rows()[:iterations], ()).final
