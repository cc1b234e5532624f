"""The journal of a robot: one file per episode, written before the episode is reported."""

import sys
from dataclasses import fields
from pathlib import Path

import numpy as np

from rkhs_ros.base.files import read_whole, write_whole
from rkhs_ros.base.validation import truncated
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.execution import Execution
from rkhs_ros.policies.storage import packed, unpacked
from rkhs_ros.policies.streams import Batch
from rkhs_ros.robot.episode import FinishedEpisode

EPISODES = [f.name for f in fields(Episodes)]


class Journal:
    """The stored episodes of a robot, completed and discarded.

    A completed episode is found again by its seed and number, so that it runs only once even if a process is killed.
    Discarded episodes are stored beside it, numbered.

    Owns the files in a folder.

    Args:
        folder: created if missing; None to store nothing.

    Raises:
        OSError: the folder cannot be created.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def add(self, ended: FinishedEpisode) -> None:
        """Write an episode durably to disk.

        Raises:
            OSError: the file cannot be written.
        """
        if self._folder is not None:
            path = self._path(ended.batch)
            write_whole(self._numbered_path(path) if ended.execution.discard_reason else path, _content(ended))

    def discard(self, ended: FinishedEpisode) -> None:
        """Store a completed episode as discarded, with the reason in its execution.

        Raises:
            OSError: the file cannot be written.
        """
        self.add(ended)
        if self._folder is not None and (path := self._path(ended.batch)).exists():
            path.replace(self._numbered_path(path, "unused"))

    def find(self, batch: Batch) -> FinishedEpisode | None:
        """Return the completed episode of a batch; None if there is none; log a warning if its file is damaged."""
        path = self._path(batch) if self._folder is not None else None
        if path is None or not path.exists():
            return None
        try:
            arrays = unpacked(read_whole(path))
            episodes = Episodes(*(arrays[name] for name in EPISODES))
            return FinishedEpisode(batch, episodes, Execution(arrays["stamps"], arrays["executed"], arrays["flags"]))
        except Exception as error:  # a damaged archive raises almost anything
            print(f"warning: {path}: ignored, the file is damaged ({truncated(error)})", file=sys.stderr)
            return None

    def _path(self, batch: Batch) -> Path:
        kind = "training" if batch.explore else "evaluation"
        name = f"{kind}_seed_{batch.seed}_episode_{batch.first_episode:07}_steps_{batch.horizon}.npz"
        return (self._folder or Path()) / name

    def _numbered_path(self, path: Path, kind: str = "discarded") -> Path:
        count = len(list(path.parent.glob(f"{path.stem}_{kind}_*.npz")))
        return path.with_name(f"{path.stem}_{kind}_{count + 1}.npz")


def _content(ended: FinishedEpisode) -> bytes:
    execution = ended.execution
    arrays = {name: getattr(ended.episodes, name) for name in EPISODES}
    arrays |= {name: getattr(execution, name) for name in ("stamps", "executed", "flags")}
    return packed(arrays | {"discard_reason": np.array(execution.discard_reason)})
