"""How the episodes of a task look in space, and what its numbers are called, if it says so."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from gymnasium.envs.registration import load_env_creator

from rkhs_ros.pictures.known import names_of
from rkhs_ros.policies.input_names import Names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.task import robot_task_from
from rkhs_ros.rollouts.environments import spec_of
from rkhs_ros.rollouts.visualization import ShowsBodies
from rkhs_ros.view.robot_scene import robot_scene, sensed_joints
from rkhs_ros.view.timeline import Timeline

TWIN = Task("rkhs/Pendulum-v0", {}, 1, 1.0)  # which the simulated robot with this joint looks like
TWINS_JOINT = "motor"


class TaskAppearance(NamedTuple):
    """What is shown of a task: the names of its numbers, and its episodes in space."""

    names: Names
    scene: ShowsBodies


def look_of(
    task: Task, spaces: Spaces | None, nodes: Mapping[str, Mapping[str, Any]], observations: Array, actions: Array
) -> TaskAppearance:
    """Return what is shown of a task; its numbers over time of one that does not say how it looks.

    Args:
        task: what is learnt.
        spaces: of the task; None where they are not known.
        nodes: of a robot the parameters of its nodes, by their names.
        observations: of an episode, shape (steps, d).
        actions: of that episode, shape (steps, n).
    """
    widths = observations.shape[1], actions.shape[1]
    with suppress(Exception):  # of another robot than this one, or somebody's code
        if nodes:
            return _look_of_robot(task, nodes, observations, actions)
    names = names_of(task, *widths, spaces)
    return TaskAppearance(names, in_space(task) or Timeline(names))


def in_space(task: Task) -> ShowsBodies | None:
    """Return the task where its class says how its episodes look; None for others, which are not made at all."""
    with suppress(Exception):  # somebody's code, which the page can do without
        for maker in _makers(task):
            if all(hasattr(maker, name) for name in ("eye", "room", "bodies", "motion")):
                made = maker(**task.options)
                return made if isinstance(made, ShowsBodies) else None
    return None


def _look_of_robot(
    task: Task, nodes: Mapping[str, Mapping[str, Any]], observations: Array, actions: Array
) -> TaskAppearance:
    """Return how a robot looks: by its URDF, as its twin in simulation, or by its numbers.

    Raises:
        ValueError: its parameters do not fit.
    """
    robot = robot_task_from(nodes["robot"])
    names = names_of(task, observations.shape[1], actions.shape[1], robot.spaces)
    scene: ShowsBodies | None = None
    with suppress(ValueError, OSError):
        scene = robot_scene(nodes, robot, observations, actions)
    if scene is None and "simulated_robot" in nodes and sensed_joints(robot).get(TWINS_JOINT) == 0:
        scene = in_space(TWIN)
    return TaskAppearance(names, scene or Timeline(names))


def _makers(task: Task) -> list[Any]:
    """Return the classes or functions that make the environment, that of many rows first."""
    spec = spec_of(task.environment)
    entries = [entry for entry in (spec.vector_entry_point, spec.entry_point) if entry is not None]
    return [load_env_creator(entry) if isinstance(entry, str) else entry for entry in entries]
