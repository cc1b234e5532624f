"""The node of a simulated robot, a process that behaves like hardware in real time."""

import time
from math import inf
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.time import Time
from std_srvs.srv import Trigger

from rkhs_ros.base.settings import entries
from rkhs_ros.nodes.core.diagnostics import Diagnostics, rivals
from rkhs_ros.nodes.core.messages import LATCHED_QOS, now_by_both_clocks
from rkhs_ros.nodes.core.parameters import declare, declared, given
from rkhs_ros.nodes.core.spin import ReportingNode, run, serve
from sim_nodes.robots import DEFAULT, SETTINGS, settings_of
from sim_nodes.robots.hardware import Hardware, Sample
from sim_nodes.robots.robot import SECOND_PUBLISHER
from sim_nodes.robots.topics import ArmTopics, MotorPendulumTopics, RobotTopics

TOPICS: dict[str, Any] = {"motor_pendulum": MotorPendulumTopics, "arm": ArmTopics}
LEFT_TIMEOUT_S = 4.0  # for the senders of commands to exit, before the node exits
REPORT_PERIOD_S = 0.1  # between reports of violations, and checks of the commands' publishers


class SimulatedRobotNode(ReportingNode):
    """A simulated robot.

    Owns the robot with its wires, and the clock by which it moves. Like hardware, it only has a protective stop, which
    triggers when a limit has already been exceeded, latches until it is reset, and is counted.
    """

    def open(self) -> None:
        """Create the robot and open its topics and services.

        Raises:
            ValueError: an unknown parameter, or an invalid value.
        """
        tree = given(self, needs_section=True)
        name = declared(self, tree, "robot", DEFAULT, f"which robot: {', '.join(SETTINGS)}")
        settings = settings_of(name, tree)
        declare(self, entries(settings))
        self._speed = settings.speed
        self._report_at = 0.0  # monotonic time, seconds
        self._published: tuple[object, ...] = ()
        self._end_at = inf  # monotonic time, seconds; finite once the node has been asked to exit
        self._crowded = ""
        self._topics: RobotTopics = TOPICS[name](self, settings, self._command)
        self._hardware = Hardware(self._topics.robot)
        self._violations = self.create_publisher(DiagnosticStatus, "~/violations", LATCHED_QOS)
        self.diagnostics = Diagnostics(self, self._report)
        self.create_service(Trigger, "~/reset_protective_stop", self._reset)
        self._begin, self._begin_ns = now_by_both_clocks()
        self.get_logger().info(f"{name} is running, at {self._speed:g} times real time")

    def heartbeat(self) -> float:
        """Advance the robot and publish the readings of its sensors; return the seconds until its next event."""
        now = self._now()
        for sample in self._hardware.advance(now):
            self._topics.publish(sample.readings, self._stamp(sample))
        self.diagnostics.steps = self._hardware.steps
        self.diagnostics.stuck = self._topics.robot.state.protection.reason
        self._check_commands()
        wait = max(self._hardware.next_event() - self._now(), 0.0) / self._speed
        return min(wait, self.diagnostics.heartbeat(), REPORT_PERIOD_S)

    def may_end(self) -> bool:
        """Wait until the senders of commands have exited: they need the sensors to bring the robot to rest."""
        now = time.monotonic()
        self._end_at = min(self._end_at, now + LEFT_TIMEOUT_S)
        is_left = not any(self.count_publishers(topic) for topic in self._topics.command_topics)
        return is_left or now >= self._end_at

    def _now(self) -> float:
        """Return the robot's time in seconds."""
        return (time.monotonic() - self._begin) * self._speed

    def _stamp(self, sample: Sample) -> Any:
        """Return the time of a sample by the system clock."""
        return Time(nanoseconds=self._begin_ns + round(1e9 * sample.time / self._speed)).to_msg()

    def _command(self, command: Any) -> None:
        self._hardware.send(self._now(), command)

    def _check_commands(self) -> None:
        """Stop if commands have two publishers; publish violations at once, and other changes periodically."""
        protection = self._topics.robot.state.protection
        now = time.monotonic()
        if now < self._report_at and self._published == (protection.violations, protection.reason):
            return
        before, self._crowded = self._crowded, rivals(self, self._topics.command_topics)
        if self._crowded and not before:
            self._topics.robot.trip(SECOND_PUBLISHER, f"expected one publisher, got {self._crowded}")
        self._publish_report()
        self._report_at = now + REPORT_PERIOD_S

    def _publish_report(self) -> None:
        protection = self._topics.robot.state.protection
        if protection.reason and protection.reason not in self._published:
            self.get_logger().error(f"protective stop: {protection.reason}")
        self._published = (protection.violations, protection.reason)
        self._violations.publish(
            DiagnosticStatus(
                level=DiagnosticStatus.ERROR if protection.is_stopped else DiagnosticStatus.OK,
                name=str(self.get_fully_qualified_name()),
                message=protection.reason,
                values=[KeyValue(key=key, value=str(value)) for key, value in self._hardware.report().items()],
            )
        )

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._crowded:
            response.message = f"expected one publisher, got {self._crowded}"
            return response
        self._topics.robot.reset()
        response.success = True
        return response

    def _report(self) -> dict[str, object]:
        behind = (self._now() - self._hardware.time) / self._speed
        return {**self._hardware.report(), "seconds behind": f"{behind:.3f}"}


def main() -> None:
    """Run the node of a simulated robot."""
    run(SimulatedRobotNode, "simulated_robot", serve)


if __name__ == "__main__":
    main()
