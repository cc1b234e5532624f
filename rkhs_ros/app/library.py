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
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

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
from rkhs_ros.rollouts.environments import Source
from rkhs_ros.rollouts.evaluation import FinalEvaluation, final_evaluation
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.model_env import LearntModel
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.checkpoint import Checkpoint, read_checkpoint, start_from
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.curve import columns, has_events
from rkhs_ros.runs.progress import progress_bar
from rkhs_ros.runs.report import is_started, new_folder
from rkhs_ros.runs.run import training_steps

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER_SETTINGS: Mapping[str, Any] = {"out": None, "resume": False, "tensorboard": False}


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
            True or None continues it.
        **settings: keywords of `LearnSettings`, such as ``iterations``, ``seed``, ``kernel``, ``model`` and ``out``.

    Returns:
        The result after the last iteration.

    Raises:
        ValueError: a setting is unknown or invalid, the environment cannot be used, the folder ``out`` is in use or
            contains another run, or the callback returns something else.
        RunError: the environment failed.
        OSError: the folder ``out`` cannot be written.
    """
    require(callback is None or callable(callback), "callback", "a function of a Result", callback)
    with closing(_results(_prepared(environment, algorithm, settings), quiet=not progress)) as results:
        for result in results:  # the last one is returned
            if callback and not _continues(callback, callback(result)):
                break
    if progress and result.iteration.number < result.training.iterations:
        print(f"stopped by the callback after iteration {result.iteration.number}", file=sys.stderr, flush=True)
    return result


def _continues(callback: Callback, answer: object) -> bool:
    """Return whether a callback's answer continues the run.

    Raises:
        ValueError: the answer is not True, False or None.
    """
    name, valid = getattr(callback, "__name__", type(callback).__name__), isinstance(answer, bool | np.bool_ | None)
    require(valid, f"callback {name}", "True or None to continue, or False to stop", repr(answer))
    return answer is None or bool(answer)


def learn(
    environment: Source, algorithm: Algorithm | str | None = None, **settings: Unpack[LearnSettings]
) -> Generator[Result, None, None]:
    """Train a policy and yield the result of each iteration, for loops of your own and early stopping.

    Args:
        environment: as for `train`.
        algorithm: as for `train`.
        **settings: keywords of `LearnSettings`, such as ``iterations``, ``seed``, ``kernel``, ``model`` and ``out``.

    Raises:
        ValueError: a setting is unknown or invalid, the environment cannot be used, or the folder ``out`` is in use or
            contains another run.
        RunError: the environment failed.
        OSError: the folder ``out`` cannot be written.
    """
    return _results(_prepared(environment, algorithm, settings), quiet=True)


class _Prepared(NamedTuple):
    """A run that is ready to start.

    Attributes:
        config: its configuration.
        runner: runner of its episodes.
        first: state of a new run.
        first_policy: its initial policy, if one was given.
        out: folder of its files; None for a run without files.
        resume: whether to resume the run in the folder, if there is one.
        tensorboard: whether to write TensorBoard events.
    """

    config: Config
    runner: InlineRunner
    first: State
    first_policy: Policy | None
    out: Path | None
    resume: bool
    tensorboard: bool


def _prepared(environment: Source, algorithm: Algorithm | str | None, settings: Mapping[str, Any]) -> _Prepared:
    """Check the settings of a run and create its folder."""
    _check_order(environment)
    given = dict(settings)
    start, options, num_envs = given.pop("policy", None), given.pop("options", None), given.pop("num_envs", 0)
    out, resume, tensorboard = _folder_settings(given)
    simulation = Simulation(environment, options, num_envs)
    with ExitStack() as undo:
        undo.callback(simulation.close)
        warm_start = load(start) if isinstance(start, str | Path) else start
        good = warm_start is None or isinstance(warm_start, Policy)
        require(good, "policy", "a Policy or a policy file", warm_start)
        training = training_in(simulation, algorithm, given)
        config = Config(Environment(simulation.environment, simulation.options, num_envs), training)
        first = first_state(training, simulation.spaces, warm_start.gaussian if warm_start else None)
        if out:
            _made_folder(out, config, warm_start, resume=resume)
        undo.pop_all()
    if "horizon" not in given:
        warn_of_horizon(simulation, training.horizon, given=False)
    return _Prepared(config, InlineRunner(simulation), first, warm_start, out, resume, tensorboard)


def _folder_settings(given: dict[str, Any]) -> tuple[Path | None, bool, bool]:
    """Remove the settings of the folder from the given ones.

    Returns:
        The folder, whether to resume, and whether to write TensorBoard events.

    Raises:
        ValueError: a setting is invalid or needs a folder, or tensorboardX is needed and not installed.
    """
    out, *switches = (given.pop(name, unset) for name, unset in FOLDER_SETTINGS.items())
    require(out is None or isinstance(out, str | Path), "out", "a folder", out)
    for name, value in zip(("resume", "tensorboard"), switches, strict=True):
        require(isinstance(value, bool), name, "True or False", value)
        require(out is not None or not value, name, "out=FOLDER as well", "none")
    resume, tensorboard = switches
    has_events(None, tensorboard)
    return None if out is None else Path(out), resume, tensorboard


def _made_folder(out: Path, config: Config, first_policy: Policy | None, *, resume: bool) -> bool:
    """Create the folder of a new run with its initial policy; return whether it contains a run to resume instead.

    Raises:
        ValueError: the folder is in use, or config.yaml cannot store a setting.
        OSError: the folder cannot be written.
    """
    kernel, options = config.training.kernel, config.environment.options
    expected = "a text or a KernelChoice, such as KernelChoice(bandwidth=0.5), which out= can store in config.yaml"
    require(type(kernel) is KernelChoice, "kernel", expected, getattr(kernel, "kernel", kernel))
    require(_is_storable(options), "options", "values that out= can store in config.yaml", dict(options))
    if is_started(out):
        require(resume, f"{out}", "a new or empty folder, or resume=True to continue the run in it", "a run")
        same = first_policy is None or _began_with(read_checkpoint(out, config), first_policy)
        require(same, "policy", f"the initial policy of the run in {out}, or none, since it is resumed", "another one")
        return True
    new_folder(out, config.training.name)
    start_from(out, config, first_policy.gaussian if first_policy else None)
    return False


def _began_with(found: Checkpoint | None, policy: Policy) -> bool:
    """Return whether a policy is the initial policy of the run of a checkpoint."""
    if found is None or found.given is None:
        return False
    own, given = found.given.mean, policy.gaussian.mean
    return np.array_equal(own.centres, given.centres) and np.array_equal(own.weights, given.weights)


def _is_storable(options: Mapping[str, Any]) -> bool:
    try:
        dumped(dict(options))
        json.dumps(dict(options))  # in policies and checkpoints
    except (YAMLError, TypeError, ValueError):
        return False
    return True


def _check_order(environment: object) -> None:
    """Raise ValueError if the algorithm is passed as the environment."""
    kind = environment if isinstance(environment, type) else type(environment)
    if isinstance(environment, str) and environment in ALGORITHMS:
        kind = ALGORITHMS[environment]
    hint = f"the algorithm {kind.__name__}. Pass the environment first: train(environment, {kind.__name__}())"
    expected = "an id, an environment, or a function that returns one"
    require(not issubclass(kind, Algorithm), "environment", expected, hint)


def _results(run: _Prepared, *, quiet: bool) -> Generator[Result, None, None]:
    """Run the iterations and yield the results."""
    acting = partial(Policy, task=run.config.task, spaces=run.runner.spaces)
    with run.runner, closing(_in_folder(run, run.out, quiet) if run.out else _in_memory(run, quiet)) as steps:
        for iteration, rows, best, final in steps:
            policy, best_policy = acting(iteration.policy), acting(best) if best else None
            yield Result(policy, best_policy, iteration, tuple(rows), run.config.training, final)


# Iterations with the curve so far, the best policy so far and, after the last one, the final evaluation.
Steps = Generator[tuple[Iteration, list[Row], GaussianPolicy | None, FinalEvaluation | None], None, None]


def _in_memory(run: _Prepared, quiet: bool) -> Steps:
    """Run the iterations without files."""
    training, runner, began = run.config.training, run.runner, time.monotonic()
    highest, best, rows = float("-inf"), None, list[Row]()
    diagnosis = Diagnosis(runner.spaces)
    with progress_bar(training, quiet=quiet) as show:
        for iteration in iterations_of(training, runner, run.first):
            if iteration.evaluation_bound > highest:
                highest, best = iteration.evaluation_bound, iteration.policy
            rows.append(iteration.row(time.monotonic() - began))
            final = None
            if iteration.number == training.iterations and best:
                final = final_evaluation(training, runner, best, iteration.policy)
                best = iteration.policy if final.last_is_better else best
            show(iteration, None if quiet else diagnosis.advise(iteration))
            yield iteration, rows, best, final


def _in_folder(run: _Prepared, out: Path, quiet: bool) -> Steps:
    """Run the iterations with all files, those that ``rkhs train`` writes."""
    from rkhs_ros.pictures.run_pictures import draw_run  # here, since the import is slow

    resume = _made_folder(out, run.config, run.first_policy, resume=run.resume)  # again: another run may have begun
    steps = training_steps(run.config, run.runner, out, quiet=quiet, resume=resume, tensorboard=run.tensorboard)
    has_learnt = False
    try:
        with closing(steps):
            for iteration, report in steps:
                has_learnt = True
                yield iteration, report.rows, report.best_policy, report.final
    finally:
        if has_learnt and (out / "policy.npz").is_file():  # missing if the disk is full
            draw_run(out)
