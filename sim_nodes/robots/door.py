"""The PR2 in front of its door, in real time: each trajectory is one attempt to open the door."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.settings import setting
from sim_nodes.pr2 import demonstration, robot
from sim_nodes.pr2.motion import Motion, adapted
from sim_nodes.robots.drives import JointCommand
from sim_nodes.robots.protection import COMMAND_TIMEOUT, SECOND_PUBLISHER, Protection, exceeds
from sim_nodes.robots.robot import RobotSettings

if TYPE_CHECKING:
    from sim_nodes.pr2.world import Trajectory

Array = NDArray[np.float64]
KINDS = ("malformed", "non_finite", "position", "velocity", "start", "not_reset", SECOND_PUBLISHER, COMMAND_TIMEOUT)
GRIPPER = "r_gripper_joint"  # its position is the opening between the finger tips, in metres
COMMANDED = (*(joint.name for joint in robot.ARM), GRIPPER)
LOWER = np.array([*(joint.lower for joint in robot.ARM), 0.0])
UPPER = np.array([*(joint.upper for joint in robot.ARM), robot.MAX_GAP])
VELOCITY = np.array([*(joint.velocity for joint in robot.ARM), 0.5])  # rad/s, of the gripper m/s
START = 0.5  # rad, greatest distance of the first point from the arm's start position
LONGEST_S = 30.0  # duration of an attempt
TRAJECTORIES, CHOICES = "joint_trajectory_controller", "door_controller"
CHOSEN = ("shift", "opening")  # m: changes of the demonstration, which the door controller presents as joints
PER_RUN, PER_EPISODE = "per_run", "per_episode"


@dataclass(frozen=True)
class DoorSettings(RobotSettings):
    """Settings of the PR2 and its door."""

    rate: float = setting(100.0, "rate of the robot's clock, Hz; the physics uses more steps", minimum=1.0, maximum=1e4)
    sensor_rate: float = setting(20.0, "rate of joint states, Hz; at most `rate`", minimum=1.0, maximum=1e4)
    position_noise: float = setting(0.0, "sd of the noise of positions, rad", minimum=0.0, maximum=1.0)
    velocity_noise: float = setting(0.0, "sd of the noise of velocities, rad/s", minimum=0.0, maximum=10.0)
    controller: str = setting(
        TRAJECTORIES,
        "controller that receives commands: whole trajectories, or changes of the demonstration",
        choices=(TRAJECTORIES, CHOICES),
    )
    pose: str = setting(PER_RUN, "when the error of the base's pose is drawn", choices=(PER_RUN, PER_EPISODE))


class Attempt(NamedTuple):
    """The outcome of a trajectory, which is simulated on arrival and played back in real time.

    Attributes:
        trajectory: motion of the joints and the door, at the knots of the demonstration's rate.
        reward: of the paper, from 0 to 1.
    """

    trajectory: Trajectory
    reward: float

    @property
    def seconds(self) -> float:
        """Duration, seconds."""
        return (len(self.trajectory.door) - 1) / demonstration.RATE


@dataclass(frozen=True)
class Doorway:
    """The state of the robot and the door.

    Attributes:
        attempt: running or over; None while the door is shut and the robot waits.
        elapsed: seconds since the start of the attempt.
        is_halted: whether the attempt was stopped, for good.
        protection: state of the protective stop.
    """

    attempt: Attempt | None = None
    elapsed: float = 0.0
    is_halted: bool = False
    protection: Protection = field(default_factory=lambda: Protection(dict.fromkeys(KINDS, 0)))

    @property
    def is_driven(self) -> bool:
        """Whether an attempt is running."""
        return self.attempt is not None and not self.is_over and not self.is_halted

    @property
    def is_over(self) -> bool:
        """Whether an attempt is complete."""
        return self.attempt is not None and self.elapsed >= self.attempt.seconds

    def heard(self, command: JointCommand, carry_out: Callable[[Motion], Attempt]) -> Doorway:
        """Return the state after a trajectory arrives: a new attempt, or a violation."""
        violation = self._violation(command)
        if violation is not None:
            return self.tripped(*violation)
        if self.protection.is_stopped:
            return self
        return replace(self, attempt=carry_out(motion_of(command)), elapsed=0.0)

    def stepped(self, seconds: float) -> Doorway:
        """Return the state after a time."""
        return replace(self, elapsed=self.elapsed + seconds) if self.is_driven else self

    def tripped(self, kind: str, reason: str) -> Doorway:
        """Return the state after a violation: the robot stands still."""
        return replace(self, is_halted=self.attempt is not None, protection=self.protection.tripped(kind, reason))

    def reset(self) -> Doorway:
        """Return the state with the protective stop reset; a halted attempt does not continue."""
        return replace(self, protection=self.protection.reset())

    def _violation(self, command: JointCommand) -> tuple[str, str] | None:
        if problem := _misshapen(command):
            return "malformed", problem
        times, positions = np.array(command.times), _ordered(command)
        if not np.isfinite(positions).all():
            return "non_finite", "expected finite positions, got nan or infinity"
        if ((positions < LOWER) | (positions > UPPER)).any():
            return "position", "expected positions within the range of each joint, got one outside"
        fastest = np.max(np.abs(np.diff(positions, axis=0)) / np.diff(times)[:, None] / VELOCITY)
        if exceeds(fastest, 1.0):
            return "velocity", f"expected at most the greatest velocity of each joint, got {fastest:.3g} times that"
        away = np.max(np.abs(positions[0, :-1] - demonstration.load().arm[0]))
        if exceeds(away, START):
            return "start", f"expected the first point within {START:g} rad of the arm's position, got {away:.3g}"
        if self.attempt is not None:
            return "not_reset", "expected one trajectory after each reset of the door, got another"
        return None


def motion_of(command: JointCommand) -> Motion:
    """Return the motion of a trajectory, resampled at the rate of the demonstration."""
    times, positions = np.array(command.times), _ordered(command)
    knots = np.arange(round(demonstration.RATE * times[-1]) + 1) / demonstration.RATE
    columns = np.stack([np.interp(knots, times, column) for column in positions.T], axis=1)
    return Motion(columns[:, :-1], columns[:, -1])


def adapted_trajectory(change: Array) -> JointCommand | None:
    """Return the trajectory of a changed demonstration; None if the arm cannot reach it.

    Args:
        change: shift of the tool's y, and change of the opening, in metres, shape (2,).
    """
    shown = demonstration.load()
    motion = adapted(shown, change)
    if motion is None:
        return None
    rows = np.concatenate([motion.arm, motion.openings[:, None]], axis=1)
    return JointCommand(COMMANDED, tuple(shown.times.tolist()), tuple(map(tuple, rows.tolist())))


def choice_of(command: JointCommand) -> tuple[Array, bool] | None:
    """Return a trajectory's first choice, shape (2,), and whether all points equal it; None for other joints."""
    rows = {len(row) for row in command.positions}
    if sorted(command.names) != sorted(CHOSEN) or rows != {len(CHOSEN)}:
        return None
    choices = np.array(command.positions)[:, [command.names.index(name) for name in CHOSEN]]
    return choices[0], bool((choices == choices[0]).all())


def _misshapen(command: JointCommand) -> str:
    if sorted(command.names) != sorted(COMMANDED):
        return f"expected positions of {', '.join(COMMANDED)}, got {', '.join(command.names) or 'no names'}"
    if {len(row) for row in command.positions} != {len(COMMANDED)}:
        return f"expected points of {len(COMMANDED)} positions"
    times = command.times
    if times[0] != 0.0 or not 0.0 < times[-1] <= LONGEST_S or any(np.diff(times) <= 0.0):
        return f"expected increasing times from 0 to at most {LONGEST_S:g} s, got {times[0]:g} to {times[-1]:g}"
    return ""


def _ordered(command: JointCommand) -> Array:
    """Return the positions in the order of `COMMANDED`, shape (k, 8)."""
    return np.array(command.positions)[:, [command.names.index(name) for name in COMMANDED]]
