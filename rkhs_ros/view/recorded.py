"""Read a run from its recording, which may still grow: the policy and the episodes of every iteration."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from rkhs_ros.base.files import is_locked
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Row
from rkhs_ros.learning.model_based.training_in_model import model_rollouts_of
from rkhs_ros.learning.training_settings import ModelBased
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.recordings.container import MessageReader
from rkhs_ros.recordings.definitions import PACKAGE
from rkhs_ros.recordings.recording import Head, Recording, faults_named, own_messages, recording_file
from rkhs_ros.runs.config import config_of, load_config
from rkhs_ros.runs.report import is_started

MODEL_ROLLOUTS = 3  # per iteration
RUNNING, FINISHED, ENDED = "running", "finished", "not running"


class IterationView(NamedTuple):
    """The policy and the episodes of an iteration."""

    policy: GaussianPolicy  # after the update
    exploration: Episodes  # as observed
    evaluation: Episodes | None  # of the updated policy; None if there are none
    # Rolls the policy out, without exploration noise, in a model of all episodes so far; None without a model.
    roll_out_model: Callable[[], Episodes] | None = None


class Recorded:
    """A recorded run that may still grow.

    Owns the content of the recording so far, and the rows of the learning curve.

    Attributes:
        nodes: parameters of a robot's nodes by node name; empty for a simulator.
        total: planned number of iterations.
    """

    def __init__(self, path: Path) -> None:
        self._file = recording_file(path)
        self.path = self._file.parent if is_started(self._file.parent) else self._file
        self._inode = 0
        self.refresh()
        require(bool(self._recording.heads), f"{self._file}", "the recording of a run", "a file without its header")

    def refresh(self) -> None:
        """Read the messages recorded since the last call."""
        inode = self._file.stat().st_ino
        if inode != self._inode:  # a new file; a resumed run replaces the earlier one
            self._inode, self._reader, self._recording = inode, MessageReader(self._file), Recording()
            self._rows: dict[int, Row] = {}
        with faults_named(self._file):
            for kind, time, message in own_messages(self._reader.news().messages):
                is_first = not self._recording.heads
                self._recording.add(kind, time, message)
                if is_first and self._recording.heads:
                    self._begin(self._recording.head, time)
                elif kind == f"{PACKAGE}Update" and message.policy_version in self._recording.policies:
                    known = {name: getattr(message, name) for name in Row._fields if name != "seconds"}
                    self._rows[message.iteration] = Row(**known, seconds=(time - self._began_ns) / 1e9)

    @property
    def rows(self) -> Sequence[Row]:
        """The rows of the learning curve so far."""
        return list(self._rows.values())

    @property
    def iterations(self) -> Sequence[int]:
        """The completed iterations."""
        return list(self._rows)

    def load(self, iteration: int) -> IterationView | None:
        """Return the policy and the episodes of an iteration; None if an episode is missing."""
        recording = self._recording
        try:
            explored, evaluated = recording.exploration(iteration), recording.evaluation(iteration)
        except ValueError:
            return None
        version = next(each.policy_version for each in recording.updates if each.iteration == iteration)
        policy, end = recording.policies[version], self._rows[iteration].episodes
        settings, spaces, discount = self._model_settings, self.spaces, self.task.discount
        if not isinstance(settings, ModelBased):
            return IterationView(policy, explored, evaluated)

        @cache
        def roll_out_model() -> Episodes:
            all_explored = recording.numbered(0, end, explore=True)
            return model_rollouts_of(settings, policy, all_explored, spaces, discount, MODEL_ROLLOUTS)

        return IterationView(policy, explored, evaluated, roll_out_model)

    def _begin(self, head: Head, time: int) -> None:
        config = config_of(head.configuration)
        training, self.nodes = config.training, config.environment.nodes
        if self.path.is_dir():
            training = load_config(self.path / "config.yaml").training  # a resumed run may have more iterations
        self._began_ns, self._model_settings = time, training.model
        self.name, self.task, self.spaces, self.total = training.name, head.task, head.spaces, training.iterations


def state_of(run: Recorded) -> str:
    """Return the state of a run: RUNNING, FINISHED or ENDED (before its last iteration)."""
    if run.path.is_dir() and is_locked(run.path):
        return RUNNING
    done = run.rows[-1].iteration if run.rows else 0
    return FINISHED if done >= run.total else ENDED
