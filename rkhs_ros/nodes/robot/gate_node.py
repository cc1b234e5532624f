"""The gate node: the only node that commands the hardware; it enforces limits and stops the robot on faults."""

import time
from functools import partial
from math import inf

import numpy as np
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from rkhs_interfaces.msg import Command, GateReport, GateState
from rkhs_ros.base.processes import lossy_output
from rkhs_ros.base.settings import build, entries
from rkhs_ros.base.validation import truncated
from rkhs_ros.nodes.core.diagnostics import OBSTACLE, PREFIX, UNKNOWN, Diagnostics, Source, full_name, listed
from rkhs_ros.nodes.core.messages import LATCHED_QOS, LOCKSTEP_QOS
from rkhs_ros.nodes.core.parameters import declare, given
from rkhs_ros.nodes.core.spin import ReportingNode, run, serve
from rkhs_ros.nodes.robot.gate_messages import (
    TYPES,
    StopTopics,
    hardware_message,
    report_message,
    seconds_of,
    sensed_of,
)
from rkhs_ros.robot import gate
from rkhs_ros.robot.feedback import stale
from rkhs_ros.robot.gate_settings import GateSettings, rules
from rkhs_ros.robot.gate_state import STOP_REQUESTED, Command as GateCommand, Counts, Gate, Mode
from rkhs_ros.robot.limits import Setpoint
from rkhs_ros.robot.sensors import JOINT_STATE

LAST_OUTPUT_TIMEOUT_S = 0.2  # for the hardware to receive the last output
LATE = 2  # periods between two ticks above which a tick counts as missed
MOST_FAILURES = 3  # of successive ticks, after which the gate can no longer bring the robot to rest
RETRY_S = 1.0  # between attempts of a gate to arm itself
NAMED_S = 2.0  # within which the name of a new node becomes known
SIMULATED = "simulated_robot"  # the node that may receive the commands of a gate that arms itself
HARDWARE_QOS = QoSProfile(depth=1)


