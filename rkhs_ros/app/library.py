"""Library functions: train in this process on any Gymnasium environment with one call."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from numpy.typing import NDArray

from rkhs_ros.app.inline import warn_of_horizon
from rkhs_ros.app.learn_settings import LearnSettings
from rkhs_ros.base.settings import Settings
from rkhs_ros.base.threads import use_one_thread
from rkhs_ros.base.validation import hint, nearest, pick, require
from rkhs_ros.learning.algorithms.algorithm import Algorithm
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.diagnosis import Diagnosis
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.model.model_based import MODELS, NoModel
from rkhs_ros.learning.state import first_state
from rkhs_ros.learning.training import Iteration
from rkhs_ros.learning.training import train as iterations_of
from rkhs_ros.learning.training_settings import Training, training_from
from rkhs_ros.policies.policy import Policy, load
from rkhs_ros.policies.storage import Task
from rkhs_ros.rkhs.kernels import Array, Kernel
from rkhs_ros.rollouts.environments import Source
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.model_env import LearntModel
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import name_of_run
from rkhs_ros.runs.curve import Row, columns
from rkhs_ros.runs.defaults import settings_for
from rkhs_ros.runs.progress import progress_bar

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Result:
    """Result of training up to an iteration.

    Attributes:
        policy: the policy after the iteration.
        best_policy: the policy with the greatest evaluation return minus its standard error so far; None before the
            first evaluation.
        iteration: episodes, returns and metrics of the iteration.
        rows: the lines of curve.csv so far.
        training: the settings of the run.
    """

    policy: Policy
    best_policy: Policy | None
    iteration: Iteration
    rows: tuple[Row, ...]
    training: Training

    def __repr__(self) -> str:
        """Return a summary in one line."""
        row, last = self.rows[-1], self.iteration
        returns = f"return {last.exploration_return:.4g}, evaluation return {last.evaluation_return:.4g}"
        name = self.policy.task.environment
        return f"<Result of {name}: {row.iteration} iterations, {row.episodes} episodes, {returns}>"

    @property
    def curve(self) -> dict[str, NDArray[Any]]:
        """The columns of curve.csv as arrays by name, with one entry per iteration."""
        return columns(self.rows)

    @cached_property
    def model(self) -> LearntModel:
        """The dynamics model, fitted on first use to all real episodes so far.

        Raises:
            ValueError: the run has no model.
            RunError: a prior function failed.
        """
        return LearntModel.of(self.training, self.iteration.state, self.policy.spaces)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return a figure of the learning curve.

        Args:
            path: file to save the figure to, if any.

        Raises:
            OSError: the file cannot be written.
        """
        from rkhs_ros.pictures.run_pictures import curve_figure  # here, since the import is slow

        figure = curve_figure(self.curve, self.policy.task)
        if path is not None:
            figure.savefig(path, dpi=120)
        return figure


@dataclass(frozen=True)
class GivenKernel(KernelChoice):
    """Kernel choice that always returns the given kernel."""

    kernel: Kernel | None = None

    @property
    def is_for_given_inputs(self) -> bool:
        """Whether the kernel does not fit other inputs; assumed of a given kernel."""
        return self.kernel is not None or super().is_for_given_inputs

    def fit(self, points: Array, ages: int = 1) -> Kernel:
        """Return the kernel."""
        return self.kernel if self.kernel is not None else super().fit(points, ages)


def train(
    environment: Source,
    algorithm: Algorithm | str | None = None,
    *,
    progress: bool = True,
    **settings: Unpack[LearnSettings],
) -> Result:
    """Train a policy and return it with its learning curve.

    Args:
        environment: a Gymnasium id (``module:Id-v0`` imports the module that registers it), an environment, a vector
            environment, or a function or class that returns one. Observations and actions must be continuous. `train`
            closes the environments that it creates, and leaves a passed environment open.
        algorithm: an algorithm such as ``RKHSNAC(centres=80)``, or its name; None stands for RKHS-NAC. Settings that
            are not given have the defaults of `rkhs_ros.runs.defaults`.
        progress: show a progress bar on standard error, and what to try if the run does not learn.
        **settings: keywords of `LearnSettings`, such as ``iterations``, ``seed``, ``kernel`` and ``model``.

    Returns:
        The result after the last iteration.

    Raises:
        ValueError: a setting is unknown or invalid, or the environment cannot be used.
    """
    training, runner, warm_start = _prepared(environment, algorithm, settings)
    with progress_bar(training, quiet=not progress) as show, closing(_results(training, runner, warm_start)) as results:
        diagnosis = Diagnosis(training, runner.spaces)
        for result in results:  # the last one is returned
            show(result.iteration, diagnosis.advise(result.iteration) if progress else None)
    return result


