"""Find the 3D scene of a task; that of a robot has its bodies at the joint positions, and the sensed points."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from viser.transforms import SO3

from rkhs_ros.pictures.known import Body, BodyTrajectories, ShowsBodies, names_of, scene_of
from rkhs_ros.pictures.style import COLOURS
from rkhs_ros.policies.inputs import Names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.sensors import JOINT_STATE
from rkhs_ros.robot.task import RobotTask, robot_task_from
from rkhs_ros.robot.urdf import located
from rkhs_ros.view.bodies import NO_TURN, Surface, UrdfBodies, three
from rkhs_ros.view.timeline import Timeline

Point = tuple[float, float, float]
AXES = "xyz"
BALL_M = 0.06  # diameter of a sensed point
MARGIN_M = 0.02  # around all bodies
EYE = (0.9, -1.6, 0.5)
BLUE, RED, GREEN, PINK, *_ = COLOURS
TWIN = Task("rkhs/Pendulum-v0", {}, 1, 1.0)  # has the scene of the simulated robot with this joint
TWINS_JOINT = "motor"
SHADES = (RED, GREEN, PINK, BLUE)  # of the sensed points


class RobotScene:
    """The bodies of a robot and the points that it senses; implements `ShowsBodies` around the first episode.

    Joints without a sensor follow the commands, if these are positions. The motion in the given episode determines the
    bounds.
    """

    view_direction = EYE

    def __init__(
        self, bodies: UrdfBodies, task: RobotTask, gate: Mapping[str, Any], observations: Array, actions: Array
    ) -> None:
        self._bodies, self._task, self._joints = bodies, task, gate.get("joints", ())
        self._velocity = np.array(gate.get("limits", {}).get("velocity") or np.inf)
        self._sensed = sensed_joints(task)
        self._points = sensed_points(task)
        self.bounds = self._around(self.motion(observations, actions))

    def bodies(self) -> list[Surface | Body]:
        """Return the bodies of the robot and a ball for each sensed point."""
        balls = [Body("ball", (BALL_M,) * 3, shade) for shade, _ in zip(SHADES, self._points, strict=False)]
        return [*self._bodies.bodies, *balls]

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories:
        """Return the poses of the bodies during an episode."""
        count = len(observations)
        frames = np.stack(self._bodies.frames(self._positions(observations, actions), count), axis=1)
        points = self._placed(observations)[:, : len(SHADES)]
        still = np.broadcast_to(NO_TURN, (*points.shape[:2], 4))
        positions = np.concatenate([frames[..., :3, 3], points], axis=1)
        orientations = np.concatenate([SO3.from_matrix(frames[..., :3, :3]).wxyz, still], axis=1)
        return BodyTrajectories(self._task.period * np.arange(count, dtype=np.float64), positions, orientations)

    def _positions(self, observations: Array, actions: Array) -> dict[str, Array]:
        positions = {joint: observations[:, column] for joint, column in self._sensed.items()}
        if self._task.action.kind == "position" and len(self._joints) == actions.shape[1]:
            reset, still = self._task.reset, self._task.action.command(np.zeros(actions.shape[1]))
            first = reset.home.position if "home" in reset.steps else still
            commands = np.array([self._task.action.command(action) for action in actions])
            moved = self._followed(np.broadcast_to(first, len(self._joints)), commands)
            positions = dict(zip(self._joints, moved.T, strict=True)) | positions
        return positions

    def _followed(self, first: Array, commands: Array) -> Array:
        """Return joint positions before each command, for joints that follow commands at the gate's velocity limit."""
        most = self._velocity * self._task.period
        moved = [first]
        for command in commands[:-1]:
            moved.append(moved[-1] + np.clip(command - moved[-1], -most, most))
        return np.array(moved)

    def _placed(self, observations: Array) -> Array:
        """Return the positions of the points, shape (steps, points, 3).

        A coordinate that is not observed of one point is the mean of the other points' coordinate.
        """
        points = np.full((len(observations), len(self._points), 3), np.nan)
        for i, columns in enumerate(self._points.values()):
            for axis, column in columns.items():
                points[:, i, axis] = observations[:, column]
        for axis in range(3):
            known = points[..., axis][np.isfinite(points[..., axis])]
            points[..., axis][np.isnan(points[..., axis])] = known.mean() if len(known) else 0.0
        return points

    def _around(self, motion: BodyTrajectories) -> tuple[Point, Point]:
        ends = [_ends(body) for body in self.bodies()]
        turned = SO3(motion.orientations).as_matrix()
        corners = [turned[:, i] @ end.T + motion.positions[:, i, :, None] for i, end in enumerate(ends)]
        low = np.min([corner.min(axis=(0, 2)) for corner in corners], axis=0) - MARGIN_M
        high = np.max([corner.max(axis=(0, 2)) for corner in corners], axis=0) + MARGIN_M
        return three(low), three(high)


def appearance_of(
    task: Task, spaces: Spaces, nodes: Mapping[str, Mapping[str, Any]], observations: Array, actions: Array
) -> tuple[Names, ShowsBodies]:
    """Return the names of a task and its scene; a timeline of its observations and actions if it defines none."""
    widths = observations.shape[1], actions.shape[1]
    with suppress(Exception):  # the nodes do not fit the robot, or user code fails
        if nodes:
            return _robot_appearance(task, nodes, observations, actions)
    names = names_of(task, *widths, spaces)
    return names, scene_of(task) or Timeline(names)


def _robot_appearance(
    task: Task, nodes: Mapping[str, Mapping[str, Any]], observations: Array, actions: Array
) -> tuple[Names, ShowsBodies]:
    """Return the names of a robot, and its URDF, the scene of its simulated twin, or a timeline."""
    robot = robot_task_from(nodes["robot"])
    names = names_of(task, observations.shape[1], actions.shape[1], robot.spaces)
    gate = nodes.get("gate", {})
    with suppress(ValueError, OSError):
        if urdf := gate.get("limits", {}).get("urdf"):
            return names, RobotScene(UrdfBodies(located(urdf)), robot, gate, observations, actions)
    has_twin = "simulated_robot" in nodes and sensed_joints(robot).get(TWINS_JOINT) == 0
    return names, (scene_of(TWIN) if has_twin else None) or Timeline(names)


def sensed_joints(task: RobotTask) -> dict[str, int]:
    """Return the observation column of each sensed joint position, by joint name."""
    columns: dict[str, int] = {}
    for begin, _, sensor in task.sensors.columns():
        if sensor.type == JOINT_STATE and "position" in sensor.fields:
            first = begin + sensor.fields.index("position") * len(sensor.joints)
            columns |= {joint: first + i for i, joint in enumerate(sensor.joints)}
    return columns


def sensed_points(task: RobotTask) -> dict[str, dict[int, int]]:
    """Return the observation columns of each sensed point: by sensor name, then by axis (0 to 2)."""
    points: dict[str, dict[int, int]] = {}
    for begin, name, sensor in task.sensors.columns():
        for i, field in enumerate(sensor.fields):
            place, _, axis = field.rpartition(".")
            if place in ("point", "pose.position", "position") and axis in AXES and not sensor.joints:
                points.setdefault(name, {})[AXES.index(axis)] = begin + i
    return points


def _ends(body: Surface | Body) -> Array:
    """Return two corners of the box around a body, shape (2, 3)."""
    if isinstance(body, Surface):
        return np.array([body.vertices.min(axis=0), body.vertices.max(axis=0)])
    half = np.array(body.size) / 2
    return np.array([-half, half])
