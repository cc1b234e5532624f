"""A simulated seven-joint arm in real time, with a mark to reach.

The mark moves in front of the arm, on a known slow path with a random start in each episode.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import numbers, require
from rkhs_ros.policies.streams import stream
from rkhs_ros.rkhs.kernels import Array
from sim_nodes.robots.drives import DriveLimits, Drives
from sim_nodes.robots.robot import JointReadings, Robot, RobotSettings

if TYPE_CHECKING:
    from sim_nodes.robots.arm_body import Pose

POSITIONS, TRAJECTORIES = "position_controller", "joint_trajectory_controller"
HOME = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.79])  # rad: the hand in front of the mark's path, pointing down
SIZE = len(HOME)
CENTRE = np.array([0.5, 0.0, 0.45])  # m, of the mark's path, in the frame of the arm's base
EXTENT = np.array([0.0, 0.2, 0.1])  # m, of the path to both sides
FREQUENCIES = np.array([0.0, 1.0, 2.0])  # of each axis: a horizontal figure eight in the vertical plane
PERIOD_S = 12.0
NEAR = 0.1  # m from the mark, at which the reward is exp(-1 / 2)


@dataclass(frozen=True)
class ArmLimits(Settings):
    """Limits of the arm's protective stop, in addition to the range of each joint."""

    velocity: tuple[float, ...] = setting(
        (2.175,) * 4 + (2.61,) * 3, "greatest velocity, of each joint or one for all, rad/s", minimum=0.0, maximum=100.0
    )
    acceleration: tuple[float, ...] = setting(
        (25.0,), "greatest acceleration, of each joint or one for all, rad/s²", minimum=0.0, maximum=1e4
    )
    step: tuple[float, ...] = setting(
        (0.1,),
        "greatest difference of successive set points, of each joint or one for all, rad",
        minimum=0.0,
        maximum=10.0,
    )

    def __post_init__(self) -> None:
        """Raise ValueError if a setting is neither one number nor one per joint."""
        super().__post_init__()
        for name in ("velocity", "acceleration", "step"):
            size = len(getattr(self, name))
            require(size in (1, SIZE), f"limits.{name}", numbers(1, SIZE), size)


@dataclass(frozen=True)
class ArmSettings(RobotSettings):
    """Settings of the arm."""

    rate: float = setting(240.0, "rate of the physics, Hz", minimum=100.0, maximum=10_000.0)
    sensor_rate: float = setting(120.0, "rate of joint states, Hz; at most `rate`", minimum=1.0, maximum=10_000.0)
    position_noise: float = setting(1e-4, "sd of the noise of positions, rad", minimum=0.0, maximum=1.0)
    velocity_noise: float = setting(1e-3, "sd of the noise of velocities, rad/s", minimum=0.0, maximum=10.0)
    controller: str = setting(POSITIONS, "controller that receives commands", choices=(POSITIONS, TRAJECTORIES))
    limits: ArmLimits = ArmLimits()


class ArmReadings(NamedTuple):
    """Readings of the arm's sensors."""

    joints: JointReadings
    tool: Pose  # in the base's frame
    mark: tuple[float, ...]  # position x, y, z in metres, in the base's frame


class ArmRobot(Robot):
    """The arm as a simulated robot.

    Owns its drives, its body, the episode with its start time, and the stream of the sensors' noise.

    Raises:
        ValueError: PyBullet is missing.
    """

    def __init__(self, settings: ArmSettings) -> None:
        try:  # here, because the other robots do not need PyBullet
            from sim_nodes.robots import arm_body
        except ImportError as error:
            raise ValueError(f"robot: expected what the arm needs, got: {error}") from error

        self._body = body = arm_body.ArmBody(settings.rate, HOME)
        limits = (
            np.broadcast_to(getattr(settings.limits, name), SIZE) for name in ("velocity", "acceleration", "step")
        )
        super().__init__(
            settings, Drives(arm_body.JOINTS, DriveLimits(body.lower, body.upper, *limits), HOME, np.zeros(SIZE))
        )
        self._episode, self._began = 0, 0.0
        self._phase = first_phase(settings.seed, self._episode)
        self._noise = stream(settings.seed, "arm/sensor", 0)

    def step(self) -> None:
        """Simulate one step of the physics."""
        self.state = self.state.stepped(1.0 / self.settings.rate)
        self._body.step(self.state.position, self.state.velocity)

    def sample(self) -> ArmReadings:
        """Return the readings of the sensors."""
        position, velocity, torque = self._body.joints()
        noise = self._noise.standard_normal((2, SIZE))
        position = position + self.settings.position_noise * noise[0]
        velocity = velocity + self.settings.velocity_noise * noise[1]
        joints = JointReadings(self.state.joints, _row(position), _row(velocity), _row(torque))
        mark = mark_at(self.state.time - self._began, self._phase)
        return ArmReadings(joints, self._body.tool(), _row(mark))

    def begin_episode(self) -> None:
        """Begin the next episode, and move the mark to the start position of that episode."""
        self._episode += 1
        self._phase = first_phase(self.settings.seed, self._episode)
        self._began = self.state.time

    def description(self) -> str:
        """Return the robot's URDF."""
        from sim_nodes.robots.arm_body import urdf

        return urdf()


def first_phase(seed: int, episode: int) -> float:
    """Return the mark's start on its path in an episode, in [0, 1)."""
    return float(stream(seed, "arm/mark", episode).random())


def mark_at(time: float, phase: float) -> Array:
    """Return the mark's position x, y, z in metres at a time, in seconds since the start of the episode."""
    return np.asarray(CENTRE + EXTENT * np.sin(2 * np.pi * FREQUENCIES * (time / PERIOD_S + phase)))


def distance(observations: Array) -> Array:
    """Return the distance of the arm's tool from the mark, in metres.

    Args:
        observations: y and z of the mark, whose x is constant, then x, y and z of the tool, shape (..., 5).
    """
    mark, tool = observations[..., :2], observations[..., 2:]
    off = np.concatenate([tool[..., :1] - CENTRE[0], tool[..., 1:] - mark], axis=-1)
    return np.asarray(np.linalg.norm(off, axis=-1))


def near(before: Array, executed: Array, after: Array) -> Array:
    r"""Return :math:`\exp(-d^2 / 2 s^2)` of the distance d of the arm's tool from the mark after a step.

    The arguments may have leading dimensions, so that model-based training can use it as a known reward.
    """
    return np.asarray(np.exp(-0.5 * (distance(after) / NEAR) ** 2))


def _row(values: Array) -> tuple[float, ...]:
    return tuple(values.tolist())
