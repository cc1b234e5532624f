"""The PR2 before its door, by the wall clock: one trajectory is one attempt to open it."""

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
START = 0.5  # rad that the first point may be off the place where the arm waits, to which it goes at once
LONGEST_S = 30.0  # of an attempt
TRAJECTORIES, CHOICES = "joint_trajectory_controller", "door_controller"
CHOSEN = ("shift", "opening")  # m: how the demonstration is changed; joints to those who choose
PER_RUN, PER_EPISODE = "per_run", "per_episode"


@dataclass(frozen=True)
class DoorSettings(RobotSettings):
    """The PR2's door."""

    rate: float = setting(
        100.0, "steps at which time goes on, Hz; of the physics there are more", minimum=1.0, maximum=1e4
    )
    sensor_rate: float = setting(20.0, "joint states, Hz; at most the rate", minimum=1.0, maximum=1e4)
    position_noise: float = setting(0.0, "sd of a sensed position, rad", minimum=0.0, maximum=1.0)
    velocity_noise: float = setting(0.0, "sd of a sensed velocity, rad/s", minimum=0.0, maximum=10.0)
    controller: str = setting(
        TRAJECTORIES, "which takes commands: whole motions, or the choice of one", choices=(TRAJECTORIES, CHOICES)
    )
    pose: str = setting(PER_RUN, "when the error of the base's pose is drawn", choices=(PER_RUN, PER_EPISODE))


class Attempt(NamedTuple):
    """What came of a trajectory: it is carried out when it is heard, and shown as time goes by.

    Attributes:
        trajectory: what the joints and the door did, at the knots of the demonstration's rate.
        reward: of the paper, from 0 to 1.
    """

    trajectory: Trajectory
    reward: float

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return (len(self.trajectory.door) - 1) / demonstration.RATE


@dataclass(frozen=True)
class Doorway:
    """The state of the robot and the door.

    Attributes:
        attempt: under way or over; None where the door is shut and the robot waits.
        elapsed: since its beginning, s.
        is_halted: the attempt was stopped in its course, for good.
        protection: what the supervision saw.
    """

    attempt: Attempt | None = None
    elapsed: float = 0.0
    is_halted: bool = False
    protection: Protection = field(default_factory=lambda: Protection(dict.fromkeys(KINDS, 0)))

    @property
    def is_driven(self) -> bool:
        """Whether an attempt is under way."""
        return self.attempt is not None and not self.is_over and not self.is_halted

    @property
    def is_over(self) -> bool:
        """Whether an attempt was made to its end."""
        return self.attempt is not None and self.elapsed >= self.attempt.seconds

    def heard(self, command: JointCommand, carry_out: Callable[[Motion], Attempt]) -> Doorway:
        """Return what becomes of it by a trajectory: an attempt, or a violation."""
        violation = self._violation(command)
        if violation is not None:
            return self.tripped(*violation)
        if self.protection.is_stopped:
            return self
        return replace(self, attempt=carry_out(motion_of(command)), elapsed=0.0)

    def stepped(self, seconds: float) -> Doorway:
        """Return what it is after a time."""
        return replace(self, elapsed=self.elapsed + seconds) if self.is_driven else self

    def tripped(self, kind: str, reason: str) -> Doorway:
        """Return what it is after a violation: the robot stands still."""
        return replace(self, is_halted=self.attempt is not None, protection=self.protection.tripped(kind, reason))

    def reset(self) -> Doorway:
        """Return what it is without its protective stop; what was halted stays so until the door is shut."""
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
            return "velocity", f"expected at most the greatest velocity of each joint, got {fastest:.3g} times it"
        away = np.max(np.abs(positions[0, :-1] - demonstration.load().arm[0]))
        if exceeds(away, START):
            return "start", f"expected the first point within {START:g} rad of where the arm waits, got {away:.3g}"
        if self.attempt is not None:
            return "not_reset", "expected one trajectory after each reset of the door, got another"
        return None


def motion_of(command: JointCommand) -> Motion:
    """Return the motion that a trajectory asks for, at the knots of the demonstration's rate."""
    times, positions = np.array(command.times), _ordered(command)
    knots = np.arange(round(demonstration.RATE * times[-1]) + 1) / demonstration.RATE
    columns = np.stack([np.interp(knots, times, column) for column in positions.T], axis=1)
    return Motion(columns[:, :-1], columns[:, -1])


def adapted_trajectory(change: Array) -> JointCommand | None:
    """Return the trajectory for a change of the demonstration; None where the arm cannot reach that far.

    Args:
        change: metres by which the tool's y is shifted, and by which the opening is changed, shape (2,).
    """
    shown = demonstration.load()
    motion = adapted(shown, change)
    if motion is None:
        return None
    rows = np.concatenate([motion.arm, motion.openings[:, None]], axis=1)
    return JointCommand(COMMANDED, tuple(shown.times.tolist()), tuple(map(tuple, rows.tolist())))


def choice_of(command: JointCommand) -> tuple[Array, bool] | None:
    """Return the choice that a trajectory begins with, shape (2,), and whether it stays; None where it is of others."""
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
        return f"expected increasing times from 0 to {LONGEST_S:g} s at most, got {times[0]:g} to {times[-1]:g}"
    return ""


def _ordered(command: JointCommand) -> Array:
    """Return the positions in the order of `COMMANDED`, shape (k, 8)."""
    return np.array(command.positions)[:, [command.names.index(name) for name in COMMANDED]]
