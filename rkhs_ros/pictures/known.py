"""What a task says of itself, for pictures: its known returns, and the names of what is seen and done."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import gymnasium
from gymnasium.envs.registration import load_env_creator

from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.storage import Task
from rkhs_ros.runs.environments import spec_of

REFERENCE_DISCOUNT = 0.99
UNIT = re.compile(r"\s*\([^()]*\)$")


@dataclass(frozen=True)
class Names:
    """What the numbers of a task are called, with their units.

    Attributes:
        observations: of each number of an observation.
        actions: of each number of an action.
    """

    observations: tuple[str, ...]
    actions: tuple[str, ...]


def references(task: Task) -> dict[str, float]:
    """Return the returns known for a task at its registered horizon and discount, by name."""
    spec = gymnasium.registry.get(task.environment.rpartition(":")[2])
    if spec is None or (task.horizon, task.discount) != (spec.max_episode_steps, REFERENCE_DISCOUNT):
        return {}
    return getattr(spec.vector_entry_point, "reference_returns", {})


def names_of(task: Task, observation_dim: int, action_dim: int) -> Names:
    """Return what a task calls its numbers in ``observation_names`` and ``action_names``, else "observation 0" etc.

    The attributes are those of the environment's class, or of the function that makes it.
    """
    return Names(_names(task, "observation", observation_dim), _names(task, "action", action_dim))


def success_reward(task: Task) -> float | None:
    """Return the reward that only a success exceeds, if the task says so in ``success_reward``."""
    said = _said(task, "success_reward")
    return float(said) if isinstance(said, int | float) else None


def _names(task: Task, kind: str, count: int) -> tuple[str, ...]:
    said = _said(task, f"{kind}_names")
    good = isinstance(said, list | tuple) and len(said) == count and all(isinstance(name, str) for name in said)
    return tuple(said) if good else tuple(f"{kind} {i}" if count > 1 else kind for i in range(count))


def _said(task: Task, attribute: str) -> Any:
    """Return an attribute of what makes the task; None where there is none, or the task is not installed."""
    with suppress(Exception):  # somebody's code, which a picture can do without
        spec = spec_of(task.environment)
        for entry in (spec.vector_entry_point, spec.entry_point):
            maker = load_env_creator(entry) if isinstance(entry, str) else entry
            if hasattr(maker, attribute):
                return getattr(maker, attribute)
    return None


def input_names(inputs: Inputs, names: Names) -> tuple[str, ...]:
    """Return what the policy's inputs are made of, in their order."""
    seen = _turned(names.observations, inputs.columns)
    if inputs.history > 1:
        ages = range(inputs.history - 1, -1, -1)
        seen = [name for ago in ages for name in [*_aged(seen, ago), *_aged(names.actions, ago + 1)]]
    if inputs.degree == 0:
        return tuple(seen)
    chosen = combinations_with_replacement(range(len(seen) + 1), inputs.degree)
    return tuple(" · ".join(seen[i] for i in columns if i < len(seen)) or "constant" for columns in chosen)


def _turned(observations: Sequence[str], angles: Sequence[int]) -> list[str]:
    turned = [UNIT.sub("", observations[column]) for column in angles]
    rest = [name for column, name in enumerate(observations) if column not in angles]
    return [f"{function} of {name}" for function in ("sine", "cosine") for name in turned] + rest


def _aged(names: Sequence[str], ago: int) -> list[str]:
    return [f"{name}, {ago} step{'s' * (ago > 1)} ago" for name in names] if ago else list(names)
