"""One configuration learnt from several seeds: an ordinary run's folder for each of them, made side by side."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from joblib.externals.loky.process_executor import BrokenProcessPool

from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.report import FIRST_POLICY, is_begun, resolved
from rkhs_ros.runs.run import run_training
from rkhs_ros.runs.side_by_side import side_by_side

SEEDS = re.compile(r"(\d{1,18})(?:-(\d{1,18}))?", re.ASCII)
MOST_SEEDS = 10_000
PREFIX = "seed_"  # of the runs' folders
LAST_PICTURE = "policy.png"
KILLED = "its process was killed, or one beside it"


def parse_seeds(text: str) -> tuple[int, ...]:
    """Return the seeds that are meant by "0-9", "0,2,5" or "0-3,7", each once and in order.

    Raises:
        ValueError: the text is of another form, a range runs backwards, or there are too many.
    """
    seeds: set[int] = set()
    for part in text.split(","):
        match = SEEDS.fullmatch(part.strip())
        if match is None:
            raise ValueError(f"--seeds: expected seeds as 0-9 or 0,2,5, got '{part.strip()}'")
        first, last = int(match[1]), int(match[2] or match[1])
        require(first <= last, "--seeds", "ranges from a smaller seed to a greater one", part)
        require(len(seeds) + last - first < MOST_SEEDS, "--seeds", f"at most {MOST_SEEDS} seeds", f"more in '{part}'")
        seeds.update(range(first, last + 1))
    return tuple(sorted(seeds))


def seed_folders(folder: Path) -> list[Path]:
    """Return the folders of the runs that were begun from several seeds, in the order of these, as absolute paths."""
    found = [path for path in folder.resolve().glob(f"{PREFIX}*") if is_begun(path)]
    return sorted(found, key=lambda path: (len(path.name), path.name))


def begin_seeds(
    folder: Path, config: Config, seeds: Iterable[int], first_policy: Path | None = None
) -> dict[Path, Config]:
    """Begin a run for each seed, so that all can be gone on with, and return them by their absolute folders.

    Args:
        folder: for the runs' folders.
        config: the run, whose seed is replaced.
        seeds: of the runs.
        first_policy: the file of a policy that all begin from.

    Raises:
        OSError: a folder cannot be written.
    """
    trainings = {seed: replace(config.training, seed=seed) for seed in seeds}
    runs = {folder.resolve() / f"{PREFIX}{seed}": replace(config, training=t) for seed, t in trainings.items()}
    for path, each in runs.items():
        path.mkdir()
        if first_policy is not None:
            write_whole(path / FIRST_POLICY, first_policy.read_bytes())
        write_whole(path / "config.yaml", resolved(each).encode())
    return runs


def go_on(runs: Mapping[Path, Config], *, jobs: int, title: str, quiet: bool, record: bool = False) -> dict[Path, str]:
    """Make what is missing of some runs and return, by the folders of those that failed, why they did."""
    missing = {folder: config for folder, config in runs.items() if not _is_done(folder, config)}
    ends: dict[Path, str | None] = {}
    try:
        ends.update(
            side_by_side(partial(_make, record=record), list(missing.items()), jobs=jobs, title=title, quiet=quiet)
        )
    except BrokenProcessPool:  # all that had not ended share the fate of the one that was killed
        ends |= {folder: KILLED for folder in missing if folder not in ends}
    return {folder: why for folder, why in ends.items() if why is not None}


def _is_done(folder: Path, config: Config) -> bool:
    curve, last = folder / "curve.csv", folder / LAST_PICTURE
    drawn = last.is_file() and curve.is_file() and last.stat().st_mtime_ns >= curve.stat().st_mtime_ns
    return drawn and len(Curve(curve).rows()) == config.training.iterations


def _make(folder: Path, config: Config, *, record: bool) -> tuple[Path, str | None]:
    """Go on with a run and draw its pictures; return why that failed, None where it did not."""
    try:
        run_training(config, runner_of(config.environment), folder, quiet=True, resume=True, record=record)
        draw_run(folder)
    except Exception as error:  # of one seed, which shall not end the others
        return folder, " ".join(f"{type(error).__name__}: {error}".split())
    return folder, None
