"""What a task says of itself, for pictures: its known returns, and the names of what is seen and done."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import gymnasium
from gymnasium.envs.registration import load_env_creator

from rkhs_ros.policies.input_names import Names, plain_names, reported_names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.rollouts.environments import spec_of

REFERENCE_DISCOUNT = 0.99


def references(task: Task) -> dict[str, float]:
    """Return the returns known for a task at its registered horizon and discount, by name."""
    spec = gymnasium.registry.get(task.environment.rpartition(":")[2])
    if spec is None or (task.horizon, task.discount) != (spec.max_episode_steps, REFERENCE_DISCOUNT):
        return {}
    return getattr(spec.vector_entry_point, "reference_returns", {})


def names_of(task: Task, observation_dim: int, action_dim: int, spaces: Spaces | None = None) -> Names:
    """Return what a task calls its numbers in ``observation_names`` and ``action_names``, else "observation 0" etc.

    The attributes are those of its spaces, as of a robot, of the environment's class, or of the function that makes it.
    """
    sizes = {"observation": observation_dim, "action": action_dim}
    return Names(*(getattr(spaces, f"{kind}_names", ()) or _names(task, kind, size) for kind, size in sizes.items()))


def success_reward(task: Task) -> float | None:
    """Return the reward that only a success exceeds, if the task says so in ``success_reward``."""
    said = _said(task, "success_reward")
    return float(said) if isinstance(said, int | float) else None


def _names(task: Task, kind: str, count: int) -> tuple[str, ...]:
    return reported_names(_said(task, f"{kind}_names"), count) or plain_names(kind, count)


def _said(task: Task, attribute: str) -> Any:
    """Return an attribute of what makes the task; None where there is none, or the task is not installed."""
    with suppress(Exception):  # somebody's code, which a picture can do without
        spec = spec_of(task.environment)
        for entry in (spec.vector_entry_point, spec.entry_point):
            maker = load_env_creator(entry) if isinstance(entry, str) else entry
            if hasattr(maker, attribute):
                return getattr(maker, attribute)
    return None
