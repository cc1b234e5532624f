"""The journal of a robot: each episode in a file of its own, written before anybody is told of it."""

from __future__ import annotations

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
    """The episodes that a robot made, finished and void.

    A finished one is found again by its numbers, so that it is run once whoever is killed; void ones are kept beside
    it, numbered.

    Owns the files in a folder.

    Args:
        folder: made where it is missing; None to remember nothing.

    Raises:
        OSError: it cannot be made.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def add(self, ended: FinishedEpisode) -> None:
        """Write an episode that is over, and wait until the disk has it.

        Raises:
            OSError: it cannot be written.
        """
        if self._folder is not None:
            path = self._path(ended.batch)
            write_whole(self._next_void(path) if ended.execution.discard_reason else path, _content(ended))

    def discard_finished(self, ended: FinishedEpisode) -> None:
        """Keep a finished episode as void, with the reason that it has now.

        Raises:
            OSError: it cannot be written.
        """
        self.add(ended)
        self.forget(ended.batch)

    def forget(self, batch: Batch) -> None:
        """Have the finished episode of a batch be run again; its file is kept beside, as one that is not used."""
        if self._folder is not None and (path := self._path(batch)).exists():
            path.replace(self._next_void(path, "unused"))

    def find(self, batch: Batch) -> FinishedEpisode | None:
        """Return the finished episode of a batch; None where there is none, or its file is damaged, which is said."""
        path = self._path(batch) if self._folder is not None else None
        if path is None or not path.exists():
            return None
        try:
            arrays = unpacked(read_whole(path))
            episodes = Episodes(*(arrays[name] for name in EPISODES))
            return FinishedEpisode(batch, episodes, Execution(arrays["stamps"], arrays["executed"], arrays["flags"]))
        except Exception as error:  # a damaged archive raises almost anything
            print(f"warning: {path}: passed over, damaged ({truncated(error)})", file=sys.stderr)
            return None

    def _path(self, batch: Batch) -> Path:
        kind = "training" if batch.explore else "evaluation"
        name = f"{kind}_seed_{batch.seed}_episode_{batch.first_episode:07}_steps_{batch.horizon}.npz"
        return (self._folder or Path()) / name

    def _next_void(self, path: Path, kind: str = "void") -> Path:
        count = len(list(path.parent.glob(f"{path.stem}_{kind}_*.npz")))
        return path.with_name(f"{path.stem}_{kind}_{count + 1}.npz")


def _content(ended: FinishedEpisode) -> bytes:
    execution = ended.execution
    arrays = {name: getattr(ended.episodes, name) for name in EPISODES}
    arrays |= {name: getattr(execution, name) for name in ("stamps", "executed", "flags")}
    return packed(arrays | {"discard_reason": np.array(execution.discard_reason)})
