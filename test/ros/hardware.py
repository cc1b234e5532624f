"""A robot with one joint that keeps the newest command for ever, and a sender of commands to its gate."""

import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from rkhs_interfaces.msg import Command, GateState
from rkhs_ros.nodes.core.messages import LATCHED_QOS, LOCKSTEP_QOS

TICK_S, LAG_S, FRICTION = 0.005, 0.02, 0.2  # of the robot: seconds, seconds, 1/s
STREAM_S = 0.02  # between commands
SWING_S = 1.0  # between turns of one who commands to and fro
AT_REST, IN_MOTION, TURNING = "at rest", "in motion", "at a turning point"
MOMENTS = (AT_REST, IN_MOTION, TURNING)
TREES: dict[str, dict[str, Any]] = {
    "effort": {"limits": {"minimum": [-3.0], "maximum": [3.0]}, "hold": {"stiffness": [4.0], "damping": [3.0]}},
    "velocity": {"limits": {"minimum": [-2.0], "maximum": [2.0], "acceleration": [5.0]}},
    "position": {"limits": {"minimum": [-50.0], "maximum": [50.0], "velocity": [2.0], "acceleration": [5.0]}},
}
DRIVES = {"effort": 2.0, "velocity": 1.5, "position": 40.0}


def tree_of(kind: str) -> dict[str, Any]:
    """Return the parameters of a gate of this robot; a busy machine is no reason for it to stop."""
    command = {"topic": "commands", "kind": kind}
    return TREES[kind] | {"joints": ["a"], "command": command, "command_timeout": 2.0, "stale_after": 1.0}


class Hardware:
    """The robot and who commands it, in a thread of their own.

    Owns the joint's motion by the wall clock, and what is done once at a moment of it.

    Attributes:
        track: time, position and velocity of all ticks.
        command: that is kept.
    """

    def __init__(self, domain: int, kind: str) -> None:
        self.kind = kind
        self.track: list[tuple[float, float, float]] = []
        self.states: list[GateState] = []
        self.command = 0.0
        self._moment, self._action = "", lambda: None
        self._is_driven, self._number = False, 0
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = Node("hardware", context=self._context)
        self._joints = self.node.create_publisher(JointState, "joint_states", 5)
        self._commands = self.node.create_publisher(Command, "command", LOCKSTEP_QOS)
        self.node.create_subscription(Float64MultiArray, "commands", self._obey, 1)
        self.node.create_subscription(GateState, "gate/state", self.states.append, LATCHED_QOS)
        self._arm = self.node.create_client(Trigger, "gate/arm")
        self._time, self._position, self._velocity = time.monotonic(), 0.0, 0.0
        self._stream_at = self._begun_at = 0.0
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.node.create_timer(TICK_S, self._tick)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    @property
    def state(self) -> str:
        return self.states[-1].state if self.states else ""

    def arm(self) -> None:
        """Ask until the gate is armed."""
        while self.state not in ("holding", "moving"):
            if self._arm.service_is_ready():
                self._arm.call_async(Trigger.Request())
            time.sleep(0.1)

    def at(self, moment: str, action: Callable[[], object]) -> None:
        """Command the robot, and do something once at a moment of its motion."""
        self._is_driven, self._begun_at = moment != AT_REST, time.monotonic()
        self._moment, self._action = moment, action

    def speed_after(self, moment: float) -> list[float]:
        """Return the magnitudes of the velocity at each tick from then on."""
        return [abs(velocity) for when, _, velocity in list(self.track) if when >= moment]

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _obey(self, message: Float64MultiArray) -> None:
        self.command = message.data[0]

    def _tick(self) -> None:
        now = time.monotonic()
        while self._time < now:
            self._advance(min(TICK_S, now - self._time))
            self._time = min(self._time + TICK_S, now)
        self.track.append((now, self._position, self._velocity))
        message = JointState(name=["a"], position=[self._position], velocity=[self._velocity])
        message.header.stamp = self.node.get_clock().now().to_msg()
        self._joints.publish(message)
        if self._is_driven and now >= self._stream_at:
            self._stream(now)
        if self._moment and self._is_moment(now):
            self._moment = ""
            self._action()

    def _advance(self, seconds: float) -> None:
        if self.kind == "effort":
            self._velocity += seconds * (self.command - FRICTION * self._velocity)
        else:
            aim = self.command if self.kind == "velocity" else (self.command - self._position) / LAG_S
            self._velocity += min(seconds / LAG_S, 1.0) * (aim - self._velocity)
        self._position += seconds * self._velocity

    def _stream(self, now: float) -> None:
        """Command the robot to and fro."""
        self._stream_at, self._number = now + STREAM_S, self._number + 1
        stamp = self.node.get_clock().now().to_msg()
        value = DRIVES[self.kind] * (-1.0 if (now - self._begun_at) % (2 * SWING_S) > SWING_S else 1.0)
        self._commands.publish(Command(instance=7, number=self._number, stamp=stamp, values=[value]))

    def _is_moment(self, now: float) -> bool:
        if self._moment == AT_REST:
            return now > self._begun_at + SWING_S
        if self._moment == IN_MOTION:
            return self._velocity > 1.0
        return now > self._begun_at + SWING_S and self._velocity < 0.01
