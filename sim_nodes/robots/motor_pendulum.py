r"""The paper's pendulum with a motor, by the wall clock.

The task of `sim_nodes.envs.pendulum` makes of an action two steps of 0.05 s of
:math:`\theta' = \theta + 0.05\,\omega`, :math:`\omega' = \omega + 0.05\,a`, so 0.1 s of :math:`\ddot\theta = a`:
a pendulum without gravity, whose motor turns it with a torque of :math:`a` N m against 1 kg m². Here this goes on all
the time, between stops at :math:`\pm\pi`, which take the velocity away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.policies.streams import stream
from sim_nodes.robots.joints import JointReadings
from sim_nodes.robots.protection import COMMAND_TIMEOUT, SECOND_PUBLISHER, Protection, exceeds
from sim_nodes.robots.robot import Robot, RobotSettings

JOINT = "motor"
KINDS = ("malformed", "non_finite", "torque", "torque_step", "velocity", SECOND_PUBLISHER, COMMAND_TIMEOUT)
BRAKE = 60.0  # rad/s²: from the greatest velocity to rest in 0.2 s
# The task kicks the velocity by 0.04 rad/s in each step of 0.05 s. It kicks the angle as well, by 0.02 rad, which a
# motor cannot: the angle is kicked by way of the velocity only.
PAPER_NOISE = 0.04 / math.sqrt(0.05)


@dataclass(frozen=True)
class MotorLimits(Settings):
    """What the motor's own supervision lets pass; beyond any of it the motor stops."""

    torque: float = setting(3.0, "greatest torque, N m", minimum=0.0, maximum=1e3)
    torque_step: float = setting(6.0, "greatest change from one command to the next, N m", minimum=0.0, maximum=2e3)
    velocity: float = setting(4 * math.pi, "greatest velocity, rad/s", minimum=0.0, maximum=1e3)


@dataclass(frozen=True)
class MotorPendulumSettings(RobotSettings):
    """The pendulum with a motor."""

    process_noise: float = setting(
        PAPER_NOISE, "sd of the velocity that the motor's noise adds in a second, rad/s", minimum=0.0, maximum=100.0
    )
    limits: MotorLimits = MotorLimits()


@dataclass(frozen=True)
class MotorPendulum:
    """The pendulum's state, and that of its motor.

    Attributes:
        limits: of the motor.
        angle: rad, in [-pi, pi]; 0 is upright.
        velocity: rad/s.
        torque: that the motor gives, N m.
        is_driven: the motor is on; else its brake is.
        protection: what its supervision saw.
    """

    limits: MotorLimits = MotorLimits()
    angle: float = -math.pi
    velocity: float = 0.0
    torque: float = 0.0
    is_driven: bool = False
    protection: Protection = field(default_factory=lambda: Protection(dict.fromkeys(KINDS, 0)))

    @property
    def energy(self) -> float:
        """Kinetic energy, J; there is no other."""
        return 0.5 * self.velocity**2

    def heard(self, command: Sequence[float]) -> MotorPendulum:
        """Return what becomes of it by a command of one torque: it is given, or trips the protective stop."""
        violation = self._violation(command)
        if violation is not None:
            return self.tripped(*violation)
        if self.protection.is_stopped:
            return self
        return replace(self, torque=float(command[0]), is_driven=True)

    def stepped(self, seconds: float, kick: float = 0.0) -> MotorPendulum:
        """Return where it is after a time, exactly for a constant torque.

        Args:
            seconds: the time.
            kick: of the motor's noise to the velocity, rad/s; the brake takes none.
        """
        target = self.velocity + self.torque * seconds + kick if self.is_driven else _braked(self.velocity, seconds)
        angle = self.angle + 0.5 * (self.velocity + target) * seconds
        bounded = min(max(angle, -math.pi), math.pi)
        after = replace(self, angle=bounded, velocity=target if bounded == angle else 0.0)
        limit = self.limits.velocity
        if self.is_driven and exceeds(after.velocity, limit):
            return after.tripped("velocity", f"expected at most {limit:g} rad/s, got {after.velocity:g}")
        return after

    def tripped(self, kind: str, reason: str) -> MotorPendulum:
        """Return what it is after a violation: the motor off, the brake on."""
        return replace(self, torque=0.0, is_driven=False, protection=self.protection.tripped(kind, reason))

    def reset(self) -> MotorPendulum:
        """Return what it is without its protective stop; the brake holds until the next command."""
        return replace(self, protection=self.protection.reset())

    def _violation(self, command: Sequence[float]) -> tuple[str, str] | None:
        """Return kind and reason of the first limit that a command breaks."""
        limits = self.limits
        if len(command) != 1:
            return "malformed", f"expected 1 torque, got {len(command)}"
        torque = float(command[0])
        if not math.isfinite(torque):
            return "non_finite", f"expected a finite torque, got {torque}"
        if exceeds(torque, limits.torque):
            return "torque", f"expected at most {limits.torque:g} N m, got {torque:g}"
        # While it is stopped, what the motor gives is no command's, and has no step to the next one.
        if not self.protection.is_stopped and exceeds(torque - self.torque, limits.torque_step):
            return "torque_step", f"expected at most {limits.torque_step:g} N m from {self.torque:g}, got {torque:g}"
        return None


