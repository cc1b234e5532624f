"""Training run with its results: training loop, progress bar and files."""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import locked
from rkhs_ros.base.validation import require
from rkhs_ros.learning.diagnosis import Diagnosis
from rkhs_ros.learning.episodes import discard
from rkhs_ros.learning.iteration import Iteration, Row
from rkhs_ros.learning.training import train
from rkhs_ros.rollouts.evaluation import final_evaluation
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import has_events, logged
from rkhs_ros.runs.progress import progress_bar
from rkhs_ros.runs.recorded import RecordableRunner, recorded
from rkhs_ros.runs.report import Report, advice_in, begin, is_started, new_folder, old_folder

OnIteration = Callable[[Iteration, Sequence[Row]], None]  # takes an iteration and the curve so far
OnAdvice = Callable[[str], None]


def run_training(
    config: Config,
    runner: RecordableRunner,
    folder: Path | None,
    *,
    resume: bool = False,
    on_iteration: OnIteration = lambda iteration, rows: None,
    **options: Any,
) -> Path:
    """Train and write the results; return their folder.

    The folder is new or empty unless the run resumes, and None stands for results/NAME/TIME. Each iteration is passed
    to the callback after its results are written. Further options are those of `training_steps`, which raises the same
    errors.
    """
    folder = old_folder(folder) if resume else new_folder(folder, config.training.name)
    with closing(training_steps(config, runner, folder, resume=resume, **options)) as steps:
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
    is_robot: bool = False,
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
        is_robot: whether episodes are costly, so that each is synced to the disk, and there is no final evaluation.
        on_advice: callback for advice if the run does not learn; None prints it with the progress.

    Raises:
        ValueError: the folder contains a run that is not to be resumed, no run to resume or a run with other settings,
            or is used by another process; or tensorboardX is needed and not installed.
    """
    tensorboard = has_events(folder, tensorboard)
    with locked(folder):
        require(resume or not is_started(folder), f"{folder}", "a new or empty folder for the results", "a run")
        if not is_started(folder):
            begin(folder, config)
        with recorded(config, runner, folder, is_robot=is_robot) as (recorder, state, rows, policies, earlier):
            events = logged(folder, rows) if tensorboard else nullcontext(lambda row: None)
            report = Report(folder, config, runner.spaces, rows, policies)  # replaces earlier results from here on
            bar = progress_bar(config.training, len(rows), quiet=quiet, folder=folder)
            with finished(report), events as log_row, bar as show:
                diagnosis = Diagnosis(runner.spaces, earlier, advice_in(folder))
                for iteration in train(config.training, recorder, state):
                    recorder.updated(iteration)
                    report.add(iteration)
                    log_row(report.rows[-1])
                    if iteration.number == config.training.iterations and report.best_policy and not is_robot:
                        with _unrecorded(runner):
                            best = report.best_policy
                            report.decide(final_evaluation(config.training, runner, best, iteration.policy))
                    advice = diagnosis.advise(iteration)
                    if advice is not None:
                        report.advise(advice)
                        if on_advice is not None:
                            on_advice(advice)
                    show(iteration, advice if on_advice is None else None)
                    yield iteration, report


@contextmanager
def _unrecorded(runner: RecordableRunner) -> Iterator[None]:
    """Record no episodes: both policies act in episodes of the same numbers, and no update uses them."""
    record, runner.record = runner.record, discard
    try:
        yield
    finally:
        runner.record = record


@contextmanager
def finished(report: Report) -> Iterator[None]:
    """Write the results at the end, even after an interruption."""
    try:
        yield
    except BaseException as error:
        with suppress(Exception):  # report the first error only
            report.finish()
        if isinstance(error, FileNotFoundError) and not report.folder.is_dir():
            raise RunError(f"{report.folder}: the folder was removed during the run") from error
        raise
    report.finish()