class GateNode(ReportingNode):
    """Sends commands to the hardware once per period, within limits and unless there is a fault.

    Owns the gate's state and the topic of the hardware. It is independent of learning, never widens a limit, and only
    an operator arms it, unless its robot is simulated and the settings say so.
    """

    def open(self) -> None:
        """Read the limits, and open topics and services."""
        self._settings = build(GateSettings, given(self, needs_section=True))
        self._rules = rules(self._settings)
        declare(self, entries(self._settings))
        self._state = gate.begin(self._rules)
        self._published: tuple[Mode, str, Counts] | None = None
        self._ticked_at = inf  # monotonic time of the last tick, seconds
        self._longest = 0.0  # seconds between two ticks since the last report
        self._missed = 0  # ticks
        self._failures = 0  # of the last ticks, before their output was sent
        self._end_at = inf  # monotonic time, seconds; finite once the gate has been asked to exit
        self._arm_at = time.monotonic() + RETRY_S  # of a gate that arms itself
        self._has_armed_itself = False
        self._unknown_since = inf  # monotonic time, seconds, of a listener whose name is not known
        self._waits_for_a_person = False  # since a stop was requested
        self._flaw = ""  # of the last joint state
        self._obstacle = ""  # last reported by the robot node
        self._open_topics()
        self.diagnostics = Diagnostics(self, self._report)
        self._turn(self._state)
        self.get_logger().info(f"ready to be armed for {', '.join(self._settings.joints)}; sends nothing until then")

    def heartbeat(self) -> float:
        """Send a due output to the hardware, and report; return the seconds until the next output."""
        now = time.monotonic()
        if now >= self._state.due:
            self._tick(now)
            if self._settings.arms_itself:
                self._arm_itself(now)
        return max(min(self.diagnostics.heartbeat(), self._state.due - time.monotonic()), 0.0)

    def may_end(self) -> bool:
        """Stop the robot before the process exits; return whether it is at rest, or cannot come to rest in time."""
        now = time.monotonic()
        self._end_at = min(self._end_at, now + self._settings.rest.timeout)
        if self._failures >= MOST_FAILURES:  # its state may be damaged, too
            self._send_last(self._state)
            return True
        state, is_left = gate.leave(self._state, self._rules, now)
        is_over = is_left or now >= self._end_at
        if is_over:
            self._send_last(state)
        self._turn(state)
        return is_over

    def _send_last(self, state: Gate) -> None:
        self._send(gate.last_output(state, self._rules))
        self._hardware.wait_for_all_acked(Duration(seconds=LAST_OUTPUT_TIMEOUT_S))

    def _open_topics(self) -> None:
        command, sensor = self._settings.command, self._settings.sensor
        self._hardware = self.create_publisher(TYPES[command.type], command.topic, HARDWARE_QOS)
        self._reports = self.create_publisher(GateReport, "gate/report", LOCKSTEP_QOS)
        self._states = self.create_publisher(GateState, "gate/state", LATCHED_QOS)
        self.create_subscription(Command, "command", self._command, LOCKSTEP_QOS)
        self._source: Source | None = None
        if sensor.topic:
            self._source = Source(self, sensor.topic, JOINT_STATE, self._settings.stale_after)
            self.create_subscription(
                JointState, sensor.topic, partial(self._sense, self._source), qos_profile_sensor_data
            )
        self.create_subscription(String, OBSTACLE, self._hear_obstacle, LATCHED_QOS)
        self._stops = StopTopics(self, self._settings.stop_timeouts(), self._check_stops)
        self.create_service(Trigger, "~/arm", self._arm)
        self.create_service(Trigger, "~/stop", self._stop)

    def _turn(self, state: Gate) -> None:
        """Set the state, and publish it if mode, reason or counters have changed."""
        self._state, visible = state, (state.mode, state.reason, state.counts)
        if visible == self._published:
            return
        is_new = self._published is None or self._published[0] != Mode.STOPPED
        if state.mode == Mode.STOPPED and is_new and not state.is_shutting_down:
            self.get_logger().error(f"stopped: {state.reason}")
        self.diagnostics.stopped = state.reason
        self._states.publish(GateState(state=str(state.mode), reason=state.reason, **vars(state.counts)))
        self._published = visible

    def _tick(self, now: float) -> None:
        """Send an output first, so that no later failure prevents it; then check stops and other publishers."""
        self._failures += 1
        state, output = gate.ticked(self._state, self._rules, now)
        self._send(state.motion if output is not None else None)
        self._failures = 0
        self._turn(state)
        wait, self._ticked_at = now - self._ticked_at, now
        self._longest = max(self._longest, wait)
        self._missed += wait > LATE * self._settings.period
        self.diagnostics.steps += 1
        self._check_stops()
        if rivals := self._rivals():
            self._turn(gate.stopped(self._state, rivals))

    def _send(self, output: Setpoint | None) -> None:
        """Send an output to the hardware, if there is one."""
        if output is not None:
            self._hardware.publish(hardware_message(self._settings, self._rules.limits, output))

    def _command(self, message: Command) -> None:
        now = time.monotonic()
        values = None if message.hold else np.array(message.values)
        command = GateCommand(message.instance, message.number, seconds_of(message.stamp), values)
        state, report = gate.commanded(self._state, self._rules, now, command)
        self._reports.publish(report_message(message, report))
        if report.reason:
            self.diagnostics.refuse(report.reason)
        self._turn(state)

    def _sense(self, source: Source, message: JointState) -> None:
        now = time.monotonic()
        source.hear()
        try:
            news = sensed_of(message, self._settings.joints)
        except ValueError as error:  # for example from a robot whose arms publish separately
            self._flaw = str(error)
            self.diagnostics.skip(f"joint state: {error}")
            return
        state, reason = gate.sensed(self._state, self._rules, now, news)
        self._flaw = reason
        if reason:
            self.diagnostics.refuse(reason)
        self._turn(state)

    def _hear_obstacle(self, message: String) -> None:
        self._obstacle = truncated(message.data)

    def _joints_line(self) -> str:
        is_stale = stale(self._state, self._rules, time.monotonic())
        return self._source.line(self._flaw if is_stale else "") if self._source else "not needed"

    def _check_stops(self) -> None:
        reason = self._stops.reason()
        self._waits_for_a_person |= bool(reason) and self._state.is_armed  # before, a heartbeat may not have come yet
        self._turn(gate.stop_requested(self._state, reason))

    def _rivals(self) -> str:
        """Return an error message if another node publishes to the hardware; empty otherwise."""
        topic = self._settings.command.topic
        return f"expected no other publisher, got {listed(self, topic)}" if self.count_publishers(topic) > 1 else ""

    def _arm(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._stops.drop_departed()
        self._check_stops()
        response.message = self._try_to_arm()
        response.success = not response.message
        if response.success:
            self._has_armed_itself = self._waits_for_a_person = False
            response.message = str(self._state.mode)
        return response

    def _try_to_arm(self) -> str:
        """Arm the gate; return why it cannot be armed, empty if it is."""
        state, reason = gate.armed(self._state, self._rules, time.monotonic())
        if reason:
            self._turn(state)
        if reason and (stale(state, self._rules, time.monotonic()) or state.contradiction):
            reason += f"; {self._joints_line()}"
        if not reason and state.mode != self._state.mode and self._obstacle and self.count_publishers(OBSTACLE):
            reason = f"cannot arm while the robot node cannot use its sensors: {self._obstacle}"
        reason = self._rivals() or reason
        if not reason:
            self._turn(state)
            self.get_logger().warning("armed: the robot may move")
        return reason

    def _arm_itself(self, now: float) -> None:
        """Arm the gate if its robot is simulated and no stop was requested; disarm it once others listen, too.

        A position at which the simulated robot rests may be far from that of another robot. After a stop it waits, so
        that requests to stop that are under way arrive first.
        """
        topic, stands = self._settings.command.topic, self._state.mode in (Mode.DISARMED, Mode.STOPPED)
        listeners = self.get_subscriptions_info_by_topic(self.resolve_topic_name(topic))
        others = sorted({full_name(each) for each in listeners if not _is_simulated(each.node_name)})
        expected = f"arms_itself: expected only simulated robots on {topic}, got {', '.join(others)}" if others else ""
        self.diagnostics.waiting = expected if stands else ""
        names = {each.node_name for each in listeners}
        self._unknown_since = min(self._unknown_since, now) if UNKNOWN in names else inf
        is_foreign = now - self._unknown_since > NAMED_S or any(not _is_simulated(name) for name in names - {UNKNOWN})
        if is_foreign and self._has_armed_itself and self._state.is_armed:
            self._send(gate.last_output(self._state, self._rules))
            self._turn(gate.disarmed(self._state, expected))
        if stands and now < self._arm_at:
            return
        self._arm_at = now + RETRY_S
        if stands and listeners and not others and not self._waits_for_a_person:
            self._has_armed_itself = not self._try_to_arm()

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._waits_for_a_person = True
        self._turn(gate.stopped_by_operator(self._state, f"{STOP_REQUESTED} by the service 'stop'"))
        response.success, response.message = True, str(self._state.mode)
        return response

    def _report(self) -> dict[str, object]:
        longest, self._longest = self._longest, 0.0
        return {
            "state": str(self._state.mode),
            **vars(self._state.counts),
            "worst loop rate": f"{1.0 / longest:.1f}" if longest else "",
            "missed ticks": self._missed,
            PREFIX + "joints": self._joints_line(),
        }


def _is_simulated(name: str) -> bool:
    """Return whether a node's name is that of a simulated robot or of an observer, such as `ros2 topic echo`."""
    return name == SIMULATED or (name.startswith("_") and name != UNKNOWN)


def main() -> None:
    """Run the gate node, which no terminal may block."""
    with lossy_output():
        run(GateNode, "gate", serve)


if __name__ == "__main__":
    main()
