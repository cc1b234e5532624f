"""Define the learners of the table of tasks, and what their learning curves depend on.

CMA-ES and augmented random search (ARS) search for linear policies by whole episodes. A candidate is the weights of a
policy. Its inputs are standardised by the observations of earlier generations. Its actions are in units of half their
range, and clipped to it. One real episode scores it.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from hashlib import blake2b
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Protocol

import numpy as np
from cmaes import CMA

import deep_peers
from rkhs_ros.learning.training import train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch, stream
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Linear
from rkhs_ros.runs.report import LIBRARIES
from trial import Meter, MeteredRunner, Point, Trial

FIRST_SD = 0.5  # initial standard deviation of the weights in CMA-ES
DIRECTIONS, BEST = 8, 4  # directions that ARS samples, and those that it uses
PROBE, STEP_SIZE = 0.1, 0.1  # size of the perturbation and of the step in ARS
NEGLIGIBLE_VARIANCE = 1e-18  # of a deterministic policy
CODE = tuple(f"rkhs_ros.{part}" for part in ("base", "rkhs", "policies", "learning", "rollouts", "runs"))
CONSTANT = 1e-8  # standard deviation below which an input is ignored


class Search(Protocol):
    """A search for the point with the greatest score."""

    @property
    def mean(self) -> Array:
        """The best estimate so far, shape (d,)."""

    def ask(self) -> Array:
        """Return the candidates of a generation, shape (candidates, d)."""

    def tell(self, candidates: Array, scores: Array) -> None:
        """Update the search with the scores of the candidates, shape (candidates,)."""


class CMAES:
    """CMA-ES of the package ``cmaes``, with its default population. Owns its state.

    Args:
        size: number of weights, at least 2.
        seed: seed of all samples.
    """

    def __init__(self, size: int, seed: int) -> None:
        self._search = CMA(np.zeros(size), FIRST_SD, seed=seed)

    @property
    def mean(self) -> Array:
        """The mean of the distribution."""
        return np.asarray(self._search.mean)

    def ask(self) -> Array:
        """Sample a population."""
        return np.array([self._search.ask() for _ in range(self._search.population_size)])

    def tell(self, candidates: Array, scores: Array) -> None:
        """Update the distribution."""
        self._search.tell([(x, -score) for x, score in zip(candidates, scores, strict=True)])


class ARS:
    """Augmented random search, version V2-t (Mania, Guy and Recht, 2018). Owns its point and its random stream.

    The step is a sum of the best random directions, weighted by their finite differences and divided by the standard
    deviation of their scores. `learn` standardises the inputs.

    Args:
        size: number of weights.
        seed: seed of all samples.
    """

    def __init__(self, size: int, seed: int) -> None:
        self.mean = np.zeros(size)
        self._stream = stream(seed, "random search", 0)

    def ask(self) -> Array:
        """Return two candidates per direction: first all on one side, then all on the other."""
        directions = self._stream.standard_normal((DIRECTIONS, len(self.mean)))
        return self.mean + PROBE * np.concatenate([directions, -directions])

    def tell(self, candidates: Array, scores: Array) -> None:
        """Take a step."""
        ahead, behind = scores.reshape(2, DIRECTIONS)
        best = np.argsort(-np.maximum(ahead, behind), kind="stable")[:BEST]
        sd = np.concatenate([ahead[best], behind[best]]).std()
        directions = (candidates[best] - self.mean) / PROBE
        if sd > 0:
            self.mean = self.mean + STEP_SIZE / (BEST * sd) * (ahead - behind)[best] @ directions


@dataclass(frozen=True, kw_only=True)
class Bounded(Function):
    """A function with values clipped to bounds of shape (n,), so that values fed back stay finite."""

    low: Array
    high: Array

    def __call__(self, x: Array) -> Array:
        """Evaluate at points of shape (batch, d): shape (batch, n)."""
        return np.clip(super().__call__(x), self.low, self.high)


def linear(weights: Array, seen: Array, spaces: Spaces) -> Function:
    """Return a linear function of standardised inputs.

    Args:
        weights: the constant and the slopes of each action in turn, shape (n (d + 1),).
        seen: inputs by which to standardise, shape (samples, d); without samples they are not standardised.
        spaces: spaces of the task.
    """
    d = seen.shape[1]
    centre, scale = (seen.mean(axis=0), seen.std(axis=0)) if len(seen) else (np.zeros(d), np.ones(d))
    scale = np.where(scale > CONSTANT, scale, 1.0)
    low, high = (bound.ravel().astype(np.float64) for bound in (spaces.action_low, spaces.action_high))
    constant, *slopes = weights.reshape(-1, d + 1).T * spaces.half_ranges
    # The kernel is 1 at the first centre, and 1 plus the input j at the centre j.
    centres = centre + np.concatenate([np.zeros((1, d)), np.diag(scale)])
    coefficients = np.array([constant - np.sum(slopes, axis=0), *slopes])
    kernel = Linear(tuple(centre), tuple(scale))
    return Bounded(kernel=kernel, centres=centres, weights=coefficients, low=low, high=high)


def linear_search(make: Callable[[int, int], Search], trial: Trial) -> Iterator[Point]:
    """Run a search, and evaluate its estimate after each generation.

    Args:
        make: creates the search from the number of weights and a seed.
        trial: the task.
    """
    training, inputs = trial.config.training, trial.config.training.inputs
    meter = Meter(training.discount)
    runner = MeteredRunner(trial.config, meter)
    spaces = runner.spaces
    seen = np.zeros((0, inputs.dimension(spaces.observation_dim, spaces.action_dim)))
    search = make(spaces.action_dim * (seen.shape[1] + 1), training.seed)
    variance = ConstantVariance(np.full(spaces.action_dim, NEGLIGIBLE_VARIANCE))
    evaluated, rows = 0, training.evaluation_episodes
    while meter.episodes < trial.episodes:
        candidates, scores, generation = search.ask(), [], [seen]
        for weights in candidates:
            policy = GaussianPolicy(linear(weights, seen, spaces), variance, inputs)
            batch = Batch(training.seed, meter.episodes, 1, training.horizon, explore=True)
            episode = runner.collect(policy, batch).with_inputs(inputs)
            scores.append(episode.returns(trial.judged_by)[0])
            generation.append(episode.flat(episode.observations))
        search.tell(candidates, np.array(scores))
        seen = np.concatenate(generation)
        policy = GaussianPolicy(linear(search.mean, seen, spaces), variance, inputs)
        batch = Batch(training.seed, evaluated, rows, training.horizon, explore=False)
        evaluated += rows
        yield meter.point(runner.collect(policy, batch).rewards)


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
            _source_digest((*self.code, "sim_nodes")),
            scripts,
        ]
        return blake2b(json.dumps(content, sort_keys=True).encode(), digest_size=8).hexdigest()


def _source_digest(packages: Iterable[str]) -> str:
    """Return a digest of the source files of packages."""
    digest = blake2b(digest_size=8)
    for package in packages:
        for folder in import_module(package).__path__:
            for path in sorted(Path(folder).rglob("*.py")):
                digest.update(path.read_bytes())
    return digest.hexdigest()


def _linear(make: Callable[[int, int], Search]) -> Learner:
    learn = partial(linear_search, make)
    return Learner(learn, scripts=("trial.py", "task_learners.py"), packages=("cmaes",))


def _deep(name: str, *packages: str) -> Learner:
    scripts, policies = ("trial.py", "deep_peers.py"), ("rkhs_ros.policies",)
    return Learner(partial(deep_peers.learn, name), code=policies, scripts=scripts, packages=(*packages, "torch"))


LEARNERS = {
    "ours": Learner(policy_search, settings=("",)),
    "no-model": Learner(policy_search, ("model.form=none",), settings=("",)),
    "linear-cma-es": _linear(CMAES),
    "linear-ars": _linear(ARS),
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