def learn(
    environment: Source, algorithm: Algorithm | str | None = None, **settings: Unpack[LearnSettings]
) -> Iterator[Result]:
    """Train a policy and yield the result of each iteration, for callbacks and early stopping.

    Args:
        environment: as for `train`.
        algorithm: as for `train`.
        **settings: keywords of `LearnSettings`, such as ``iterations``, ``seed``, ``kernel`` and ``model``.

    Raises:
        ValueError: a setting is unknown or invalid, or the environment cannot be used.
    """
    return _results(*_prepared(environment, algorithm, settings))


def _prepared(
    environment: Source, algorithm: Algorithm | str | None, settings: Mapping[str, Any]
) -> tuple[Training, InlineRunner, Policy | None]:
    """Return the checked settings, the runner and the initial policy."""
    use_one_thread()
    _check_order(environment)
    given = dict(settings)
    start = given.pop("policy", None)
    simulation = Simulation(environment, given.pop("options", None), given.pop("num_envs", 0))
    with ExitStack() as undo:
        undo.callback(simulation.close)
        warm_start = load(start) if isinstance(start, str | Path) else start
        good = warm_start is None or isinstance(warm_start, Policy)
        require(good, "policy", "a Policy or a policy file", warm_start)
        training = _training(simulation, algorithm, given)
        undo.pop_all()
    if "horizon" not in given:
        warn_of_horizon(simulation, training.horizon, given=False)
    return training, InlineRunner(simulation), warm_start


def _training(simulation: Simulation, algorithm: Algorithm | str | None, settings: Mapping[str, Any]) -> Training:
    """Return the checked settings of a run in a simulation, with the defaults of `defaults`."""
    known = {f.name: f for f in fields(Training)}
    for name in settings:
        if name not in known:
            raise ValueError(f"unknown setting '{name}', {_meant(name, known)}")
    horizon = simulation.time_limit or Training.horizon
    given = {"name": name_of_run(simulation.environment), "horizon": horizon, **settings}
    if isinstance(algorithm, str):
        pick(algorithm, ALGORITHMS, "algorithm")
    if isinstance(given.get("model"), str):
        given["model"] = pick(given["model"], MODELS, "model")()
    name = algorithm if isinstance(algorithm, str) else _name_of(algorithm)
    form = "none" if isinstance(given.get("model"), NoModel) else "gaussian_process"
    untuned = training_from(settings_for(name, form, given["horizon"]))
    kernel = given.get("kernel", untuned.kernel)
    if isinstance(kernel, str):
        kernel = replace(untuned.kernel, form=kernel)
    given["kernel"] = GivenKernel(kernel=kernel) if isinstance(kernel, Kernel) else kernel
    require(not isinstance(algorithm, type), "algorithm", "an instance such as RKHSNAC()", algorithm)
    if not isinstance(algorithm, str | None):
        given["algorithm"] = algorithm
    nested = {name: value for name, value in given.items() if isinstance(value, Settings)}
    over = {name: value.with_defaults(getattr(untuned, name)) for name, value in nested.items()}
    return replace(untuned, **given | over)


def _name_of(algorithm: object) -> str:
    """Return the name of an algorithm, or the default name if the object is not an algorithm."""
    return next((name for name, each in ALGORITHMS.items() if type(algorithm) is each), "rkhs_nac")


def _check_order(environment: object) -> None:
    """Raise ValueError if the algorithm is passed as the environment."""
    kind = environment if isinstance(environment, type) else type(environment)
    if isinstance(environment, str) and environment in ALGORITHMS:
        kind = ALGORITHMS[environment]
    hint = f"the algorithm {kind.__name__}. Pass the environment first: train(environment, {kind.__name__}())"
    expected = "an id, an environment, or a function that returns one"
    require(not issubclass(kind, Algorithm), "environment", expected, hint)


def _meant(name: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown setting: the nearest setting of a run, or of an algorithm."""
    algorithms: list[type[Algorithm]] = [*reversed(ALGORITHMS.values()), ALGORITHMS["rkhs_nac"]]
    owners = {f.name: each.__name__ for each in algorithms for f in fields(each)}
    of_run = dict.fromkeys([*LearnSettings.__annotations__, *known])
    near = [] if name not in owners and nearest(name, of_run) else nearest(name, owners)
    return f"did you mean {owners[near[0]]}({near[0]}=...)?" if near else hint(name, of_run)


def _results(training: Training, runner: InlineRunner, warm_start: Policy | None) -> Generator[Result, None, None]:
    simulation, begin = runner.simulation, time.monotonic()
    rows: tuple[Row, ...] = ()
    best: Policy | None = None
    task = Task(simulation.environment, simulation.options, training.horizon, training.discount)
    highest = float("-inf")
    with runner:
        first = first_state(training, runner.spaces, warm_start.gaussian if warm_start else None)
        for iteration in iterations_of(training, runner, first):
            rows = (*rows, Row.of(iteration, time.monotonic() - begin))
            policy = Policy(iteration.policy, task, runner.spaces)
            if iteration.evaluation_bound > highest:
                highest, best = iteration.evaluation_bound, policy
            yield Result(policy, best, iteration, rows, training)
