"""Attempts at a task of one step, in which an episode is a single action; stored for plots."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np

from rkhs_ros.base.files import read_whole
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, unpacked
from rkhs_ros.runs.episode_files import load_episodes, save_episodes

ATTEMPTS = "attempts.npz"
MOST_ATTEMPTS = 10_000  # older attempts are deleted


class Attempts:
    """Exploration episodes of a run whose task has one step; those of other tasks are not stored.

    Owns attempts.npz in the folder of the run.

    Args:
        folder: folder of the run.
        task: task of the run.
        spaces: spaces of the task.
        done: number of finished iterations, whose stored episodes are kept.
    """

    def __init__(self, folder: Path, task: Task, spaces: Spaces, done: int) -> None:
        self._path = folder / ATTEMPTS
        self._task = task
        self._episodes = Episodes.none(1, spaces.observation_dim, spaces.action_dim)
        self._iterations = np.zeros(0, dtype=int)
        if done:
            with suppress(ValueError, OSError):  # the plot then shows later attempts only
                self._reload(done)

    def add(self, iteration: int, episodes: Episodes) -> None:
        """Store the episodes of an iteration on the disk.

        Raises:
            OSError: the file cannot be written.
        """
        if self._task.horizon == 1:
            newest = slice(-MOST_ATTEMPTS, None)
            self._episodes = (self._episodes + episodes).take(newest)
            self._iterations = np.append(self._iterations, np.full(len(episodes), iteration))[newest]
            save_episodes(self._path, self._episodes, self._task, iteration=self._iterations)

    def _reload(self, done: int) -> None:
        """Read the episodes of the finished iterations; those of a repeated iteration are stored again later."""
        stored = load_episodes(self._path).episodes
        iterations = unpacked(read_whole(self._path)).get("iteration", np.zeros(0, dtype=int))
        require(iterations.shape == (len(stored),), "iteration", f"{len(stored)} numbers", iterations.shape)
        kept = np.flatnonzero(iterations <= done)
        self._episodes, self._iterations = stored.take(kept), iterations[kept]
