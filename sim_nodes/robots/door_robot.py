"""The PR2 and its door as a simulated robot: PyBullet simulations, played back in real time."""

from __future__ import annotations

from typing import NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rkhs_ros.policies.streams import stream
from sim_nodes.pr2 import demonstration, door, robot
from sim_nodes.pr2.motion import Motion
from sim_nodes.robots.door import (
    CHOICES,
    CHOSEN,
    PER_EPISODE,
    Attempt,
    DoorSettings,
    Doorway,
    adapted_trajectory,
    choice_of,
)
from sim_nodes.robots.drives import JointCommand
from sim_nodes.robots.joints import JointReadings
from sim_nodes.robots.robot import Robot

try:
    from sim_nodes.pr2.environment import POSE_SD, tracking_error
    from sim_nodes.pr2.world import Trajectory, World
except gymnasium.error.DependencyNotInstalled as _error:
    raise ValueError(f"robot: expected PyBullet for the PR2's door, got none: {_error}") from _error

Array = NDArray[np.float64]
NAMES = (robot.TORSO.name, *(joint.name for joint in robot.MOVING), *(joint.name for joint in door.JOINTS))


class DoorReadings(NamedTuple):
    """Readings of the sensors.

    Attributes:
        joints: of the robot and the door.
        base_error: error of the base's pose, x, y, yaw, each in standard deviations.
        reward: of a complete attempt; None before.
    """

    joints: JointReadings
    base_error: tuple[float, ...]
    reward: float | None


class DoorRobot(Robot[Doorway]):
    """The PR2 and its door as a simulated robot.

    Its `door_controller` takes a change of the demonstration as set points of two joints. When they come to rest away
    from (0, 0), the robot executes the changed demonstration, once after each reset.

    Owns the simulated world, the state of the doorway, the choice, the episode and the stream of the sensors' noise.

    Args:
        settings: of the robot.
    """

    def __init__(self, settings: DoorSettings) -> None:
        super().__init__(settings, Doorway())
        self._chooses, self._choice = settings.controller == CHOICES, np.zeros(len(CHOSEN))
        self._names = (*NAMES, *CHOSEN) if self._chooses else NAMES
        self._pose, self._episode = settings.pose, 0
        self._world = World()
        self._waiting = _waiting()
        self._noise = stream(settings.seed, "pr2_door/sensor", 0)

    @property
    def base_error(self) -> Array:
        """Error of the base's pose: x, y, yaw, each in standard deviations, shape (3,)."""
        episode = self._episode if self._pose == PER_EPISODE else 0
        return stream(self.settings.seed, "pr2_door/pose", episode).standard_normal(3)

    def hear(self, command: JointCommand) -> None:
        """Receive a trajectory, or a choice."""
        if self._chooses:
            self._choose(command)
        else:
            self.state = self.state.heard(command, self._carry_out)

    def step(self) -> None:
        """Advance by one step of time."""
        self.state = self.state.stepped(1.0 / self.settings.rate)

    def sample(self) -> DoorReadings:
        """Return the readings of the sensors."""
        attempt = self.state.attempt
        position, velocity, torque = self._waiting if attempt is None else _at(attempt.trajectory, self.state.elapsed)
        noise = self._noise.standard_normal((2, len(NAMES)))
        position = position + self.settings.position_noise * noise[0]
        velocity = velocity + self.settings.velocity_noise * noise[1]
        if self._chooses:
            still = np.zeros(len(CHOSEN))
            position = np.concatenate([position, self._choice])
            velocity, torque = np.concatenate([velocity, still]), np.concatenate([torque, still])
        joints = JointReadings(self._names, *(tuple(values.tolist()) for values in (position, velocity, torque)))
        reward = attempt.reward if attempt is not None and self.state.is_over else None
        return DoorReadings(joints, tuple(self.base_error.tolist()), reward)

    def begin_episode(self) -> None:
        """Shut the door and return the robot to its start, as an operator would."""
        self._episode += 1
        self.state = Doorway(protection=self.state.protection)

    def description(self) -> str:
        """Return the robot's URDF."""
        return robot.urdf()

    def _choose(self, command: JointCommand) -> None:
        found = choice_of(command)
        if found is None or not np.isfinite(found[0]).all():
            names = ", ".join(command.names)
            self.trip("malformed", f"expected finite positions of {', '.join(CHOSEN)}, got those of {names}")
            return
        self._choice, rests = found
        if rests and self._choice.any() and self.state.attempt is None:
            self._open_door()

    def _open_door(self) -> None:
        motion = adapted_trajectory(self._choice)
        if motion is None:
            self.trip("position", f"expected a motion within the arm's reach, got that of the choice {self._choice}")
        else:
            self.state = self.state.heard(motion, self._carry_out)

    def _carry_out(self, motion: Motion) -> Attempt:
        trajectory = self._world.run(motion, POSE_SD * self.base_error)
        shown, knots = demonstration.load(), len(trajectory.door)
        if knots != len(shown.times):  # a motion of another duration cannot be compared with the demonstration
            return Attempt(trajectory, 0.0)
        success = float(trajectory.door[-1]) > door.OPENED
        return Attempt(trajectory, float(np.exp(-tracking_error(trajectory, shown) - (not success))))


def _waiting() -> tuple[Array, Array, Array]:
    """Return positions, velocities and torques of all joints before an attempt, each of shape (14,)."""
    shown, still = demonstration.load(), np.zeros(len(NAMES))
    fingers = np.repeat(robot.finger_angle(shown.openings[0]), 4)
    return np.concatenate([[demonstration.TORSO], shown.arm[0], fingers, [0.0, 0.0]]), still, still


def _at(trajectory: Trajectory, time: float) -> tuple[Array, Array, Array]:
    """Return positions, velocities and torques of all joints at a time, each of shape (14,)."""
    place = min(time * demonstration.RATE, len(trajectory.door) - 1.0)
    before = min(int(place), len(trajectory.door) - 2)
    part = place - before

    def between(values: Array) -> Array:
        return np.asarray((1.0 - part) * values[before] + part * values[before + 1])

    doors = np.stack([trajectory.door, trajectory.lever], axis=1)
    turning = (doors[before + 1] - doors[before]) * demonstration.RATE
    return (
        np.concatenate([[demonstration.TORSO], between(trajectory.positions), between(doors)]),
        np.concatenate([[0.0], between(trajectory.velocities), turning]),
        np.concatenate([[0.0], between(trajectory.torques), [0.0, 0.0]]),
    )
