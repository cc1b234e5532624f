"""What a task may define for pictures: reference returns, names of observations and actions, and a 3D scene."""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple, Protocol, runtime_checkable

import gymnasium
from gymnasium.envs.registration import load_env_creator

from rkhs_ros.policies.inputs import Names, default_names, reported_names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.environments import limit_of, spec_of

REFERENCE_DISCOUNT = 0.99
SCENE = ("view_direction", "bounds", "bodies", "motion")  # of `ShowsBodies`

Corner = tuple[float, float, float]


class Body(NamedTuple):
    """A visible rigid body; a task may return any object with these attributes.

    Attributes:
        shape: "box", "ball" or "cylinder", whose axis is z.
        size: size along x, y and z, in metres.
        colour: RGB colour such as "#0072B2".
    """

    shape: str
    size: tuple[float, float, float]
    colour: str


class BodyTrajectories(NamedTuple):
    """Trajectories of bodies; z points up. A task may return any object with these attributes.

    Attributes:
        times: times in seconds, shape (k,).
        positions: of the centres, in metres, shape (k, bodies, 3).
        orientations: unit quaternions w, x, y, z, shape (k, bodies, 4).
    """

    times: Array
    positions: Array
    orientations: Array


@runtime_checkable
class ShowsBodies(Protocol):
    """Task whose episodes can be shown in 3D, seen along a direction to the camera, within a bounding box in metres."""

    @property
    def view_direction(self) -> Corner: ...  # noqa: D102
    @property
    def bounds(self) -> tuple[Corner, Corner]: ...  # noqa: D102

    def bodies(self) -> Sequence[Any]:
        """Return the visible bodies, with the attributes of `Body`."""

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories | None:
        """Return the trajectories of the bodies in an episode; None if nothing moved."""


def references(task: Task) -> dict[str, float]:
    """Return the reference returns of a task by name.

    They are empty if its horizon or discount is not the registered one, or if an option changes its returns.
    """
    spec = gymnasium.registry.get(task.environment.rpartition(":")[2])
    if spec is None or set(task.options) & getattr(spec.vector_entry_point, "return_options", frozenset()):
        return {}
    if (task.horizon, task.discount) != (limit_of(spec, task.options), REFERENCE_DISCOUNT):
        return {}
    return getattr(spec.vector_entry_point, "reference_returns", {})


def names_of(task: Task, observation_dim: int, action_dim: int, spaces: Spaces | None = None) -> Names:
    """Return the names of a task's observations and actions; "observation 0" and so on if it defines none.

    The names are the attributes ``observation_names`` and ``action_names`` of its spaces (as for robots), of the
    environment's class, or of the function that creates it.
    """
    sizes = {"observation": observation_dim, "action": action_dim}
    return Names(*(getattr(spaces, f"{kind}_names", ()) or _names(task, kind, size) for kind, size in sizes.items()))


def success_reward(task: Task) -> float | None:
    """Return the reward that only successes exceed, the attribute ``success_reward`` of a task; None without one."""
    reward = _attribute(task, "success_reward")
    return float(reward) if isinstance(reward, int | float) else None


def _names(task: Task, kind: str, count: int) -> tuple[str, ...]:
    return reported_names(_attribute(task, f"{kind}_names"), count) or default_names(kind, count)


def scene_of(task: Task) -> ShowsBodies | None:
    """Create and return the task if its class defines a 3D scene; otherwise return None without creating the task."""
    with suppress(Exception):  # user code that the page can do without
        made = _maker_with(task, *SCENE)(**task.options)
        return made if isinstance(made, ShowsBodies) else None
    return None


def _attribute(task: Task, name: str) -> Any:
    """Return an attribute of the task's entry point; None if it has none, or the task is not installed."""
    with suppress(Exception):  # user code that a picture can do without
        return getattr(_maker_with(task, name), name)
    return None


def _maker_with(task: Task, *names: str) -> Any:
    """Return the entry point of the environment that has some attributes, the vectorized one first; None without."""
    spec = spec_of(task.environment)
    entries = (each for each in (spec.vector_entry_point, spec.entry_point) if each is not None)
    makers = (load_env_creator(each) if isinstance(each, str) else each for each in entries)
    return next((maker for maker in makers if all(hasattr(maker, name) for name in names)), None)
