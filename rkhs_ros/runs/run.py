"""Training run with its results: training loop, progress bar and files."""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import locked
from rkhs_ros.base.validation import require
from rkhs_ros.learning.diagnosis import Advice, Diagnosis, Summary
from rkhs_ros.learning.episodes import discard
from rkhs_ros.learning.iteration import Iteration, Row
from rkhs_ros.learning.state import first_state
from rkhs_ros.learning.training import train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rollouts.evaluation import final_evaluation
from rkhs_ros.runs.checkpoint import FILE, REMEDY, Checkpoint, Checkpoints, read_checkpoint, write_checkpoint
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import has_events, logged
from rkhs_ros.runs.progress import progress_bar
from rkhs_ros.runs.recorded import RecordableRunner, recorded
from rkhs_ros.runs.report import Report, advice_in, begin, is_started, new_folder, old_folder

OnIteration = Callable[[Iteration, Sequence[Row]], None]  # takes an iteration and the curve so far
OnAdvice = Callable[[Advice], None]


def run_training(
    config: Config,
    runner: RecordableRunner,
    folder: Path | None,
    *,
    resume: bool = False,
    on_iteration: OnIteration = lambda iteration, rows: None,
    **options: Any,
) -> Path:
    """Train and write the results.

    Args:
        config: configuration of the run.
        runner: runner of the episodes.
        folder: folder of the results, new or empty unless the run resumes; None for results/NAME/TIME.
        resume: resume the run in the folder.
        on_iteration: callback for each iteration, after its results are written.
        options: further options of `training_steps`, which raises the same errors.

    Returns:
        The folder of the results.
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
        found = read_checkpoint(folder, config)  # a new run has one if its initial policy was given
        if found is None:
            results = [name for name in ("curve.csv", "policy.npz") if (folder / name).exists()]
            require(not results, f"{folder / FILE}", f"the checkpoint of {', '.join(results)}", f"none. {REMEDY}")
        elif found.rows:
            _check_spaces(folder, found.state.policy, runner.spaces)
        if not is_started(folder):
            begin(folder, config)
        checkpoints = Checkpoints(folder, config)
        rows, best, given = found[1:] if found else ((), None, None)
        events = logged(folder, rows) if tensorboard else nullcontext(lambda row: None)
        with recorded(config, runner, folder, found, sync=sync) as recorder, events as log_row:
            first = recorder.state
            if first is None:
                first = first_state(config.training, runner.spaces, given)
                if found is None:
                    write_checkpoint(folder, config, Checkpoint(first))
            report = Report(folder, config, runner.spaces, rows, best)  # replaces earlier results from here on
            is_robot = bool(config.environment.nodes)
            bar = progress_bar(config.training, len(rows), quiet=quiet, folder=folder, is_robot=is_robot)
            with finished(report, checkpoints), bar as show:
                earlier = [
                    Summary(row.exploration_return, row.evaluation_return, row.model_return, row.model_error)
                    for row in report.rows
                ]
                diagnosis = Diagnosis(runner.spaces, earlier, advice_in(folder))
                for iteration in train(config.training, recorder, first):
                    recorder.updated(iteration)
                    report.add(iteration)
                    log_row(report.rows[-1])
                    if iteration.number < config.training.iterations:  # a resume repeats the last one, for its result
                        made = Checkpoint(iteration.state, tuple(report.rows), report.best_policy, given)
                        checkpoints.add(made)
                    elif report.best_policy and not is_robot:
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


def _check_spaces(folder: Path, policy: GaussianPolicy, spaces: Spaces) -> None:
    """Raise ValueError if the environment has other dimensions than at the start, such as an edited class."""
    n = spaces.action_dim
    sizes = (policy.mean.input_dim, policy.mean.output_dim), (policy.inputs.dimension(spaces.observation_dim, n), n)
    expected, got = (f"{d} inputs and {n} actions" for d, n in sizes)
    require(expected == got, f"{folder}: environment", f"{expected} as at the start of the run", got)


@contextmanager
def finished(report: Report, checkpoints: Checkpoints | None = None) -> Iterator[None]:
    """Write the results and, if there is one, the checkpoint at the end, even after an interruption."""
    ends = [*([checkpoints.close] if checkpoints else []), report.finish]
    try:
        yield
    except BaseException as error:
        for end in ends:
            with suppress(Exception):  # report the first error only
                end()
        if isinstance(error, FileNotFoundError) and not report.folder.is_dir():
            raise RunError(f"{report.folder}: the folder was removed during the run") from error
        raise
    for end in ends:
        end()
