"""What is seen of a run, whatever it is read from: the learning curve, and policy and episodes of its iterations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from rkhs_ros.base.lock import is_locked
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.model_based import ModelBased, ModelSettings, model_rollouts_of
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.runs.control import is_pausing
from rkhs_ros.runs.curve import Row

MOST_IMAGINED = 3  # episodes
RUNNING, PAUSED, FINISHED, ENDED = "running", "paused", "finished", "not running"


class IterationView(NamedTuple):
    """What an iteration left.

    Attributes:
        policy: after it; None where it was not kept.
        exploration: its exploring episodes, as observed; None where they were not kept.
        evaluation: the evaluation episodes after it, alike.
        imagine: returns evaluation episodes of the policy as a model of all episodes so far expects them; None where
            none is learnt.
    """

    policy: GaussianPolicy | None
    exploration: Episodes | None
    evaluation: Episodes | None
    imagine: Callable[[], Episodes] | None = None


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

    def seen(self, iteration: int) -> IterationView | None:
        """Return what one of these left; None where it is gone meanwhile."""


def imagining(
    settings: ModelSettings, policy: GaussianPolicy, episodes: Callable[[], Episodes], spaces: Spaces | None
) -> Callable[[], Episodes] | None:
    """Return what imagines a policy's episodes; None where it does not practise, or the spaces are not known.

    Args:
        settings: of the run.
        policy: who acts.
        episodes: returns all real ones so far.
        spaces: of the task.
    """
    if not isinstance(settings, ModelBased) or spaces is None:
        return None
    return cache(lambda: model_rollouts_of(settings, policy, episodes(), spaces, MOST_IMAGINED))


def state_of(source: Source) -> str:
    """Return whether a run is under way."""
    if source.path.is_dir() and is_locked(source.path):
        return PAUSED if is_pausing(source.path) else RUNNING
    done = source.rows[-1].iteration if source.rows else 0
    return FINISHED if done >= source.total else ENDED