def _braked(velocity: float, seconds: float) -> float:
    return math.copysign(max(abs(velocity) - BRAKE * seconds, 0.0), velocity)


class MotorPendulumRobot(Robot[MotorPendulum]):
    """The pendulum as a robot.

    Owns its state and the streams of its noise.

    Args:
        settings: of it.
    """

    def __init__(self, settings: MotorPendulumSettings) -> None:
        super().__init__(settings, MotorPendulum(settings.limits))
        self._kick = settings.process_noise / math.sqrt(settings.rate)
        self._kicks, self._noise = (stream(settings.seed, f"motor_pendulum/{name}", 0) for name in ("kicks", "sensor"))

    def hear(self, command: Sequence[float]) -> None:
        """Take a torque in N m."""
        self.state = self.state.heard(command)

    def step(self) -> None:
        """Move by one step of the physics."""
        kick = self._kick * self._kicks.standard_normal()
        self.state = self.state.stepped(1.0 / self.settings.rate, kick)

    def sample(self) -> JointReadings:
        """Return what the sensors read."""
        settings, state = self.settings, self.state
        position, velocity = self._noise.standard_normal(2) * (settings.position_noise, settings.velocity_noise)
        return JointReadings((JOINT,), (state.angle + position,), (state.velocity + velocity,), (state.torque,))

    def description(self) -> str:
        """Return the robot's URDF: a rod, upright at angle zero."""
        return URDF.format(torque=self.state.limits.torque, velocity=self.state.limits.velocity)


URDF = """<?xml version="1.0"?>
<robot name="motor_pendulum">
<material name="steel"><color rgba="0.35 0.38 0.42 1"/></material>
<material name="rod"><color rgba="0.12 0.47 0.71 1"/></material>
<link name="stand">
<visual><origin xyz="0 0.06 0" rpy="1.5707963 0 0"/><geometry><cylinder radius="0.05" length="0.1"/></geometry>
<material name="steel"/></visual>
</link>
<link name="pendulum">
<inertial><origin xyz="0 0 1"/><mass value="1"/>
<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>
<visual><origin xyz="0 0 0.5"/><geometry><box size="0.04 0.02 1"/></geometry><material name="rod"/></visual>
</link>
<joint name="motor" type="revolute">
<parent link="stand"/><child link="pendulum"/><axis xyz="0 1 0"/>
<limit lower="-3.141592653589793" upper="3.141592653589793" effort="{torque}" velocity="{velocity}"/>
</joint>
</robot>
"""
