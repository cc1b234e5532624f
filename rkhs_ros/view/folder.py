"""Read an unrecorded run from its folder: the curve, and the stored policies and episodes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from rkhs_ros.base.files import read_whole
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model_based.settings import ModelBased
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import policy_of, read_policy, unpacked
from rkhs_ros.runs.checkpoint import MEMORY
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve, Row
from rkhs_ros.runs.episode_files import load_episodes
from rkhs_ros.runs.report import BEST_POLICY, old_folder
from rkhs_ros.view.source import IterationView, model_rollout_function


class Folder:
    """A run in its folder, without a recording.

    Owns the rows of the curve read so far.

    Args:
        path: folder of the run.

    Raises:
        ValueError: the folder contains no run.
    """

    def __init__(self, path: Path) -> None:
        self.path = old_folder(path)
        config = load_config(path / "config.yaml")
        self.name, self.task, self.total = config.training.name, config.task, config.training.iterations
        self.nodes = config.environment.nodes
        self.spaces: Spaces | None = None
        self._model_settings = config.training.model
        self._curve = Curve(path / "curve.csv")
        self._stamp = (0, 0)
        self._rows: list[Row] = []

    @property
    def rows(self) -> Sequence[Row]:
        """The rows of the learning curve so far."""
        return self._rows

    @property
    def iterations(self) -> Sequence[int]:
        """The iterations whose policy is stored in a checkpoint."""
        return sorted(int(path.stem) for path in (self.path / "checkpoints").glob("*.npz"))

    def refresh(self) -> None:
        """Read the curve if it changed, and the task's spaces once they are stored."""
        about = self._curve.path.stat() if self._curve.path.exists() else None
        stamp = (about.st_mtime_ns, about.st_size) if about else (0, 0)
        if stamp != self._stamp:
            self._rows, self._stamp = self._curve.rows(), stamp
        best = self.path / BEST_POLICY
        if self.spaces is None:
            with suppress(ValueError, OSError):  # the file does not exist yet, or is damaged
                self.spaces = read_policy(best).spaces

    def load(self, iteration: int) -> IterationView | None:
        """Return the stored policy and episodes of an iteration."""
        try:
            arrays = unpacked(read_whole(self.path / "checkpoints" / f"{iteration:07}.npz"))
            memory = Episodes(*(arrays[f"memory_{name}"] for name in MEMORY))
            policy = policy_of(arrays)
        except Exception:  # deleted meanwhile, or damaged, which raises almost anything
            return None
        roll_out_model = model_rollout_function(
            self._model_settings, policy, lambda: memory, self.spaces, self.task.discount
        )
        return IterationView(policy, self._explored(memory, iteration), self._evaluated(iteration), roll_out_model)

    def _explored(self, memory: Episodes, iteration: int) -> Episodes | None:
        if not isinstance(self._model_settings, ModelBased) or iteration > len(self._rows):
            return None
        ends = [0, *(row.episodes for row in self._rows[:iteration])]
        return memory.take(slice(ends[-2], ends[-1]))  # the memory stores all episodes, as observed

    def _evaluated(self, iteration: int) -> Episodes | None:
        """Return the evaluation episodes of the last policy, which a run stores at its end."""
        file = self.path / "episodes.npz"
        if iteration < len(self._rows) or not file.exists():
            return None
        return load_episodes(file).episodes
