"""Many runs in parallel, each in its folder: several seeds or settings; finished runs are not repeated."""

import argparse
import re
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.validation import require
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.report import begin, is_started
from rkhs_ros.runs.run import run_training
from rkhs_ros.studies.workers import WorkerLostError, run_parallel

SEEDS, MOST_SEEDS = re.compile(r"(\d{1,9})(?:-(\d{1,9}))?", re.ASCII), 10_000
ADDRESS = re.compile(r"\w+://\S+:\d{1,5}", re.ASCII)  # of a Dask scheduler
PREFIX = "seed_"  # of the folder names
LAST_FILE, LAST_PICTURE = "policy.npz", "policy.png"  # that a run writes
KILLED = "its worker process, or another one, was killed"


def add_jobs_argument(parser: argparse.ArgumentParser, what: str = "runs") -> None:
    """Declare the option that chooses the number of worker processes, or a cluster."""
    about = f"parallel {what} (default: number of cores), or the address of a Dask scheduler, such as tcp://HOST:8786"
    parser.add_argument("--jobs", type=_jobs, metavar="J", help=about)


def _jobs(text: str) -> int | str:
    if ADDRESS.fullmatch(text):
        return text
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected at least 1, or tcp://HOST:PORT, got {text}")
    return int(text)


def parse_seeds(text: str) -> tuple[int, ...]:
    """Return the seeds of a text such as "0-9", "0,2,5" or "0-3,7", in ascending order."""
    seeds: list[int] = []
    for part in map(str.strip, text.split(",")):
        match = SEEDS.fullmatch(part)
        if match is None:
            raise ValueError(f"--seeds: expected seeds such as 0-9 or 0,2,5, got '{part}'")
        first, last = int(match[1]), int(match[2] or match[1])
        require(first <= last, "--seeds", "ascending ranges", part)
        require(last - first < MOST_SEEDS, "--seeds", f"at most {MOST_SEEDS} seeds", part)
        seeds += range(first, last + 1)
    require(len(set(seeds)) == len(seeds), "--seeds", "each seed once", text)
    return tuple(sorted(seeds))


def seed_folders(folder: Path) -> list[Path]:
    """Return the absolute folders of the started runs of several seeds, in the order of the seeds."""
    found = [path for path in folder.resolve().glob(f"{PREFIX}*") if is_started(path)]
    return sorted(found, key=lambda path: (len(path.name), path.name))


def make_missing(
    runs: Mapping[Path, Config],
    *,
    jobs: int | str | None,
    title: str,
    quiet: bool,
    drawn: bool = False,
    tensorboard: bool = False,
) -> dict[Path, str]:
    """Start or resume the unfinished runs, see `run_parallel`; return the errors of the failed runs by folder.

    The folders are absolute, since workers may have another working directory. With `drawn`, plot each run; with
    `tensorboard`, write its events.
    """
    missing = [(path, each, drawn, tensorboard) for path, each in runs.items() if not _is_done(path, each, drawn)]
    ends: dict[Path, str | None] = {}
    try:
        ends.update(run_parallel(_make, missing, jobs=jobs, title=title, quiet=quiet))
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
