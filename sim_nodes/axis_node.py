"""A position controller as a plain ROS 2 node, with a simulated axis: an example of a node whose gains are tuned.

The axis has friction, its motor lags behind the commanded force by 30 ms, and its encoder counts millimetres.
"""

import time
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import rclpy
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from rkhs_ros.rkhs.kernels import Array

PERIOD = 0.01  # of the controller, seconds
SUBSTEPS = 10  # of the simulation in a period
TARGET = 0.2  # height of a step, metres
FORCE = 10.0  # the motor's greatest force, N
LAG = 0.03  # of the force, seconds
COUNT = 0.001  # of the encoder, metres
VISCOUS, DRY, SLIP = 2.0, 1.0, 0.005  # friction in N s/m and N, and the speed in m/s at which it is fully developed
SMOOTHING = 0.3  # weight of the newest difference in the velocity
GAINS = {"p": 20.0, "i": 1.0, "d": 1.0}


@dataclass
class Axis:
    """The axis: its position, velocity and force, with a mass of 1 kg and a payload."""

    payload: float = 0.0
    position: float = 0.0
    velocity: float = 0.0
    force: float = 0.0

    @property
    def sensed(self) -> float:
        """Position as the encoder counts it."""
        return COUNT * round(self.position / COUNT)

    def advance(self, command: float) -> None:
        """Advance by a period with a commanded force."""
        dt = PERIOD / SUBSTEPS
        for _ in range(SUBSTEPS):
            self.force += (np.clip(command, -FORCE, FORCE) - self.force) * dt / LAG
            friction = VISCOUS * self.velocity + DRY * np.tanh(self.velocity / SLIP)
            self.velocity += dt * (self.force - friction) / (1.0 + self.payload)
            self.position += dt * self.velocity


@dataclass
class Controller:
    """A PID controller with a smoothed velocity; its integral waits while the force is at its limit."""

    p: float
    i: float
    d: float
    integral: float = 0.0
    last: float = 0.0
    velocity: float = 0.0

    def command(self, sensed: float) -> float:
        """Return the force for a sensed position."""
        error = TARGET - sensed
        self.velocity += SMOOTHING * ((sensed - self.last) / PERIOD - self.velocity)
        self.last = sensed
        force = self.p * error + self.integral - self.d * self.velocity
        if abs(force) < FORCE or force * error < 0:
            self.integral += self.i * error * PERIOD
        return force


class AxisController(Node):  # type: ignore[misc]  # rclpy has no types
    """The node; the service ``~/step`` starts a step from rest at 0, each with the next payload."""

    def __init__(self) -> None:
        super().__init__("axis_controller")
        allowed = [FloatingPointRange(from_value=0.0, to_value=1000.0)]
        for name, value in GAINS.items():
            self.declare_parameter(name, value, ParameterDescriptor(floating_point_range=allowed))
        self._payloads = self.declare_parameter("payloads", [0.0]).value  # kg, one after another
        self._steps, self._advanced_to = 0, 0.0  # monotonic time, seconds
        self._axis, self._controller, self._command = Axis(), Controller(**GAINS), 0.0
        self._joints = self.create_publisher(JointState, "joint_states", 1)
        self._payload = self.create_publisher(Float64, "payload", 1)
        self.create_service(Trigger, "~/step", self._begin)
        self.create_timer(PERIOD, self._tick)

    def _begin(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._axis = Axis(self._next_payload)
        self._controller = Controller(*(self.get_parameter(name).value for name in GAINS))
        self._steps, self._advanced_to = self._steps + 1, time.monotonic()
        response.success = True
        return response

    @property
    def _next_payload(self) -> float:
        return float(self._payloads[self._steps % len(self._payloads)])

    def _tick(self) -> None:
        while self._steps and self._advanced_to + PERIOD <= time.monotonic():  # a busy machine calls this late
            self._command = self._controller.command(self._axis.sensed)
            self._axis.advance(self._command)
            self._advanced_to += PERIOD
        stamp = self.get_clock().now().to_msg()
        joints = JointState(
            name=["axis"], position=[self._axis.sensed], effort=[float(np.clip(self._command, -FORCE, FORCE))]
        )
        joints.header.stamp = stamp
        self._joints.publish(joints)
        self._payload.publish(Float64(data=self._next_payload))


def reward(times: Array, observed: Array) -> float:
    """Return the negative logarithm of a step's cost, the sum of mean error, overshoot and chatter of the force.

    Costs of bad gains are greater by factors, whose sizes would otherwise hide the differences of good ones. The first
    columns of ``observed`` are position and force.
    """
    position, force = observed[:, 0], observed[:, 1]
    error, overshoot = np.abs(position - TARGET).mean() / TARGET, max(0.0, position.max() - TARGET) / TARGET
    return float(-np.log(error + overshoot + 0.005 * np.abs(np.diff(force)).mean()))


def main() -> None:
    """Run the node."""
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(AxisController())


if __name__ == "__main__":
    main()
