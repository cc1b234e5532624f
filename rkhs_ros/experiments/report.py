"""What a run leaves in its folder: configuration, learning curve, policy and pictures."""

from __future__ import annotations

import csv
import platform
import time
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from rkhs_ros.experiments.config import Config
from rkhs_ros.experiments.pictures import draw_curve, draw_policy
from rkhs_ros.experiments.training import Iteration
from rkhs_ros.policies.storage import save_policy


class Row(NamedTuple):
    """One line of curve.csv."""

    iteration: int
    episodes: int
    train_return: float
    train_return_sd: float
    mean_policy_return: float
    centres: int
    step_size: float
    kl: float
    sparsification_error: float
    seconds: float


def new_folder(folder: Path | None, name: str) -> Path:
    """Make the folder of a run, results/NAME/TIME where None is given.

    Raises:
        ValueError: it holds something already.
        OSError: it cannot be made.
    """
    if folder is None:
        folder = Path("results") / name / datetime.now().strftime("%Y-%m-%d_%H-%M-%S_%f")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"{folder}: expected a new or empty folder for the results, got one in use; choose another")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


class Report:
    """The results of a run, written as it goes.

    Owns the files of its folder: config.yaml and curve.csv grow with the run, policy.npz and the pictures come
    with `finish`.

    Args:
        folder: an empty folder.
        config: the run.
    """

    def __init__(self, folder: Path, config: Config) -> None:
        self.folder = folder
        self._config = config
        self._began = time.monotonic()
        self._rows: list[Row] = []
        self._last: Iteration | None = None
        (folder / "config.yaml").write_text(resolved(config))
        self._write(Row._fields, mode="w")

    def add(self, iteration: Iteration) -> None:
        """Write an iteration's line."""
        metrics = iteration.metrics
        row = Row(
            iteration=iteration.number,
            episodes=iteration.episodes_used,
            train_return=float(iteration.train_returns.mean()),
            train_return_sd=float(iteration.train_returns.std()),
            mean_policy_return=float(iteration.mean_policy_returns.mean()),
            centres=metrics.centres,
            step_size=metrics.step_size,
            kl=metrics.kl,
            sparsification_error=metrics.sparsification_error,
            seconds=time.monotonic() - self._began,
        )
        self._write(row, mode="a")
        self._rows.append(row)
        self._last = iteration

    def finish(self) -> None:
        """Write the policy and the pictures of what was learnt so far."""
        if self._last is None:
            return
        save_policy(self.folder / "policy.npz", self._last.policy, self._config.task)
        numbers, train, mean = (
            np.array([getattr(row, name) for row in self._rows])
            for name in ("iteration", "train_return", "mean_policy_return")
        )
        draw_curve(self.folder / "curve.png", numbers, train, mean, self._config.task)
        draw_policy(self.folder / "policy.png", self._last.policy, self._last.evaluation)

    def _write(self, row: tuple[object, ...], mode: str) -> None:
        with (self.folder / "curve.csv").open(mode, newline="") as file:
            csv.writer(file).writerow(row)


def resolved(config: Config) -> str:
    """Return the whole configuration as a ROS parameter file, under the versions it ran with."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "gymnasium"))
    header = f"# Python {platform.python_version()}, {packages}\n"
    return header + yaml.safe_dump(config.parameters(), sort_keys=False, default_flow_style=None)


def summary(folder: Path, config: Config) -> str:
    """Return in three lines what was learnt and where the pictures are."""
    with (folder / "curve.csv").open(newline="") as file:
        first, *_, last = [*csv.DictReader(file)] * 2
    return (
        f"Learnt {config.environment.id} in {last['episodes']} episodes, {float(last['seconds']):.1f} s.\n"
        f"Return: {float(first['train_return']):.1f} before, {float(last['mean_policy_return']):.1f} after, noise-free"
        f" ({last['centres']} centres).\n"
        f"Pictures: {folder / 'curve.png'} and {folder / 'policy.png'}"
    )
