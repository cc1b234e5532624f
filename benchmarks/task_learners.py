"""Define the learners of the table of tasks, and what their learning curves depend on."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from hashlib import blake2b
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import deep_peers
import linear_search
from rkhs_ros.learning.training import train
from rkhs_ros.runs.provenance import CODE, LIBRARIES, code_digest
from trial import Meter, MeteredRunner, Point, Trial

HERE = Path(__file__).parent
SEEN_BY_ALL = ("environment.", "inputs.", "seed", "horizon", "discount", "evaluation_episodes")


def policy_search(trial: Trial) -> Iterator[Point]:
    """Train by the configuration."""
    training = trial.config.training
    meter = Meter(training.discount)
    for iteration in train(training, MeteredRunner(trial.config, meter)):
        yield meter.point(iteration.evaluation.rewards)
        if meter.episodes >= trial.episodes:
            return


@dataclass(frozen=True)
class Learner:
    """A learner, and what its curves depend on besides the task.

    Attributes:
        learn: function from a trial to the points of its curve.
        changes: changes of the default settings.
        settings: prefixes of the settings that it uses.
        code: packages of the project that it uses.
        scripts: files of this folder that it uses.
        packages: packages that must be installed.
    """

    learn: Callable[[Trial], Iterable[Point]]
    changes: tuple[str, ...] = ()
    settings: tuple[str, ...] = SEEN_BY_ALL
    code: tuple[str, ...] = CODE
    scripts: tuple[str, ...] = ("trial.py",)
    packages: tuple[str, ...] = ()

    def key(self, trial: Trial, packages: Iterable[str]) -> str:
        """Return a hash of everything that the curve depends on.

        Args:
            trial: the task.
            packages: packages that the task needs besides those of the learner.
        """
        settings = {name: value for name, value in trial.config.settings.items() if name.startswith(self.settings)}
        versions = LIBRARIES | {name: version(name) for name in (*self.packages, *packages)}
        scripts = [(HERE / name).read_text() for name in self.scripts]
        content = [
            trial.episodes,
            trial.discounted,
            settings,
            versions,
            code_digest((*self.code, "sim_nodes")),
            scripts,
        ]
        return blake2b(json.dumps(content, sort_keys=True).encode(), digest_size=8).hexdigest()


def _linear(make: Callable[[int, int], linear_search.Search]) -> Learner:
    learn = partial(linear_search.learn, make)
    return Learner(learn, scripts=("trial.py", "linear_search.py"), packages=("cmaes",))


def _deep(name: str, *packages: str) -> Learner:
    scripts, policies = ("trial.py", "deep_peers.py"), ("rkhs_ros.policies",)
    return Learner(partial(deep_peers.learn, name), code=policies, scripts=scripts, packages=(*packages, "torch"))


LEARNERS = {
    "ours": Learner(policy_search, settings=("",)),
    "no-model": Learner(policy_search, ("model.form=none",), settings=("",)),
    "linear-cma-es": _linear(linear_search.CMAES),
    "linear-ars": _linear(linear_search.ARS),
    "sac": _deep("SAC", "stable-baselines3"),
    "crossq": _deep("CrossQ", "stable-baselines3", "sb3-contrib"),
}


def missing(packages: Iterable[str]) -> list[str]:
    """Return the packages that are not installed."""
    return [name for name in packages if not _is_installed(name)]


def _is_installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True
