r"""The paper's pendulum with a motor, in real time.

In the task of `sim_nodes.envs.lever_stafford`, an action is two steps of 0.05 s of
:math:`\theta' = \theta + 0.05\,\omega`, :math:`\omega' = \omega + 0.05\,a`, so 0.1 s of :math:`\ddot\theta = a`:
a pendulum without gravity, whose motor turns it with a torque of :math:`a` N m against 1 kg m². Here the same motion is
continuous, with inelastic stops at :math:`\pm\pi`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.policies.streams import stream
from rkhs_ros.rkhs.kernels import Array
from sim_nodes.robots.robot import SECOND_PUBLISHER, JointReadings, Protection, Robot, RobotSettings, exceeds

JOINT = "motor"
KINDS = ("malformed", "non_finite", "torque", "torque_step", "velocity", SECOND_PUBLISHER)
BRAKE = 60.0  # rad/s²: from the greatest velocity to rest in 0.2 s
# The task adds noise of sd 0.04 rad/s to the velocity in each step of 0.05 s. It also adds noise of sd 0.02 rad to the
# angle, which a motor cannot: here noise affects the angle through the velocity only.
PAPER_NOISE = 0.04 / math.sqrt(0.05)


@dataclass(frozen=True)
class MotorLimits(Settings):
    """Limits of the motor's protective stop."""

    torque: float = setting(3.0, "greatest torque, N m", minimum=0.0, maximum=1e3)
    torque_step: float = setting(6.0, "greatest difference of successive commands, N m", minimum=0.0, maximum=2e3)
    velocity: float = setting(4 * math.pi, "greatest velocity, rad/s", minimum=0.0, maximum=1e3)


@dataclass(frozen=True)
class MotorPendulumSettings(RobotSettings):
    """Settings of the pendulum with a motor."""

    process_noise: float = setting(
        PAPER_NOISE, "sd of the velocity noise accumulated in one second, rad/s", minimum=0.0, maximum=100.0
    )
    limits: MotorLimits = MotorLimits()


@dataclass(frozen=True)
class MotorPendulum:
    """The state of the pendulum and its motor."""

    limits: MotorLimits = MotorLimits()
    angle: float = -math.pi  # rad, in [-pi, pi]; 0 is upright
    velocity: float = 0.0  # rad/s
    torque: float = 0.0  # of the motor, N m
    is_driven: bool = False  # whether the motor is on; otherwise its brake is
    protection: Protection = field(default_factory=lambda: Protection(dict.fromkeys(KINDS, 0)))

    def heard(self, command: Sequence[float]) -> MotorPendulum:
        """Return the state after a torque command arrives: the motor applies it, or the protective stop triggers."""
        if (violation := self._violation(command)) is not None:
            return self.tripped(*violation)
        if self.protection.is_stopped:
            return self
        return replace(self, torque=float(command[0]), is_driven=True)

    def stepped(self, seconds: float, kick: float = 0.0) -> MotorPendulum:
        """Return the state after seconds, exact for a constant torque; the motor adds the noise ``kick`` in rad/s."""
        target = self.velocity + self.torque * seconds + kick if self.is_driven else _braked(self.velocity, seconds)
        angle = self.angle + 0.5 * (self.velocity + target) * seconds
        bounded = min(max(angle, -math.pi), math.pi)
        after = replace(self, angle=bounded, velocity=target if bounded == angle else 0.0)
        limit = self.limits.velocity
        if self.is_driven and exceeds(after.velocity, limit):
            return after.tripped("velocity", f"expected at most {limit:g} rad/s, got {after.velocity:g}")
        return after

    def tripped(self, kind: str, reason: str) -> MotorPendulum:
        """Return the state after a violation: the motor is off, the brake is on."""
        return replace(self, torque=0.0, is_driven=False, protection=self.protection.tripped(kind, reason))

    def reset(self) -> MotorPendulum:
        """Return the state with the protective stop reset; the brake holds until the next command."""
        return replace(self, protection=self.protection.reset())

    def _violation(self, command: Sequence[float]) -> tuple[str, str] | None:
        """Return kind and reason of the first limit that a command exceeds; None if there is none."""
        limits = self.limits
        if len(command) != 1:
            return "malformed", f"expected 1 torque, got {len(command)}"
        torque = float(command[0])
        if not math.isfinite(torque):
            return "non_finite", f"expected a finite torque, got {torque}"
        if exceeds(torque, limits.torque):
            return "torque", f"expected at most {limits.torque:g} N m, got {torque:g}"
        # The torque of a stopped motor is not a command, so there is no step to the next one.
        if not self.protection.is_stopped and exceeds(torque - self.torque, limits.torque_step):
            return "torque_step", f"expected at most {limits.torque_step:g} N m from {self.torque:g}, got {torque:g}"
        return None


def upright(before: Array, executed: Array, after: Array) -> float:
    r"""Return :math:`\exp(-\theta^2 / 2)` of the angle before a step, the paper's reward, for robot configurations."""
    return float(np.exp(-0.5 * before[0] ** 2))


def _braked(velocity: float, seconds: float) -> float:
    return math.copysign(max(abs(velocity) - BRAKE * seconds, 0.0), velocity)


class MotorPendulumRobot(Robot):
    """The pendulum as a simulated robot; owns its state and the streams of its noise."""

    def __init__(self, settings: MotorPendulumSettings) -> None:
        super().__init__(settings, MotorPendulum(settings.limits))
        self._kick = settings.process_noise / math.sqrt(settings.rate)
        self._kicks, self._noise = (stream(settings.seed, f"motor_pendulum/{name}", 0) for name in ("kicks", "sensor"))

    def step(self) -> None:
        """Simulate one step of the physics."""
        kick = self._kick * self._kicks.standard_normal()
        self.state = self.state.stepped(1.0 / self.settings.rate, kick)

    def sample(self) -> JointReadings:
        """Return the readings of the sensors."""
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
