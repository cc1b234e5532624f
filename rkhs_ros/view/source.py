"""What is seen of a run, whatever it is read from: the learning curve, and policy and episodes of its iterations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from rkhs_ros.base.lock import is_locked
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.runs.control import is_pausing
from rkhs_ros.runs.curve import Row

RUNNING, PAUSED, FINISHED, ENDED = "running", "paused", "finished", "not running"


class Seen(NamedTuple):
    """What an iteration left.

    Attributes:
        policy: after it; None where it was not kept.
        exploration: its exploring episodes, as observed; None where they were not kept.
        evaluation: the noise-free episodes after it, alike.
    """

    policy: GaussianPolicy | None
    exploration: Episodes | None
    evaluation: Episodes | None


class Source(Protocol):
    """A run that may still grow.

    Attributes:
        path: its folder or file.
        name: of the run.
        task: what it learns.
        nodes: of a robot the parameters of its nodes, by their names; none of a simulator.
        spaces: of the task; None where they are not known.
        total: number of iterations that it is to make.
    """

    path: Path
    name: str
    task: Task
    nodes: Mapping[str, Mapping[str, Any]]
    spaces: Spaces | None
    total: int

    def refresh(self) -> None:
        """Look at what it is read from anew."""

    @property
    def rows(self) -> Sequence[Row]:
        """The lines of the learning curve so far."""

    @property
    def iterations(self) -> Sequence[int]:
        """The iterations of which a policy can be seen, in order."""

    def seen(self, iteration: int) -> Seen | None:
        """Return what one of these left; None where it is gone meanwhile."""


def state_of(source: Source) -> str:
    """Return whether a run is under way."""
    if source.path.is_dir() and is_locked(source.path):
        return PAUSED if is_pausing(source.path) else RUNNING
    done = source.rows[-1].iteration if source.rows else 0
    return FINISHED if done >= source.total else ENDED
