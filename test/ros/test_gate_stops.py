"""Stops requested on a topic: any quality of service, per publisher, and by silence."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from rkhs_ros.nodes.robot.stop_topic import DEPTH, StopTopic
from test.processes import is_running
from test.ros.conftest import Probe, Process, kill
from test.ros.gate_bench import CALM, Begin, Robot, gates

VOLATILE, LATCHED = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL
RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
SILENCE = 2.0  # seconds


@pytest.fixture
def begin(start: Callable[..., Process], probe: Probe, tmp_path: Path) -> Iterator[Begin]:
    yield from gates(start, probe, tmp_path)


@pytest.fixture
def panel(probe: Probe) -> Iterator[Callable[..., Publisher]]:
    """Make nodes that may request a stop."""
    nodes = []

    def make(name: str, reliability: ReliabilityPolicy = RELIABLE, durability: DurabilityPolicy = LATCHED) -> Publisher:
        nodes.append(Node(name, context=probe.context))
        return nodes[-1].create_publisher(
            Bool, "stop", QoSProfile(depth=1, reliability=reliability, durability=durability)
        )

    yield make
    for node in nodes:
        node.destroy_node()


def say(robot: Robot, panel: Publisher, is_stop: bool) -> None:
    """Say it once the gate listens."""
    robot.probe.until(lambda: panel.get_subscription_count() > 0)
    robot.probe.settle(0.2)  # the gate has found the publisher, too
    panel.publish(Bool(data=is_stop))


def armed_at_last(robot: Robot) -> bool:
    return bool(robot.probe.ask("gate/arm", Trigger.Request()).success)


@pytest.mark.parametrize("reliability", [RELIABLE, BEST_EFFORT])
@pytest.mark.parametrize("durability", [VOLATILE, LATCHED])
def test_a_stop_is_received_for_any_quality_of_service(
    begin: Begin, panel: Callable[..., Publisher], reliability: ReliabilityPolicy, durability: DurabilityPolicy
) -> None:
    _, robot = begin(CALM)
    button = panel("button", reliability, durability)
    assert robot.arm() == "holding"
    say(robot, button, True)
    assert robot.until("stopped").reason == "a stop is requested on the topic 'stop' by /button"
    assert robot.arm() == "cannot arm while a stop is requested on the topic 'stop' by /button"
    button.publish(Bool(data=False))
    robot.probe.until(lambda: armed_at_last(robot))


def test_only_the_requesting_publisher_clears_a_stop(begin: Begin, panel: Callable[..., Publisher]) -> None:
    latched = [panel(name) for name in ("first", "second")]
    latched[0].publish(Bool(data=True))  # before the gate is there
    latched[1].publish(Bool(data=False))
    _, robot = begin(CALM)
    robot.probe.until(lambda: robot.arm().endswith("by /first"))
    for _ in range(3):  # however often another one says that it wants none
        say(robot, latched[1], False)
    robot.probe.settle(0.2)
    assert robot.arm().endswith("by /first")
    latched[1].publish(Bool(data=True))
    robot.probe.until(lambda: robot.arm().endswith("by /first, /second"))
    latched[0].publish(Bool(data=False))
    robot.probe.until(lambda: robot.arm().endswith("by /second"))
    latched[1].publish(Bool(data=False))
    robot.probe.until(lambda: armed_at_last(robot))


def test_a_dead_publisher_neither_clears_its_stop_nor_blocks_the_robot(
    begin: Begin, start: Callable[..., Process], panel: Callable[..., Publisher]
) -> None:
    _, robot = begin(CALM)
    other = panel("other")
    assert robot.arm() == "holding"
    button = start("stopper")
    robot.until("stopped")
    robot.probe.until(lambda: robot.arm().endswith("by /stopper"))
    kill(button.popen.pid)
    robot.probe.until(lambda: not is_running(button.popen.pid))
    say(robot, other, False)
    robot.probe.until(lambda: armed_at_last(robot))  # by a person's word, once its death is known
    robot.probe.settle(0.2)
    assert robot.states[-1].state == "holding"


def test_with_a_timeout_the_silence_of_a_publisher_is_a_stop(begin: Begin, panel: Callable[..., Publisher]) -> None:
    _, robot = begin(CALM | {"stop_timeout": SILENCE})
    silence = "cannot arm while a stop is requested on the topic 'stop' by the silence of {} (stop_timeout 2 s)"
    assert robot.arm() == silence.format("all publishers")
    hearts = [panel(name, BEST_EFFORT) for name in ("heart_a", "heart_b")]
    beating = set(hearts)
    robot.probe.create_timer(SILENCE / 10, lambda: [each.publish(Bool(data=False)) for each in beating])
    robot.probe.until(lambda: robot.arm() == "holding")
    robot.probe.settle(3 * SILENCE)
    assert robot.states[-1].state == "holding"
    beating.remove(hearts[1])
    assert robot.until("stopped").reason.endswith("by the silence of /heart_b (stop_timeout 2 s)")
    assert robot.arm() == silence.format("/heart_b")
    beating.add(hearts[1])
    robot.probe.until(lambda: armed_at_last(robot))


def test_a_full_queue_counts_as_a_request(probe: Probe, panel: Callable[..., Publisher]) -> None:
    """A flood of messages could drop another publisher's request."""
    stops = StopTopic(probe, "stop", 0.0)
    button, flood = panel("button", durability=VOLATILE), panel("flood", durability=VOLATILE)
    for publisher in (button, flood):
        probe.until(lambda publisher=publisher: publisher.get_subscription_count() == 2)  # reliable, and best effort
    button.publish(Bool(data=True))
    for _ in range(2 * DEPTH):
        flood.publish(Bool(data=False))
    assert flood.wait_for_all_acked(Duration(seconds=30))
    assert f"{DEPTH} or more messages" in stops.reason()
