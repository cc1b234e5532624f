"""What was tried in a task of one step, where an episode is a single action: kept for its picture."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.runs.episode_files import load_episodes, save_episodes

ATTEMPTS = "attempts.npz"
MOST_ATTEMPTS = 10_000  # the last ones are kept


class Attempts:
    """The exploring episodes of a run whose task has one step; of others none are kept.

    Owns attempts.npz in the run's folder.

    Args:
        folder: of the run.
        task: of the run.
        spaces: of the task.
        count: exploring episodes of the iterations that are kept of a run that goes on.
    """

    def __init__(self, folder: Path, task: Task, spaces: Spaces, count: int) -> None:
        self._path = folder / ATTEMPTS
        self._task = task
        self._episodes = Episodes.none(1, spaces.observation_dim, spaces.action_dim)
        if count:
            with suppress(ValueError, OSError):  # the picture then shows what is tried from now on
                self._episodes = load_episodes(self._path).episodes.take(slice(count))

    def add(self, episodes: Episodes) -> None:
        """Keep episodes, on the disk.

        Raises:
            OSError: they cannot be written.
        """
        if self._task.horizon == 1:
            self._episodes = (self._episodes + episodes).take(slice(-MOST_ATTEMPTS, None))
            save_episodes(self._path, self._episodes, self._task)
