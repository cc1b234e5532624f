"""How the episodes of a task look in space, if it says so."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from gymnasium.envs.registration import load_env_creator

from rkhs_ros.policies.storage import Task
from rkhs_ros.runs.environments import spec_of
from rkhs_ros.runs.shown import ShowsMotion


def in_space(task: Task) -> ShowsMotion | None:
    """Return the task where its class says how its episodes look; None for others, which are not made at all."""
    with suppress(Exception):  # somebody's code, which the page can do without
        for maker in _makers(task):
            if all(hasattr(maker, name) for name in ("eye", "room", "bodies", "motion")):
                made = maker(**task.options)
                return made if isinstance(made, ShowsMotion) else None
    return None


def _makers(task: Task) -> list[Any]:
    """Return the classes or functions that make the environment, that of many rows first."""
    spec = spec_of(task.environment)
    entries = [entry for entry in (spec.vector_entry_point, spec.entry_point) if entry is not None]
    return [load_env_creator(entry) if isinstance(entry, str) else entry for entry in entries]
