"""Many runs made side by side, each in its folder; those that are there whole are not made again."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.validation import require
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.report import begin, is_begun
from rkhs_ros.runs.run import run_training
from rkhs_ros.studies.parallel import run_parallel
from rkhs_ros.studies.workers import ALL_CORES, WorkerLostError, Workers

LAST_FILE, LAST_PICTURE = "episodes.npz", "policy.png"  # that a run leaves
KILLED = "its process was killed, or one beside it"


def add_worker_arguments(parser: argparse.ArgumentParser, what: str = "runs") -> None:
    """Declare where the runs are made."""
    parser.add_argument("--jobs", type=int, metavar="J", help=f"{what} side by side on this machine (all cores)")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a Dask cluster, in place of this machine")
    parser.add_argument("--ray", metavar="ADDRESS", help="a Ray cluster, in place of this machine")


def workers_of(options: argparse.Namespace) -> Workers:
    """Return who makes the runs.

    Raises:
        ValueError: the options do not go together, or a library is not installed.
    """
    return Workers(ALL_CORES if options.jobs is None else options.jobs, options.scheduler, options.ray)


def study_folder(given: Path | None, *default: str) -> Path:
    """Return the folder of a study, as an absolute path: who makes its runs may be in another folder.

    Args:
        given: by the user.
        default: its place in results/ where none is.

    Raises:
        ValueError: there is a file in its place.
    """
    folder = (given or Path("results", *default)).resolve()
    file = next((each for each in (folder, *folder.parents) if each.exists() and not each.is_dir()), None)
    require(file is None, "--out", "a folder", f"the file {file}")
    return folder


def require_all_used(changes: Sequence[str], others: Mapping[str, Iterable[str]]) -> None:
    """Raise ValueError where another option replaces what --set says.

    Args:
        changes: of --set.
        others: by the options' names the settings that they say.
    """
    for change in changes:
        name = change.partition("=")[0].strip()
        for option, names in others.items():
            replaced = any(f"{name}.".startswith(f"{each}.") for each in names)
            require(not replaced, "--set", f"no setting that {option} says", name)


def make_missing(
    runs: Mapping[Path, Config],
    *,
    workers: Workers,
    title: str,
    quiet: bool,
    drawn: bool = False,
    record: bool = False,
    provenance_may_change: bool = False,
) -> dict[Path, str]:
    """Make what is missing of some runs and return, by the folders of those that failed, why they did.

    Args:
        runs: by their folders, as absolute paths, for those who make them may be in another one.
        workers: who make them.
        title: of the progress bar.
        quiet: without progress bar.
        drawn: with pictures of each.
        record: with a recording of each.
        provenance_may_change: go on with those of other code, libraries or threads.
    """
    how = drawn, record, provenance_may_change
    missing = [(path, each, *how) for path, each in runs.items() if not _is_done(path, each, drawn)]
    ends: dict[Path, str | None] = {}
    try:
        ends.update(run_parallel(_make, missing, workers=workers, title=title, quiet=quiet))
    except WorkerLostError:
        ends |= {path: KILLED for path, *_ in missing if path not in ends}
    return {path: why for path, why in ends.items() if why is not None}


def report_failures(failures: Mapping[Path, str]) -> None:
    """Name the runs that failed on stderr."""
    for path, why in failures.items():
        print(f"error: {path.name}: {why}", file=sys.stderr)


def _is_done(folder: Path, config: Config, drawn: bool) -> bool:
    curve, last = folder / "curve.csv", folder / (LAST_PICTURE if drawn else LAST_FILE)
    finished = last.is_file() and curve.is_file() and last.stat().st_mtime_ns >= curve.stat().st_mtime_ns
    with suppress(ValueError):  # a damaged curve: the run cannot be resumed
        return finished and len(Curve(curve).rows()) == config.training.iterations
    return False


def _make(
    folder: Path, config: Config, drawn: bool, record: bool, provenance_may_change: bool
) -> tuple[Path, str | None]:
    """Begin a run or go on with it; return why that failed, None where it did not."""
    try:
        advance(folder, config, record=record, provenance_may_change=provenance_may_change)
        if drawn:
            from rkhs_ros.pictures.run_pictures import draw_run  # here, for most studies need no pictures of each run

            draw_run(folder)
    except Exception as error:  # of one run, which shall not end the others
        return folder, " ".join(f"{type(error).__name__}: {error}".split())
    return folder, None


def advance(folder: Path, config: Config, *, record: bool = False, provenance_may_change: bool = False) -> None:
    """Begin a run in this process, or go on with it, until it has made its iterations; as `run_training`."""
    if not is_begun(folder):
        folder.mkdir(parents=True, exist_ok=True)
        begin(folder, config)
    with runner_of(config.environment) as runner:
        run_training(
            config, runner, folder, quiet=True, resume=True, record=record, provenance_may_change=provenance_may_change
        )
