"""Library functions: train in this process on any Gymnasium environment with one call."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray
from yaml import YAMLError

from rkhs_ros.app.inline import warn_of_horizon
from rkhs_ros.app.learn_settings import LearnSettings, training_in
from rkhs_ros.base.validation import require
from rkhs_ros.base.yaml_text import dumped
from rkhs_ros.learning.algorithms.algorithm import Algorithm
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.diagnosis import Diagnosis
from rkhs_ros.learning.iteration import Iteration, Row
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.state import State, first_state
from rkhs_ros.learning.training import train as iterations_of
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.policy import Policy, load
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import packed, policy_arrays
from rkhs_ros.rollouts.environments import Source
from rkhs_ros.rollouts.evaluation import FinalEvaluation, final_evaluation
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.model_env import LearntModel
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.curve import columns, has_events
from rkhs_ros.runs.progress import progress_bar
from rkhs_ros.runs.report import Report, initial_policy, is_started, new_folder, start_from
from rkhs_ros.runs.run import training_steps

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Result:
    """Result of training up to an iteration.

    Attributes:
        policy: the policy after the iteration.
        best_policy: the policy with the greatest evaluation return minus its standard error so far; None before the
            first evaluation. After the last iteration, the last policy if that is better in fresh episodes.
        iteration: episodes, returns and metrics of the iteration.
        rows: the lines of curve.csv so far.
        training: the settings of the run.
        final: returns of the best and the last policy in fresh episodes, after the last iteration of a run with
            evaluations; else None.
    """

    policy: Policy
    best_policy: Policy | None
    iteration: Iteration
    rows: tuple[Row, ...]
    training: Training
    final: FinalEvaluation | None = None

    def __repr__(self) -> str:
        """Return a summary in one line."""
        row, last = self.rows[-1], self.iteration
        returns = f"return {last.exploration_return:.4g}, evaluation return {last.evaluation_return:.4g}"
        name = self.policy.task.environment
        final = f"; {self.final}" if self.final else ""
        return f"<Result of {name}: {row.iteration} iterations, {row.episodes} episodes, {returns}{final}>"

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


Callback = Callable[[Result], "bool | None"]


def train(
    environment: Source,
    algorithm: Algorithm | str | None = None,
    *,
    progress: bool = True,
    callback: Callback | None = None,
    **settings: Unpack[LearnSettings],
) -> Result:
    """Train a policy and return it with its learning curve.

    Args:
        environment: a Gymnasium id (``module:Id-v0`` imports the module that registers it), an environment, a vector
            environment, or a function or class that returns one. Observations and actions must be continuous. `train`
            closes the environments that it creates, and leaves a passed environment open.
        algorithm: an algorithm such as ``RKHSNAC(centres=80)``, or its name; None stands for RKHS-NAC. An object is
            used as it is; for a name without a model, `rkhs_ros.runs.defaults` has settings for few samples.
        progress: show a progress bar on standard error, and what to try if the run does not learn.
        callback: function that takes the result of each iteration, after its files are written; False stops the run,
            other values continue it.
        **settings: keywords of `LearnSettings`, such as ``iterations``, ``seed``, ``kernel``, ``model`` and ``out``.

    Returns:
        The result after the last iteration.

    Raises:
        ValueError: a setting is unknown or invalid, the environment cannot be used, or the folder ``out`` is in use or
            contains another run.
        RunError: the environment failed.
        OSError: the folder ``out`` cannot be written.
    """
    require(callback is None or callable(callback), "callback", "a function of a Result", callback)
    with closing(_results(environment, algorithm, quiet=not progress, **settings)) as results:
        for result in results:  # the last one is returned
            answer = callback(result) if callback else None
            if isinstance(answer, (bool, np.bool_)) and not answer:
                break
    if progress and result.iteration.number < result.training.iterations:
        print(f"stopped by the callback after iteration {result.iteration.number}", file=sys.stderr, flush=True)
    return result


def learn(
    environment: Source, algorithm: Algorithm | str | None = None, **settings: Unpack[LearnSettings]
) -> Generator[Result, None, None]:
    """Train a policy and yield the result of each iteration, for loops of your own and early stopping.

    The arguments and errors are those of `train`.
    """
    return _results(environment, algorithm, quiet=True, **settings)


def _results(
    environment: Source,
    algorithm: Algorithm | str | None,
    *,
    quiet: bool,
    policy: Policy | str | Path | None = None,
    options: Mapping[str, Any] | None = None,
    num_envs: int = 0,
    out: str | Path | None = None,
    resume: bool = False,
    tensorboard: bool = False,
    **settings: Any,
) -> Generator[Result, None, None]:
    """Check the settings of a run and create its folder; return a generator that runs it and yields the results."""
    require(out is None or isinstance(out, str | Path), "out", "a folder", out)
    for name, value in (("resume", resume), ("tensorboard", tensorboard)):
        require(isinstance(value, bool), name, "True or False", value)
        require(out is not None or not value, name, "out=FOLDER as well", "none")
    has_events(None, tensorboard)
    simulation = Simulation(environment, options, num_envs)
    with ExitStack() as undo:
        undo.callback(simulation.close)
        start = load(policy) if isinstance(policy, str | Path) else policy
        require(start is None or isinstance(start, Policy), "policy", "a Policy or a policy file", start)
        given = start.gaussian if start else None
        training = training_in(simulation, algorithm, settings)
        config = Config(Environment(simulation.environment, simulation.options, num_envs), training)
        first = first_state(training, simulation.spaces, given)
        if out is not None:
            _make_folder(Path(out), config, given, simulation.spaces, resume=resume)
        undo.pop_all()
    if "horizon" not in settings:
        warn_of_horizon(simulation, training.horizon)
    runner = InlineRunner(simulation)
    if out is None:
        steps = _in_memory(training, runner, first, quiet)
    else:
        folder, goes_on = Path(out), is_started(Path(out))
        written = training_steps(config, runner, folder, quiet=quiet, resume=goes_on, tensorboard=tensorboard)
        steps = _in_folder(folder, written)
    results = _run(config, runner, steps)
    next(results)
    return results


def _make_folder(
    out: Path, config: Config, first_policy: GaussianPolicy | None, spaces: Spaces, *, resume: bool
) -> None:
    """Create the folder of a new run with its initial policy, unless it contains a run to resume."""
    kernel, options = config.training.kernel, dict(config.environment.options)
    expected = "a text or a KernelChoice, such as KernelChoice(bandwidth=0.5), which out= can store in config.yaml"
    require(type(kernel) is KernelChoice, "kernel", expected, getattr(kernel, "kernel", kernel))
    algorithm, expected = config.training.algorithm, "one of `ALGORITHMS`, which out= can store in config.yaml"
    require(type(algorithm) in ALGORITHMS.values(), "algorithm", expected, algorithm)
    try:
        dumped(options)
        json.dumps(options)  # in policies and recordings
    except (YAMLError, TypeError, ValueError) as error:
        raise ValueError(f"options: expected values that out= can store in config.yaml, got {options}") from error
    if is_started(out):
        require(resume, f"{out}", "a new or empty folder, or resume=True to continue the run in it", "a run")
        given = initial_policy(out)
        same = first_policy is None or (given and packed(policy_arrays(given)) == packed(policy_arrays(first_policy)))
        require(bool(same), "policy", f"none, or the initial policy of the run in {out}", "another one")
        return
    new_folder(out, config.training.name)
    start_from(out, config, first_policy, spaces)


# Iterations with the curve so far, the best policy so far and, after the last one, the final evaluation.
Steps = Generator[tuple[Iteration, list[Row], GaussianPolicy | None, FinalEvaluation | None], None, None]


def _run(config: Config, runner: InlineRunner, steps: Steps) -> Generator[Any, None, None]:
    """Yield None, after which closing the generator closes the environment, and the results."""
    acting = partial(Policy, task=config.task, spaces=runner.spaces)
    with runner, closing(steps):
        yield None
        for iteration, rows, best, final in steps:
            policy, best_policy = acting(iteration.policy), acting(best) if best else None
            yield Result(policy, best_policy, iteration, tuple(rows), config.training, final)


def _in_memory(training: Training, runner: InlineRunner, first: State, quiet: bool) -> Steps:
    began, highest, best, rows = time.monotonic(), float("-inf"), None, list[Row]()
    diagnosis = Diagnosis(runner.spaces)
    with progress_bar(training, quiet=quiet) as show:
        for iteration in iterations_of(training, runner, first):
            if iteration.evaluation_bound > highest:
                highest, best = iteration.evaluation_bound, iteration.policy
            rows.append(iteration.row(time.monotonic() - began))
            final = None
            if iteration.number == training.iterations and best:
                final = final_evaluation(training, runner, best, iteration.policy)
                best = iteration.policy if final.last_is_better else best
            show(iteration, None if quiet else diagnosis.advise(iteration))
            yield iteration, rows, best, final


def _in_folder(folder: Path, steps: Generator[tuple[Iteration, Report], None, None]) -> Steps:
    """Run the iterations with all files, those that ``rkhs train`` writes."""
    from rkhs_ros.pictures.run_pictures import draw_run  # here, since the import is slow

    has_learnt = False
    try:
        with closing(steps):
            for iteration, report in steps:
                has_learnt = True
                yield iteration, report.rows, report.best_policy, report.final
    finally:
        if has_learnt and (folder / "policy.npz").is_file():  # missing if the disk is full
            draw_run(folder)
