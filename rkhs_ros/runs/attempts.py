"""Attempts at a task of one step, in which an episode is a single action; stored for plots."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
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
        count: number of stored episodes to reload if the run resumes.
    """

    def __init__(self, folder: Path, task: Task, spaces: Spaces, count: int) -> None:
        self._path = folder / ATTEMPTS
        self._task = task
        self._episodes = Episodes.none(1, spaces.observation_dim, spaces.action_dim)
        if count:
            with suppress(ValueError, OSError):  # the plot then shows later attempts only
                self._episodes = load_episodes(self._path).episodes.take(slice(count))

    def add(self, episodes: Episodes) -> None:
        """Store episodes on the disk.

        Raises:
            OSError: the file cannot be written.
        """
        if self._task.horizon == 1:
            self._episodes = (self._episodes + episodes).take(slice(-MOST_ATTEMPTS, None))
            save_episodes(self._path, self._episodes, self._task)
