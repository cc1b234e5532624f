"""The simulator node publishes a task's robot for viewers, if requested."""

import xml.etree.ElementTree as ET
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile

from rkhs_interfaces.msg import Action
from rkhs_interfaces.srv import StartEpisodes
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.simulation import Simulation
from test.ros.conftest import PATIENCE, Probe, Process

pytest.importorskip("pybullet", reason="PyBullet is not installed")

from sensor_msgs.msg import JointState
from std_msgs.msg import String

Start = Callable[..., Process]
TASK = "rkhs/PR2Door-v0"
ACTIONS = np.array([[-0.03, -0.02], [0.01, 0.0]])
PERIOD = 50_000_000  # ns


class Viewer:
    """What a viewer hears, who came before or after the node."""

    def __init__(self, probe: Probe) -> None:
        self.states: list[Any] = []
        self.descriptions: list[Any] = []
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.listeners = [
            probe.create_subscription(JointState, "joint_states", self.states.append, QoSProfile(depth=512)),
            probe.create_subscription(String, "robot_description", self.descriptions.append, latched),
        ]


def begin(start: Start, probe: Probe, *parameters: str) -> None:
    given = [word for parameter in (f"environment.id:={TASK}", *parameters) for word in ("-p", parameter)]
    start("simulator", "--ros-args", *given)
    probe.meet("observation")
    probe.speak("action")


def play(probe: Probe, batch: int) -> None:
    numbers = {"batch": batch, "policy_version": 1, "seed": 3, "first_episode": 5, "num_envs": 2, "horizon": 1}
    request = StartEpisodes.Request(environment=TASK, options="{}", explore=True, **numbers)
    probe.until(lambda: probe.ask("start_episodes", request).success)  # once the nodes have met
    probe.say("action", Action(batch=batch, step=0, policy_version=1, actions=array("d", ACTIONS.ravel())))
    probe.until(lambda: [m for m in probe.heard["episodes"] if m.batch == batch] != [])


def stamps(states: list[Any]) -> np.ndarray:
    return np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in states])


def test_the_robots_description_and_motions_are_published(start: Start, probe: Probe) -> None:
    early = Viewer(probe)
    begin(start, probe, "robot_state:=true")
    probe.until(lambda: all(probe.count_publishers(listener.topic_name) == 1 for listener in early.listeners))
    assert early.states == []
    before = probe.get_clock().now().nanoseconds
    play(probe, batch=1)
    simulation = Simulation(TASK)
    simulation.start(Batch(3, 5, 2, 1, explore=True))
    simulation.step(ACTIONS)
    expected = simulation.joint_states()
    assert expected is not None
    knots = len(expected.positions)
    probe.until(lambda: len(early.states) >= knots)
    play(probe, batch=2)  # while the first one is shown
    probe.settle(knots * PERIOD / 1e9)
    assert len(early.states) == knots
    later = probe.get_clock().now().nanoseconds
    play(probe, batch=3)
    probe.until(lambda: len(early.states) >= 2 * knots)
    probe.settle()
    assert len(early.states) == 2 * knots
    np.testing.assert_array_equal([m.position for m in early.states], np.tile(expected.positions, (2, 1)))
    assert {tuple(m.name) for m in early.states} == {expected.names}
    for times, asked in zip(np.split(stamps(early.states), 2), (before, later), strict=True):
        assert asked <= times[0] <= asked + PATIENCE * 1e9
        assert np.all(np.diff(times) == PERIOD)

    late = Viewer(probe)
    probe.until(lambda: len(late.descriptions) == 1)
    assert late.descriptions == early.descriptions
    tree = ET.fromstring(late.descriptions[0].data)
    assert {joint.get("name") for joint in tree.findall("joint") if joint.get("type") != "fixed"} == set(expected.names)


def test_robot_state_of_a_task_without_a_robot_is_refused(start: Start, domain: int) -> None:
    given = ("-p", "environment.id:=rkhs/Toy-v0", "-p", "robot_state:=true")
    message = "robot_state: expected a task with joints, got rkhs/Toy"
    code, _, err = start("simulator", "--ros-args", *given).finish()
    assert code == 2
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    assert message in lines[0]
