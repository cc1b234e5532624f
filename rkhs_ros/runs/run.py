"""A whole run with its results: the training loop, the progress bar, and the files it leaves."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from rkhs_ros.base.lock import locked
from rkhs_ros.base.threads import use_one_thread
from rkhs_ros.base.validation import require
from rkhs_ros.learning.state import first_state
from rkhs_ros.learning.training import Iteration, train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.recordings.recording import FILE
from rkhs_ros.runs.checkpoint import REMEDY, WHOLE, Checkpoints
from rkhs_ros.runs.config import Config, Environment, load_config
from rkhs_ros.runs.control import Control, Rest
from rkhs_ros.runs.curve import Curve, Row
from rkhs_ros.runs.progress import progress_bar
from rkhs_ros.runs.report import FIRST_POLICY, Report, begin, is_begun, new_folder, old_folder

if TYPE_CHECKING:
    from rkhs_ros.runs.recorded import RecordableRunner, RecordingRunner

RECORDED = "the recording that this run began with (put it back, or start another one with --record)"
OnIteration = Callable[[Iteration, Sequence[Row]], None]  # is told of each iteration, with the last lines of the curve


def ignore_iteration(iteration: Iteration, rows: Sequence[Row]) -> None:
    """Look at nothing: what those do who do not look on."""


def run_training(
    config: Config,
    runner: RecordableRunner,
    folder: Path | None,
    *,
    quiet: bool = False,
    resume: bool = False,
    record: bool = False,
    sync: bool = False,
    provenance_may_change: bool = False,
    rest: Rest = time.sleep,
    on_iteration: OnIteration = ignore_iteration,
) -> Path:
    """Train and write the results.

    Args:
        config: the run.
        runner: who lets the policies act.
        folder: where the results go; results/NAME/TIME where None.
        quiet: without progress bar.
        resume: go on with the run in the folder; what it leaves has the same bits as that of a run never stopped.
        record: write recording.mcap; a run that goes on and has one goes on with it in any case.
        sync: wait until the disk has each record, as for a robot, whose episodes cost.
        provenance_may_change: go on with a run of other code, libraries or threads, which is noted in config.yaml.
        rest: waits for some seconds, while the run pauses.
        on_iteration: is told of each iteration once it is written.

    Returns:
        The folder of the results.

    Raises:
        ValueError: the folder holds something already, or no run to go on with, or one that another process is
            in, or one that began with other settings.
        OSError: the folder cannot be written.
        KeyboardInterrupt: the run was asked to stop.
    """
    folder = old_folder(folder) if resume else new_folder(folder, config.training.name)
    with locked(folder):
        use_one_thread()
        checkpoints = Checkpoints(folder, config, provenance_may_change=provenance_may_change)
        curve = Curve(folder / "curve.csv")
        lines, iterations = len(curve.rows()), config.training.iterations
        require(lines <= iterations, "iterations", f"at least {lines}, which the run has made", iterations)
        state = checkpoints.newest(lines) if resume else None
        if resume and state is None:
            _check_environment(folder, config.environment)
            if lines > 1:  # a kill may come between the first line and the first checkpoint
                raise ValueError(f"{folder / 'checkpoints'}: {WHOLE}, got none. {REMEDY}")
            if curve.path.exists():
                print(f"note: {folder}: no checkpoint to go on from: the run begins again", file=sys.stderr)
        done = state.iterations if state else 0
        first = state or first_state(config.training, runner.spaces, _given(folder))
        control = Control(folder, rest)
        record |= os.path.lexists(folder / FILE)  # also a pipe or a broken link, which is then refused
        require(record or not checkpoints.recorded, f"{folder / FILE}", RECORDED, "none")
        checkpoints.recorded = record
        if not is_begun(folder):
            begin(folder, config)
        how = {"sync": sync, "provenance_may_change": provenance_may_change}
        with _recording(config, runner, folder, **how) if record else nullcontext() as recorder:
            if state:
                checkpoints.go_on_from(state)
            report = Report(folder, config, runner.spaces, done)  # from here on what was there before is replaced
            with finished(report), progress_bar(config.training, done, quiet=quiet, folder=folder) as show:
                for iteration in train(config.training, recorder or runner, first):
                    if recorder:
                        recorder.updated(iteration)
                    report.add(iteration)  # before the checkpoint, which is of no use without its line
                    checkpoints.write(iteration.state)
                    show(iteration)
                    on_iteration(iteration, report.recent)
                    control.obey()
        control.clear()
    return folder


def _recording(
    config: Config, runner: RecordableRunner, folder: Path, **how: bool
) -> AbstractContextManager[RecordingRunner]:
    from rkhs_ros.runs.recorded import recorded  # here, since only recordings need mcap

    return recorded(config, runner, folder, **how)


def _check_environment(folder: Path, environment: Environment) -> None:
    """Raise ValueError where the run in the folder began in another environment, as no checkpoint may tell."""
    began = load_config(folder / "config.yaml").environment
    expected, got = (f"{each.id} with options {dict(each.options)}" for each in (began, environment))
    require(expected == got, f"{folder}: environment", f"{expected}, in which the run began", got)


def _given(folder: Path) -> GaussianPolicy | None:
    """Return the policy that the run is to begin from, if one was put into its folder."""
    file = folder / FIRST_POLICY
    return load_policy(file)[0] if file.exists() else None


@contextmanager
def finished(report: Report) -> Iterator[None]:
    """Write what was learnt, after an interruption too."""
    try:
        yield
    except BaseException:
        with suppress(Exception):  # the first error is the one to tell of
            report.finish()
        raise
    report.finish()
