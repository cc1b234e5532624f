"""Find the 3D scene of a task and the names of its observations and actions."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from gymnasium.envs.registration import load_env_creator

from rkhs_ros.pictures.known import names_of
from rkhs_ros.policies.inputs import Names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.task import robot_task_from
from rkhs_ros.rollouts.environments import spec_of
from rkhs_ros.rollouts.visualization import ShowsBodies
from rkhs_ros.view.robot_scene import robot_scene, sensed_joints
from rkhs_ros.view.timeline import Timeline

TWIN = Task("rkhs/Pendulum-v0", {}, 1, 1.0)  # has the scene of the simulated robot with this joint
TWINS_JOINT = "motor"


class TaskAppearance(NamedTuple):
    """The names of a task's observations and actions, and its 3D scene."""

    names: Names
    scene: ShowsBodies


def appearance_of(
    task: Task, spaces: Spaces, nodes: Mapping[str, Mapping[str, Any]], observations: Array, actions: Array
) -> TaskAppearance:
    """Return the appearance of a task; a timeline of its observations and actions if it defines no scene.

    Args:
        task: task of the run.
        spaces: spaces of the task.
        nodes: parameters of a robot's nodes by node name; empty for a simulator.
        observations: observations of an episode, shape (steps, d).
        actions: actions of that episode, shape (steps, n).
    """
    widths = observations.shape[1], actions.shape[1]
    with suppress(Exception):  # the nodes do not fit the robot, or user code fails
        if nodes:
            return _robot_appearance(task, nodes, observations, actions)
    names = names_of(task, *widths, spaces)
    return TaskAppearance(names, scene_of(task) or Timeline(names))


def scene_of(task: Task) -> ShowsBodies | None:
    """Create and return the task if its class defines a 3D scene; otherwise return None without creating the task."""
    with suppress(Exception):  # user code that the page can do without
        for maker in _makers(task):
            if all(hasattr(maker, name) for name in ("view_direction", "bounds", "bodies", "motion")):
                made = maker(**task.options)
                return made if isinstance(made, ShowsBodies) else None
    return None


def _robot_appearance(
    task: Task, nodes: Mapping[str, Mapping[str, Any]], observations: Array, actions: Array
) -> TaskAppearance:
    """Return the appearance of a robot: its URDF, the scene of its simulated twin, or a timeline.

    Raises:
        ValueError: the parameters of the nodes are invalid.
    """
    robot = robot_task_from(nodes["robot"])
    names = names_of(task, observations.shape[1], actions.shape[1], robot.spaces)
    scene: ShowsBodies | None = None
    with suppress(ValueError, OSError):
        scene = robot_scene(nodes, robot, observations, actions)
    if scene is None and "simulated_robot" in nodes and sensed_joints(robot).get(TWINS_JOINT) == 0:
        scene = scene_of(TWIN)
    return TaskAppearance(names, scene or Timeline(names))


def _makers(task: Task) -> list[Any]:
    """Return the entry points of the environment, the vectorized one first."""
    spec = spec_of(task.environment)
    entries = [entry for entry in (spec.vector_entry_point, spec.entry_point) if entry is not None]
    return [load_env_creator(entry) if isinstance(entry, str) else entry for entry in entries]
