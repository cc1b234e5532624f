"""Trials of a search for settings: what each is, where all are stored, and how one is made."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import blake2b
from math import isfinite
from pathlib import Path
from statistics import median
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState

from rkhs_ros.app.study import advance
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.filing import filed
from rkhs_ros.runs.grid import Outcome
from rkhs_ros.runs.search_space import Dimension
from rkhs_ros.runs.surroundings import TASKS, surroundings

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
        content = [self.first.settings, self.seeds, [str(each) for each in self.space], surroundings(*TASKS)]
        digest = blake2b(json.dumps(content, default=str).encode(), digest_size=6).hexdigest()
        return f"{self.first.training.name}-{digest}"

    def study(self, seed: int = 0) -> optuna.Study:
        """Return the study, a new one or that which is there.

        Args:
            seed: of the settings that are proposed next.
        """
        optuna.logging.set_verbosity(logging.ERROR)
        return optuna.create_study(
            study_name=self.name,
            storage=self.storage,
            load_if_exists=True,
            direction="maximize",
            sampler=optuna.samplers.TPESampler(seed=seed, constant_liar=True),
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


def make_trial(search: Search, number: int) -> None:
    """Make the next trial, which is told to the study; settings that cannot be learnt with fail.

    Args:
        search: what is looked for.
        number: of the trials before it, from which the settings proposed follow.
    """
    study = search.study(number)
    trial = study.ask({each.name: _distribution(each) for each in search.space})
    try:
        value = _objective(search, trial)
    except optuna.TrialPruned:
        study.tell(trial, state=TrialState.PRUNED)
    except Exception as error:  # of these settings, which shall not end the search
        trial.set_user_attr(WHY, " ".join(f"{type(error).__name__}: {error}".split()))
        study.tell(trial, state=TrialState.FAIL)
    else:
        study.tell(trial, value)


def _distribution(dimension: Dimension) -> optuna.distributions.BaseDistribution:
    if dimension.choices:
        return optuna.distributions.CategoricalDistribution(dimension.choices)
    low, high, log = dimension.low, dimension.high, dimension.is_log
    if dimension.is_whole:
        return optuna.distributions.IntDistribution(int(low), int(high), log=log)
    return optuna.distributions.FloatDistribution(low, high, log=log)


def _objective(search: Search, trial: optuna.Trial) -> float:
    """Return the median over the seeds of the last noise-free return; given up where it falls behind on the way."""
    runs = {filed(search.folder, each, *TASKS): each for each in _configs(search, trial.params)}
    for rung in rungs(search.first.training.iterations):
        value = median(_return_after(folder, config, rung) for folder, config in runs.items())
        if not isfinite(value):
            raise ValueError(f"noise-free return: expected a number, got {value} after {rung} iterations")
        trial.report(value, rung)
        if rung < search.first.training.iterations and trial.should_prune():
            raise optuna.TrialPruned
    return value


def _configs(search: Search, parameters: Parameters) -> Iterator[Config]:
    return (search.config(parameters, seed) for seed in search.seeds)


def rungs(iterations: int) -> Sequence[int]:
    """Return the numbers of iterations after which a trial may be given up, and the last one."""
    return sorted({-(-iterations * k // RUNGS) for k in range(1, RUNGS + 1)})


def _return_after(folder: Path, config: Config, iterations: int) -> float:
    """Return the last noise-free return of a run after so many iterations, which is gone on with until then."""
    curve = Curve(folder / "curve.csv")
    if len(curve.rows()) < iterations:
        advance(folder, replace(config, training=replace(config.training, iterations=iterations)))
    return Outcome.of(curve.rows()[:iterations], ()).final
