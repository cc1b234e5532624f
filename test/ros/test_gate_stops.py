"""Stops requested on topics: any quality of service, withdrawn requests, one publisher per topic, and silence."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from rkhs_ros.nodes.robot.gate_messages import QOS
from test.processes import is_running
from test.ros.conftest import Probe, Process, kill
from test.ros.gate_bench import CALM, Robot, begin

__all__ = ["begin"]
VOLATILE, LATCHED = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL
RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
SILENCE = 2.0  # seconds
TWO = CALM | {"stop_topics": ["first", "second"]}
BUTTON = "cannot arm while a stop is requested on the topic '/stop' by /button"
Panel, Begin = Callable[..., Publisher], Callable[..., Any]


@pytest.fixture
def panel(probe: Probe) -> Iterator[Panel]:
    with ExitStack() as nodes:

        def make(name: str, topic: str = "stop", **qos: Any) -> Publisher:
            node = Node(name, context=probe.context)
            nodes.callback(node.destroy_node)
            return node.create_publisher(Bool, topic, QoSProfile(**{"depth": 1, "durability": LATCHED} | qos))

        yield make


def met(robot: Robot, panel: Publisher, subscriptions: int) -> None:
    robot.probe.until(lambda: panel.get_subscription_count() == subscriptions)


def say(panel: Publisher, *requests: bool) -> None:
    for is_stop in requests:
        panel.publish(Bool(data=is_stop))


def armed_at_last(robot: Robot) -> bool:
    return bool(robot.probe.ask("gate/arm", Trigger.Request()).success)


@pytest.mark.parametrize(
    ("reliability", "durability", "subscriptions"), [(RELIABLE, LATCHED, 3), (BEST_EFFORT, VOLATILE, 1)]
)
def test_each_request_stops_the_robot_once_even_if_it_is_withdrawn_before_the_gate_runs(
    begin: Begin, panel: Panel, reliability: ReliabilityPolicy, durability: DurabilityPolicy, subscriptions: int
) -> None:
    gate, robot = begin(CALM, process="gate")
    button = panel("button", reliability=reliability, durability=durability, depth=9)
    met(robot, button, subscriptions)
    for stops, requests in enumerate([(True,), (True, False), (True, False, True, False)], start=1):
        robot.probe.until(lambda: armed_at_last(robot))
        robot.until("holding")
        os.kill(gate.popen.pid, signal.SIGSTOP)
        say(button, *requests)
        os.kill(gate.popen.pid, signal.SIGCONT)
        assert robot.until("stopped").reason.startswith("a stop is requested on the topic '/stop' by ")
        assert robot.states[-1].stops == stops
        if requests[-1]:
            robot.probe.until(lambda: robot.arm() == BUTTON)  # once the name of the node is known
            say(button, False)


def test_only_the_publisher_of_a_topic_clears_its_stop(begin: Begin, panel: Panel) -> None:
    first, second = (panel(name, name) for name in TWO["stop_topics"])
    say(first, True)  # before the gate is there
    say(second, False)
    robot = begin(TWO)
    on_first = "cannot arm while a stop is requested on the topic '/first' by /first"
    robot.probe.until(lambda: robot.arm() == on_first)
    say(second, True)
    robot.probe.until(lambda: robot.arm() == f"{on_first}; a stop is requested on the topic '/second' by /second")
    say(second, False)
    robot.probe.until(lambda: robot.arm() == on_first)
    say(first, False)
    robot.probe.until(lambda: armed_at_last(robot))


def test_a_second_publisher_on_a_topic_stops_the_robot_and_clears_no_request(begin: Begin, panel: Panel) -> None:
    robot = begin(CALM)
    button = panel("button")
    met(robot, button, len(QOS))
    assert robot.arm() == "holding"
    other = panel("other")
    say(other, False)
    assert "by more than one publisher: " in robot.until("stopped").reason
    crowd = "cannot arm while a stop is requested on the topic '/stop' by more than one publisher: /button, /other"
    robot.probe.until(lambda: robot.arm() == crowd)
    say(button, True)
    requested = "cannot arm while a stop is requested on the topic '/stop' by /button or /other"
    robot.probe.until(lambda: robot.arm() == requested)
    say(other, False)
    assert robot.arm() == requested
    other.destroy()
    assert robot.arm() == requested

    def cleared() -> bool:  # once the gate knows that the other one has left
        say(button, False)
        return armed_at_last(robot)

    robot.probe.until(cleared)


def test_a_dead_publisher_neither_clears_its_stop_nor_blocks_the_robot(
    begin: Begin, start: Callable[..., Process], panel: Panel
) -> None:
    robot = begin(CALM)
    assert robot.arm() == "holding"
    button = start("sender", "stop")
    robot.until("stopped")
    robot.probe.until(lambda: robot.arm().endswith("by /stopper"))
    kill(button.popen.pid)
    robot.probe.until(lambda: not is_running(button.popen.pid))
    say(panel("stopper"), False)  # restarted, while the dead one is still in the graph
    assert not armed_at_last(robot)
    robot.probe.until(lambda: armed_at_last(robot))  # by a person's word, once its death is known
    robot.until("holding")


def test_with_a_timeout_the_silence_of_a_publisher_is_a_stop(begin: Begin, panel: Panel) -> None:
    robot = begin(TWO | {"stop_timeout": [0.0, SILENCE]})
    silence = "cannot arm while a stop is requested on the topic '/second' by the silence of {} (stop_timeout 2 s)"
    assert robot.arm() == silence.format("all nodes")
    heart = panel("heart", "second", reliability=BEST_EFFORT)
    beating = robot.probe.create_timer(SILENCE / 10, lambda: say(heart, False))
    robot.probe.until(lambda: robot.arm() == "holding")
    robot.probe.settle(1.5 * SILENCE)
    assert robot.states[-1].state == "holding"
    beating.cancel()
    assert robot.until("stopped").reason.endswith("by the silence of /heart (stop_timeout 2 s)")
    assert robot.arm() == silence.format("/heart")
    beating.reset()
    robot.probe.until(lambda: armed_at_last(robot))
