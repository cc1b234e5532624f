"""Training run with its results: training loop, progress bar and files."""

import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from pathlib import Path

from rkhs_ros.base.lock import locked
from rkhs_ros.base.validation import require
from rkhs_ros.learning.diagnosis import Advice, Diagnosis, Summary
from rkhs_ros.learning.execution import discard
from rkhs_ros.learning.state import first_state
from rkhs_ros.learning.training import Iteration, train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.rollouts.final_evaluation import final_evaluation
from rkhs_ros.runs.checkpoint import Checkpoints
from rkhs_ros.runs.config import Config, Environment, load_config
from rkhs_ros.runs.curve import Row
from rkhs_ros.runs.progress import progress_bar
from rkhs_ros.runs.recorded import RecordableRunner, recorded
from rkhs_ros.runs.report import FIRST_POLICY, Report, advice_in, begin, is_started, new_folder, old_folder
from rkhs_ros.runs.tensorboard import has_events, logged

OnIteration = Callable[[Iteration, Sequence[Row]], None]  # takes an iteration and the curve so far


OnAdvice = Callable[[Advice], None]


def ignore_iteration(iteration: Iteration, rows: Sequence[Row]) -> None:
    """No-op callback."""


def ignore_row(row: Row) -> None:
    """No-op callback."""


def run_training(
    config: Config,
    runner: RecordableRunner,
    folder: Path | None,
    *,
    quiet: bool = False,
    resume: bool = False,
    tensorboard: bool = False,
    sync: bool = False,
    on_iteration: OnIteration = ignore_iteration,
    on_advice: OnAdvice | None = None,
) -> Path:
    """Train and write the results; see `training_steps`, which has the same arguments and raises the same errors.

    Args:
        config: configuration of the run.
        runner: runner of the episodes.
        folder: folder of the results, new or empty unless the run resumes; None for results/NAME/TIME.
        quiet: show no progress bar.
        resume: resume the run in the folder.
        tensorboard: write TensorBoard events.
        sync: sync each message of the recording to the disk.
        on_iteration: callback for each iteration, after its results are written.
        on_advice: callback for advice if the run does not learn; None prints it with the progress.

    Returns:
        The folder of the results.
    """
    folder = old_folder(folder) if resume else new_folder(folder, config.training.name)
    steps = training_steps(
        config,
        runner,
        folder,
        quiet=quiet,
        resume=resume,
        tensorboard=tensorboard,
        sync=sync,
        on_advice=on_advice,
    )
    with closing(steps):
        for iteration, report in steps:
            on_iteration(iteration, report.rows)
    return folder


