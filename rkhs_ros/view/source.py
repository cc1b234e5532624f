"""Interface of the runs that a page can show."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from rkhs_ros.base.files import is_locked
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Row
from rkhs_ros.learning.model_based.settings import ModelBased, ModelSettings
from rkhs_ros.learning.model_based.training_in_model import model_rollouts_of
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task

MODEL_ROLLOUTS = 3  # per iteration
RUNNING, FINISHED, ENDED = "running", "finished", "not running"


class IterationView(NamedTuple):
    """The policy and the episodes of an iteration.

    Attributes:
        policy: policy after the update; None if it is not stored.
        exploration: exploration episodes of the iteration, as observed; None if they are not stored.
        evaluation: evaluation episodes of the updated policy, as observed; None if there are none.
        roll_out_model: rolls the policy out, without exploration noise, in a model of all episodes so far; None for
            a run without a model.
    """

    policy: GaussianPolicy | None
    exploration: Episodes | None
    evaluation: Episodes | None
    roll_out_model: Callable[[], Episodes] | None = None


class Source(Protocol):
    """A run that may still grow.

    Attributes:
        path: folder or file of the run.
        name: name of the run.
        task: task of the run.
        nodes: parameters of a robot's nodes by node name; empty for a simulator.
        spaces: spaces of the task; None if unknown.
        total: planned number of iterations.
    """

    path: Path
    name: str
    task: Task
    nodes: Mapping[str, Mapping[str, Any]]
    spaces: Spaces | None
    total: int

    def refresh(self) -> None:
        """Read new data from the folder or file."""

    @property
    def rows(self) -> Sequence[Row]:
        """The rows of the learning curve so far."""

    @property
    def iterations(self) -> Sequence[int]:
        """The iterations that can be loaded, in order."""

    def load(self, iteration: int) -> IterationView | None:
        """Load an iteration; return None if it is no longer stored."""


def model_rollout_function(
    settings: ModelSettings,
    policy: GaussianPolicy,
    episodes: Callable[[], Episodes],
    spaces: Spaces | None,
    discount: float,
) -> Callable[[], Episodes] | None:
    """Return a cached function that rolls a policy out in the model; None without a model or known spaces.

    Args:
        settings: model settings of the run.
        policy: policy to roll out.
        episodes: returns all real episodes so far, the data of the model.
        spaces: spaces of the task; None if unknown.
        discount: discount factor per step.
    """
    if not isinstance(settings, ModelBased) or spaces is None:
        return None
    return cache(lambda: model_rollouts_of(settings, policy, episodes(), spaces, discount, MODEL_ROLLOUTS))


def state_of(source: Source) -> str:
    """Return the state of a run: RUNNING, FINISHED or ENDED (before its last iteration)."""
    if source.path.is_dir() and is_locked(source.path):
        return RUNNING
    done = source.rows[-1].iteration if source.rows else 0
    return FINISHED if done >= source.total else ENDED
