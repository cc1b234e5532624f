"""The robot node with a sensor, a gate, a policy and a learner, each of which may fall silent."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool

from rkhs_interfaces.msg import Action
from rkhs_ros.nodes.core.diagnostics import OBSTACLE
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.robot.robot_node import RobotNode
from test.ros.conftest import Probe, Process
from test.ros.robot_bench import HORIZON, PERIOD, SECTION, SENSOR_PERIOD_S, Bench, drawn, write_section

pytestmark = pytest.mark.clock
Start = Callable[..., Process]
# All parts share one process here, which a busy machine delays: only the silent part may pass its limit. Actions and
# reports share one limit, `misses_allowed`, so a period must be long against such delays.
PATIENT: dict[str, object] = {"period": 0.2, "misses_allowed": 3, "stale_after": 5.0, "learner_timeout": 5.0}
ACTIONS = np.array([drawn(step) for step in range(HORIZON)])


@pytest.fixture
def bench(probe: Probe) -> Bench:
    return Bench(probe)


@pytest.fixture
def begin(start: Start, run_node: Callable[..., object], bench: Bench, tmp_path: Path) -> Callable[..., Any]:
    """Start a robot node in this process, or in its own, and wait until it hears the bench."""

    def begun(*, process: bool = False, **changes: object) -> Any:
        arguments = ("--params-file", write_section(tmp_path / "robot.yaml", **changes))
        node = start("robot", "--ros-args", *arguments) if process else run_node(RobotNode, "robot", *arguments)
        bench.meet()
        return node

    return begun


def reason(message: object) -> str:
    return str(message.executions[0].discard_reason)  # type: ignore[attr-defined]


def test_an_episode_has_the_observed_drawn_and_executed_values(begin: Callable[..., Any], bench: Bench) -> None:
    begin()
    message = bench.play()
    assert reason(message) == ""
    np.testing.assert_allclose(message.actions, ACTIONS)  # as they were drawn
    asked = 2 * np.minimum(ACTIONS, 1.0)
    np.testing.assert_allclose(bench.moves, asked)
    execution = message.executions[0]
    np.testing.assert_allclose(execution.executed, asked / 2)
    np.testing.assert_allclose(message.rewards, 1e2 * asked / 4)  # the executed action, in the action's units
    assert [m.step for m in bench.observations()] == list(range(HORIZON + 1))
    assert bench.observations()[-1].over
    assert [list(bench.observations()[-1].truncated), list(bench.observations()[-1].terminated)] == [[0], []]
    steps = np.diff(execution.stamps)[1:] / 1e9  # the first one waits for its action
    assert (steps > 0.85 * PERIOD).all()
    bench.probe.until(lambda: bench.is_at_rest)  # the topics may bring the episode first


def test_a_policy_node_that_does_not_act_or_cannot_act_ends_the_run(begin: Callable[..., Any], bench: Bench) -> None:
    process = begin(process=True)
    bench.silent = {"policy"}
    bench.start()
    bench.probe.until(lambda: bench.observations() != [])
    shown = bench.observations()[0]
    failed = Action(batch=shown.batch, policy_version=shown.policy_version, failure="the policy cannot act")
    bench.probe.say("action", failed)
    assert bench.failed() == "slider: the policy cannot act"
    bench.start(timeout=0.5)
    bench.probe.until(lambda: process.popen.poll() is not None)
    assert (process.finish()[0], bench.moves) == (75, [])


@pytest.mark.parametrize(
    ("part", "limit", "words"),
    [
        ("policy", {}, "4 actions arrived too late"),
        ("learner", {"learner_timeout": 0.5}, "no heartbeat of the learner for"),
        ("sensor", {"stale_after": 0.3}, "sensor position: stale: the last message on position arrived"),
        ("gate", {"stale_after": 0.3}, "the gate did not report a command within 0.3 s (stale_after)"),
    ],
)
def test_a_silent_peer_stops_the_robot_and_discards_the_episode(
    begin: Callable[..., Any], bench: Bench, part: str, limit: dict[str, object], words: str
) -> None:
    begin(**PATIENT | limit)
    identity = bench.start(horizon=200)
    bench.until_moving(3)
    bench.silent = {part}
    message = bench.ended(identity)
    assert words in reason(message)
    bench.probe.until(lambda: bench.is_at_rest)
    steps = message.lengths[0]
    assert 3 <= steps < 100
    assert len(message.executions[0].stamps) == steps + 1
    commands = len(bench.moves)
    bench.silent = set()
    bench.gate_state("holding")  # a gate that was started again says so
    bench.probe.settle()
    assert len(bench.moves) == commands
    assert reason(bench.play(horizon=HORIZON)) == ""


def test_nothing_moves_while_the_gate_is_disarmed_or_stopped(begin: Callable[..., Any], bench: Bench) -> None:
    bench.gate_state("disarmed")
    obstacles: list[String] = []
    bench.probe.create_subscription(String, OBSTACLE, obstacles.append, LATCHED_QOS)
    begin()
    identity = bench.start(horizon=200)
    bench.probe.until(lambda: obstacles != [] and obstacles[-1].data == "")  # an earlier node may have reported another
    arm = "ros2 service call /gate/arm std_srvs/srv/Trigger"
    bench.probe.until(lambda: arm in bench.describe().waiting)
    assert not bench.moves
    bench.gate_state("holding")
    bench.until_moving()
    assert bench.describe().waiting == ""
    bench.gate_state("stopped", "a wall")
    assert "the gate stopped the robot (a wall)" in reason(bench.ended(identity))
    commands = len(bench.moves)
    identity = bench.start()
    bench.probe.until(lambda: "the gate stopped the robot (a wall)" in bench.describe().waiting)
    assert len(bench.moves) == commands
    bench.gate_state("holding")
    assert reason(bench.ended(identity)) == ""


def test_an_operator_can_pause_and_continue(begin: Callable[..., Any], bench: Bench) -> None:
    begin()
    assert bench.probe.ask_once("robot/pause", SetBool.Request(data=True), "robot").success
    identity = bench.start()
    bench.probe.until(
        lambda: (
            "paused; to continue: rkhs robot start FOLDER, or ros2 service call /robot/start"
            in bench.describe().waiting
        )
    )
    assert bench.say("start").success
    assert reason(bench.ended(identity)) == ""


def test_a_pause_during_the_reset_holds_the_episode_back(begin: Callable[..., Any], bench: Bench) -> None:
    begin(reset={"steps": ["person"]}, learner_timeout=1.0)
    identity = bench.start()
    bench.probe.until(lambda: "prepare the scene" in bench.describe().waiting)
    assert bench.probe.ask_once("robot/pause", SetBool.Request(data=True), "robot").success
    assert bench.say("start").success  # ends the pause, and confirms nothing
    bench.probe.settle()
    assert "prepare the scene" in bench.describe().waiting
    assert not bench.moves
    assert bench.say("start").success
    assert reason(bench.ended(identity)) == ""


def test_a_completed_episode_can_be_vetoed_until_the_learner_uses_it(begin: Callable[..., Any], bench: Bench) -> None:
    begin()
    first = bench.start(0)
    bench.ended(first)
    assert not bench.say("veto").success  # the learner may learn from it by now
    bench.start(1, horizon=100)  # it waits for another one, under the same policy
    bench.until_moving()
    bench.gate_state("stopped", "a wall")  # the second one begins again
    bench.probe.until(lambda: bench.is_at_rest)
    bench.gate_state("holding")
    bench.start(1, horizon=100)
    bench.until_moving()
    assert bench.say("veto").success
    assert reason(bench.ended(first, count=2)) == "vetoed by the operator"
    assert not bench.say("veto").success
    commands = len(bench.moves)
    assert reason(bench.play(0, policy_version=2)) == ""
    assert len(bench.moves) > commands  # it was run again


def test_an_episode_can_be_vetoed_within_its_window(begin: Callable[..., Any], bench: Bench) -> None:
    begin(veto_window=30.0)
    identity = bench.start()
    assert bench.ended(identity).vetoable
    assert bench.say("veto").success
    last = bench.ended(identity, count=2)
    assert (last.vetoable, reason(last)) == (False, "vetoed by the operator")


def test_a_reset_waits_for_a_person_while_the_learner_lives(begin: Callable[..., Any], bench: Bench) -> None:
    begin(reset={"steps": ["person"]}, learner_timeout=1.0)
    identity = bench.start()
    bench.probe.until(lambda: "prepare the scene" in bench.describe().waiting)
    assert not bench.moves
    assert bench.say("start").success
    assert reason(bench.ended(identity)) == ""
    identity = bench.start()
    bench.probe.until(lambda: "prepare the scene" in bench.describe().waiting)
    bench.silent = {"learner"}
    assert "no heartbeat of the learner" in reason(bench.ended(identity))


def test_a_failing_reward_is_reported_and_the_robot_holds(begin: Callable[..., Any], bench: Bench) -> None:
    begin(reward={"function": "math:gcd"})
    bench.start()
    assert bench.failed().startswith("slider: reward function: TypeError")
    bench.probe.until(lambda: bench.is_at_rest)


def test_a_node_that_shuts_down_makes_the_robot_hold(begin: Callable[..., Any], bench: Bench) -> None:
    process = begin(process=True)
    identity = bench.start(horizon=500)
    bench.until_moving()
    process.interrupt()
    assert reason(bench.ended(identity)) == "the robot node is shutting down"
    bench.probe.until(lambda: bench.is_at_rest)
    assert process.finish()[0] == 0


def test_a_message_that_cannot_be_decoded_discards_the_episode(begin: Callable[..., Any], bench: Bench) -> None:
    begin(**PATIENT)
    identity = bench.start(horizon=200)
    bench.until_moving(3)
    bench.silent = {"sensor"}
    bench.sensor.publish(bytes([0, 1, 0, 0, 1]))  # too short for a number
    assert "position: cannot decode the message" in reason(bench.ended(identity))


def test_unusable_sensors_are_reported_before_arming(begin: Callable[..., Any], bench: Bench, probe: Probe) -> None:
    names = ["shoulder"]
    joints = probe.create_publisher(JointState, "joint_states", 1)
    probe.create_timer(SENSOR_PERIOD_S, lambda: joints.publish(JointState(name=names, position=[0.5] * len(names))))
    obstacles: list[String] = []
    probe.create_subscription(String, OBSTACLE, obstacles.append, LATCHED_QOS)
    arm = {"topic": "joint_states", "joints": ["shoulder", "elbow"], "fields": ["position"]}
    bench.gate_state("disarmed")
    good = SECTION["sensors"]["position"]
    begin(sensors={"arm": arm, "place": good | {"topic": "positon"}, "position": good})
    bench.start(horizon=200)
    missing = "; missing joints 'elbow', got shoulder; sensor place: /positon: no messages, no publishers"
    probe.until(lambda: missing in bench.describe().waiting)
    assert bench.describe().waiting.startswith("sensor arm: /joint_states: received, ")
    probe.until(lambda: obstacles != [] and missing in obstacles[-1].data)  # which the gate refuses to be armed with
    names.append("elbow")
    speech = probe.create_publisher(Float64, "positon", 1)
    probe.create_timer(SENSOR_PERIOD_S, lambda: speech.publish(Float64()))
    probe.until(lambda: "rkhs robot arm" in bench.describe().waiting)
    probe.until(lambda: obstacles[-1].data == "")
    assert not bench.moves
