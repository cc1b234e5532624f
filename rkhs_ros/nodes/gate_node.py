"""The gate node: the only one that commands the hardware, within limits, and stops it when something is amiss."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

from rclpy.duration import Duration
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from rkhs_interfaces.msg import Command, GateReport, GateState
from rkhs_ros.base.settings import build, entries
from rkhs_ros.nodes.arguments import require_section
from rkhs_ros.nodes.diagnostics import STOP, Diagnostics
from rkhs_ros.nodes.gate_messages import (
    TYPES,
    JointStates,
    command_of,
    hardware_message,
    report_message,
    state_message,
)
from rkhs_ros.nodes.messages import LATCHED_QOS, LOCKSTEP_QOS
from rkhs_ros.nodes.parameters import declare, given, instance, restarts
from rkhs_ros.nodes.publishers import listed, publishers
from rkhs_ros.nodes.spin import ReportingNode, run, serve
from rkhs_ros.nodes.uniqueness import Uniqueness
from rkhs_ros.robot.gate import armed, begin, commanded, is_at_rest, sensed, stop_asked, stopped, ticked
from rkhs_ros.robot.gate_settings import GateSettings, rules
from rkhs_ros.robot.gate_state import STOP_ASKED, Counts, Gate, Mode

STOP_TIMEOUT_S = 1.5  # to come to rest in before the process ends; a launcher kills it after 2
LAST_OUTPUT_TIMEOUT_S = 0.2  # for the hardware to take the last output
LATE = 2  # periods between ticks from which one is missed
HARDWARE_QOS = QoSProfile(depth=1)


@dataclass
class Loop:
    """Counts the ticks of a loop since it was last asked, and those missed since it began."""

    period: float
    last: float | None = None
    seconds: float = 0.0
    ticks: int = 0
    worst: float = 0.0
    missed: int = 0

    def tick(self, now: float) -> None:
        """Count a tick."""
        if self.last is not None:
            wait = now - self.last
            self.seconds, self.ticks, self.worst = self.seconds + wait, self.ticks + 1, max(self.worst, wait)
            self.missed += wait > LATE * self.period
        self.last = now

    def report(self) -> dict[str, object]:
        """Return the rates since the last report: mean, and of the longest wait."""
        mean, worst = self.ticks / max(self.seconds, 1e-9), 1.0 / self.worst if self.worst else 0.0
        self.seconds, self.ticks, self.worst = 0.0, 0, 0.0
        return {"loop rate": f"{mean:.1f}", "worst loop rate": f"{worst:.1f}", "missed ticks": self.missed}


class GateNode(ReportingNode):
    """Passes commands on to the hardware, once a period, as far as limits and faults allow.

    Owns the gate's state and the topic of the hardware. Does not own what is commanded: it knows nothing of learning,
    raises no limit, and is armed by a person only.
    """

    def __init__(self) -> None:
        super().__init__("gate")

    def open(self) -> None:
        """Declare the parameters and open topics and services.

        Raises:
            ValueError: an unknown parameter, or limits that are missing or do not fit.
        """
        require_section(self.get_fully_qualified_name(), sys.argv)
        tree = given(self)
        again, number = restarts(self, tree), instance(self, tree)
        self._settings = build(GateSettings, tree)
        self._rules = rules(self._settings)
        declare(self, (entry for entry in entries(self._settings) if entry.value != ()))
        self._state = begin(self._rules)
        self._told: tuple[Mode, str, Counts] | None = None
        self._loop = Loop(self._settings.period)
        self._joints = JointStates(self._settings.joints)
        self._end_at: float | None = None
        self._open_topics()
        self.diagnostics = Diagnostics(self, again, self._report, ["command", self._settings.command.topic])
        self._uniqueness = Uniqueness(self, number)
        self._turn(self._state)
        self.get_logger().info(f"ready to be armed for {', '.join(self._settings.joints)}; sends nothing before")

    def heartbeat(self) -> float:
        """Send what is due to the hardware, and report; return the seconds until the next output."""
        now = time.monotonic()
        if now >= self._state.due:
            self._tick(now)
        self._uniqueness.check()
        return max(min(self.diagnostics.heartbeat(), self._state.due - time.monotonic()), 0.0)

    def may_end(self) -> bool:
        """Stop the robot before the process ends; return whether it is at rest, or takes too long."""
        now = time.monotonic()
        if self._end_at is None:
            self._end_at = now + STOP_TIMEOUT_S
            self._turn(stopped(self._state, "the gate was told to end"))
        if not is_at_rest(self._state, self._rules) and now < self._end_at:
            return False
        self._hardware.wait_for_all_acked(Duration(seconds=LAST_OUTPUT_TIMEOUT_S))
        return True

    def _open_topics(self) -> None:
        command, sensor = self._settings.command, self._settings.sensor
        self._hardware = self.create_publisher(TYPES[command.type], command.topic, HARDWARE_QOS)
        self._reports = self.create_publisher(GateReport, "gate/report", LOCKSTEP_QOS)
        self._states = self.create_publisher(GateState, "gate/state", LATCHED_QOS)
        self.create_subscription(Command, "command", self._command, LOCKSTEP_QOS)
        if sensor.topic:
            self.create_subscription(JointState, sensor.topic, self._sense, qos_profile_sensor_data)
        for qos in (LATCHED_QOS, QoSProfile(depth=1)):  # a latched subscription hears no publisher that is not
            self.create_subscription(Bool, "stop", self._hear_stop, qos)
        self.create_service(Trigger, "~/arm", self._arm)
        self.create_service(Trigger, "~/stop", self._stop)

    def _turn(self, state: Gate) -> None:
        """Go on to a state, and tell it where something of it is new."""
        self._state, told = state, (state.mode, state.reason, state.counts)
        if told == self._told:
            return
        is_new = self._told is None or self._told[0] != Mode.STOPPED
        if state.mode == Mode.STOPPED and is_new and self._end_at is None:
            self.get_logger().error(f"stopped: {state.reason}")
            self.diagnostics.tell(STOP, state.reason)
        self.diagnostics.stuck = state.reason
        self._states.publish(state_message(state))
        self._told = told

    def _tick(self, now: float) -> None:
        state, output = ticked(self._state, self._rules, now)
        if output is not None and state.motion is not None:
            self._hardware.publish(hardware_message(self._settings, self._rules.limits, state.motion))
        self._turn(state)
        self._loop.tick(now)
        self.diagnostics.steps += 1

    def _command(self, message: Command) -> None:
        now = time.monotonic()
        state, report = commanded(self._state, self._rules, now, command_of(message))
        self._reports.publish(report_message(message, report))
        if report.reason:
            self.diagnostics.refuse(f"a command: {report.reason}")
        self._turn(state)

    def _sense(self, message: JointState) -> None:
        now = time.monotonic()
        try:
            news = self._joints.sensed_of(message)
        except ValueError as error:  # from others than ours, as where each arm of a robot tells of itself
            self.diagnostics.pass_over(f"what was sensed: {error}")
            return
        state, reason = sensed(self._state, self._rules, now, news)
        if reason:
            self.diagnostics.refuse(f"what was sensed: {reason}")
        self._turn(state)

    def _hear_stop(self, message: Bool) -> None:
        self._turn(stop_asked(self._state, message.data, f"{STOP_ASKED} on the topic 'stop'"))

    def _arm(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        topic = self._settings.command.topic
        others = len(publishers(self, topic)) > 1  # of another name; a gate that was killed is seen for some seconds
        state, reason = armed(self._state, self._rules, time.monotonic())
        if reason and self.diagnostics.last_refusal:
            reason += f"; last refused or passed over: {self.diagnostics.last_refusal}"
        response.message = f"expected no other publisher, got {listed(self, topic)}" if others else reason
        response.success = not response.message
        if response.success:
            self._turn(state)
            response.message = str(self._state.mode)
            self.get_logger().warning("armed: the robot may move")
        return response

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._turn(stopped(self._state, f"{STOP_ASKED} by the service 'stop'"))
        response.success, response.message = True, str(self._state.mode)
        return response

    def _report(self) -> dict[str, object]:
        return {"state": str(self._state.mode), **vars(self._state.counts), **self._loop.report()}


def main() -> None:
    """Run the gate node."""
    run(GateNode, "gate", serve)


if __name__ == "__main__":
    main()
