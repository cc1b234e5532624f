"""Runs of one configuration with several seeds, each with an ordinary run folder, in parallel."""

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from rkhs_ros.base.validation import require
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.runs.checkpoint import start_from
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.report import begin, is_started

SEEDS = re.compile(r"(\d{1,18})(?:-(\d{1,18}))?", re.ASCII)
MOST_SEEDS = 10_000
PREFIX = "seed_"  # of the folder names


def parse_seeds(text: str) -> tuple[int, ...]:
    """Return the distinct seeds of a text such as "0-9", "0,2,5" or "0-3,7", in ascending order.

    Raises:
        ValueError: the text is not a list of numbers and ranges, a range is descending, or there are too many seeds.
    """
    seeds: set[int] = set()
    for part in text.split(","):
        match = SEEDS.fullmatch(part.strip())
        if match is None:
            raise ValueError(f"--seeds: expected seeds such as 0-9 or 0,2,5, got '{part.strip()}'")
        first, last = int(match[1]), int(match[2] or match[1])
        require(first <= last, "--seeds", "ascending ranges", part)
        require(len(seeds) + last - first < MOST_SEEDS, "--seeds", f"at most {MOST_SEEDS} seeds", f"more in '{part}'")
        seeds.update(range(first, last + 1))
    return tuple(sorted(seeds))


def seed_folders(folder: Path) -> list[Path]:
    """Return the absolute folders of the started runs of several seeds, in the order of the seeds."""
    found = [path for path in folder.resolve().glob(f"{PREFIX}*") if is_started(path)]
    return sorted(found, key=lambda path: (len(path.name), path.name))


def begin_seeds(
    folder: Path, config: Config, seeds: Iterable[int], first_policy: Path | None = None
) -> dict[Path, Config]:
    """Start a run for each seed, so that each can be resumed; return the configurations by absolute folder.

    Args:
        folder: parent of the folders of the runs.
        config: configuration of the runs, except for the seed.
        seeds: seeds of the runs.
        first_policy: file of the initial policy of all runs.

    Raises:
        OSError: a folder cannot be written.
    """
    trainings = {seed: replace(config.training, seed=seed) for seed in seeds}
    runs = {folder.resolve() / f"{PREFIX}{seed}": replace(config, training=t) for seed, t in trainings.items()}
    for path, each in runs.items():
        path.mkdir()
        start_from(path, each, load_policy(first_policy)[0] if first_policy else None)
        begin(path, each)
    return runs