def training_steps(
    config: Config,
    runner: RecordableRunner,
    folder: Path,
    *,
    quiet: bool = False,
    resume: bool = False,
    tensorboard: bool = False,
    sync: bool = False,
    on_advice: OnAdvice | None = None,
) -> Generator[tuple[Iteration, Report], None, None]:
    """Train, write the results, and yield each iteration after its results are written.

    After the last iteration, the best and the last policy are evaluated in fresh episodes, except on a robot.

    The results are complete, and the run can be resumed, when the generator is exhausted or closed.

    Args:
        config: configuration of the run.
        runner: runner of the episodes.
        folder: existing folder of the results.
        quiet: show no progress bar.
        resume: resume the run in the folder; with the same versions, its results are bit-identical to those of an
            uninterrupted run.
        tensorboard: write TensorBoard events; a resumed run continues existing events in any case.
        sync: sync each message of the recording to the disk, such as for a robot, whose episodes are costly.
        on_advice: callback for advice if the run does not learn; None prints it with the progress.

    Raises:
        ValueError: the folder contains a run that is not to be resumed, no run to resume or a run with other settings,
            or is used by another process; or tensorboardX is needed and not installed.
        OSError: the folder cannot be written.
    """
    tensorboard = has_events(folder, tensorboard)
    with locked(folder):
        require(resume or not is_started(folder), f"{folder}", "a new or empty folder for the results", "a run")
        checkpoints = Checkpoints(folder, config)
        found = checkpoints.newest() if resume else None
        state, rows = found or (None, [])
        if resume and state is None:
            _check_environment(folder, config.environment)
            policy = folder / "policy.npz"
            require(not policy.exists(), f"{folder / 'checkpoints'}", f"the checkpoints of {policy}", "none")
            if (folder / "curve.csv").exists():
                print(f"note: {folder}: no checkpoint to resume from; the run restarts", file=sys.stderr)
        if state:
            _check_spaces(folder, state.policy, runner.spaces)
        warm_start = _given(folder)
        if not is_started(folder):
            begin(folder, config)
        recording = recorded(config, runner, folder, found, sync=sync)
        events = logged(folder, rows) if tensorboard else nullcontext(ignore_row)
        with recording as recorder, events as log_row:
            first = recorder.state or first_state(config.training, runner.spaces, warm_start)
            if state:
                checkpoints.resume_from(state)
            report = Report(folder, config, runner.spaces, rows)  # replaces earlier results from here on
            is_robot = bool(config.environment.nodes)
            bar = progress_bar(config.training, len(rows), quiet=quiet, folder=folder, is_robot=is_robot)
            with finished(report), bar as show:
                diagnosis = _diagnosis(config, runner.spaces, report)
                for iteration in train(config.training, recorder, first):
                    recorder.updated(iteration)
                    report.add(iteration)
                    log_row(report.rows[-1])
                    checkpoints.write(iteration.state, report.rows)
                    if iteration.number == config.training.iterations and report.best_policy and not is_robot:
                        with _unrecorded(runner):
                            best = report.best_policy
                            report.decide(final_evaluation(config.training, runner, best, iteration.policy))
                    show(iteration, _advise(diagnosis.advise(iteration), report, on_advice))
                    yield iteration, report


@contextmanager
def _unrecorded(runner: RecordableRunner) -> Iterator[None]:
    """Record no episodes: both policies act in episodes of the same numbers, and no update uses them."""
    record, runner.record = runner.record, discard
    try:
        yield
    finally:
        runner.record = record


def _diagnosis(config: Config, spaces: Spaces, report: Report) -> Diagnosis:
    """Return the diagnosis of a run, which continues that of its earlier iterations."""
    earlier = [
        Summary(row.exploration_return, row.evaluation_return, row.model_return, row.model_error) for row in report.rows
    ]
    return Diagnosis(spaces, earlier, advice_in(report.folder))


def _advise(advice: Advice | None, report: Report, on_advice: OnAdvice | None) -> Advice | None:
    """Store advice and pass it to the callback; return it if there is no callback."""
    if advice is not None:
        report.advise(advice)
        if on_advice is not None:
            on_advice(advice)
    return None if on_advice is not None else advice


def _check_environment(folder: Path, environment: Environment) -> None:
    """Raise ValueError if the run in the folder has another environment, which no checkpoint may reveal."""
    began = load_config(folder / "config.yaml").environment
    expected, got = (f"{each.id} with options {dict(each.options)}" for each in (began, environment))
    require(expected == got, f"{folder}: environment", f"{expected} as at the start of the run", got)


def _check_spaces(folder: Path, policy: GaussianPolicy, spaces: Spaces) -> None:
    """Raise ValueError if the environment has other dimensions than at the start, such as an edited class."""
    n = spaces.action_dim
    sizes = (policy.mean.input_dim, policy.mean.output_dim), (policy.inputs.dimension(spaces.observation_dim, n), n)
    expected, got = (f"{d} inputs and {n} actions" for d, n in sizes)
    require(expected == got, f"{folder}: environment", f"{expected} as at the start of the run", got)


def _given(folder: Path) -> GaussianPolicy | None:
    """Return the initial policy of the run from its folder, if there is one."""
    file = folder / FIRST_POLICY
    return load_policy(file)[0] if file.exists() else None


@contextmanager
def finished(report: Report) -> Iterator[None]:
    """Write the results at the end, even after an interruption."""
    try:
        yield
    except BaseException:
        with suppress(Exception):  # report the first error only
            report.finish()
        raise
    report.finish()
