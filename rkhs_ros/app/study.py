"""Many runs in parallel, each in its folder; finished runs are not repeated."""

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.validation import require
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.report import begin, is_started
from rkhs_ros.runs.run import run_training
from rkhs_ros.studies.workers import ALL_CORES, WorkerLostError, Workers, run_parallel

LAST_FILE, LAST_PICTURE = "policy.npz", "policy.png"  # that a run writes
KILLED = "its worker process, or another one, was killed"


def add_worker_arguments(parser: argparse.ArgumentParser, what: str = "runs") -> None:
    """Declare the options that choose the workers."""
    parser.add_argument(
        "--jobs", type=int, metavar="J", help=f"parallel {what} on this machine (default: number of cores)"
    )
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a Dask cluster instead of this machine")


def workers_of(options: argparse.Namespace) -> Workers:
    """Return the workers that the options choose.

    Raises:
        ValueError: the options conflict, or Dask is not installed.
    """
    return Workers(ALL_CORES if options.jobs is None else options.jobs, options.scheduler)


def study_folder(given: Path | None, *default: str) -> Path:
    """Return the folder of a study as an absolute path, since workers may have another working directory.

    Args:
        given: folder that the user chose, if any.
        default: path within results/ of the default folder.

    Raises:
        ValueError: the path, or a parent, is a file.
    """
    folder = (given or Path("results", *default)).resolve()
    file = next((each for each in (folder, *folder.parents) if each.exists() and not each.is_dir()), None)
    require(file is None, "--out", "a folder", f"the file {file}")
    return folder


def require_all_used(changes: Sequence[str], others: Mapping[str, Iterable[str]]) -> None:
    """Raise ValueError if --set and another option give the same setting.

    Args:
        changes: values of --set.
        others: names of the settings that each other option gives.
    """
    for change in changes:
        name = change.partition("=")[0].strip()
        for option, names in others.items():
            replaced = any(f"{name}.".startswith(f"{each}.") for each in names)
            require(not replaced, "--set", "each setting once", f"{name} in both --set and {option}")


def make_missing(
    runs: Mapping[Path, Config],
    *,
    workers: Workers,
    title: str,
    quiet: bool,
    drawn: bool = False,
    tensorboard: bool = False,
) -> dict[Path, str]:
    """Start or resume the unfinished runs; return the errors of the failed runs by folder.

    Args:
        runs: configurations by absolute folder, since workers may have another working directory.
        workers: workers that execute the runs.
        title: title of the progress bar.
        quiet: show no progress bar.
        drawn: plot each run.
        tensorboard: write TensorBoard events of each run.
    """
    how = drawn, tensorboard
    missing = [(path, each, *how) for path, each in runs.items() if not _is_done(path, each, drawn)]
    ends: dict[Path, str | None] = {}
    try:
        ends.update(run_parallel(_make, missing, workers=workers, title=title, quiet=quiet))
    except WorkerLostError:
        ends |= {path: KILLED for path, *_ in missing if path not in ends}
    return {path: why for path, why in ends.items() if why is not None}


def report_failures(failures: Mapping[Path, str]) -> None:
    """Print the failed runs and their errors to stderr."""
    for path, why in failures.items():
        print(f"error: {path.name}: {why}", file=sys.stderr)


def _is_done(folder: Path, config: Config, drawn: bool) -> bool:
    curve, last = folder / "curve.csv", folder / (LAST_PICTURE if drawn else LAST_FILE)
    finished = last.is_file() and curve.is_file() and last.stat().st_mtime_ns >= curve.stat().st_mtime_ns
    with suppress(ValueError):  # from a damaged curve, which the run writes again
        return finished and len(Curve(curve).rows()) == config.training.iterations
    return False


def _make(folder: Path, config: Config, drawn: bool, tensorboard: bool) -> tuple[Path, str | None]:
    """Start or resume a run; return its folder and its error, which is None if the run succeeded."""
    try:
        if not is_started(folder):
            folder.mkdir(parents=True, exist_ok=True)
            begin(folder, config)
        with runner_of(config.environment) as runner:
            run_training(config, runner, folder, quiet=True, resume=True, tensorboard=tensorboard)
        if drawn:
            from rkhs_ros.pictures.run_pictures import draw_run  # here, since most studies do not plot each run

            draw_run(folder)
    except Exception as error:  # one failed run must not stop the others
        return folder, " ".join(f"{type(error).__name__}: {error}".split())
    return folder, None
