"""Transitions and outputs of the gate."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rkhs_ros.robot.gate import is_at_rest, leave, stopped_by_operator, ticked
from rkhs_ros.robot.gate_state import Flags, Mode
from rkhs_ros.robot.limits import EFFORT, KINDS, POSITION, VELOCITY, braking
from test.unit.robot.gate_streams import PERIOD, World, rules_of

over_kinds = pytest.mark.parametrize("kind", KINDS)


def armed_world(kind: str, **options: Any) -> World:
    world = World(rules_of(kind, **options))
    assert world.arm() == ""
    return world


@over_kinds
def test_a_command_moves_an_armed_gate_until_a_hold_command(kind: str) -> None:
    world = armed_world(kind)
    for _ in range(20):
        report = world.command([0.4, -0.4])
        assert not report.reason
        world.wait(0.05)
    assert world.state.mode == Mode.MOVING
    np.testing.assert_allclose(world.outputs[-1], [0.4, -0.4])
    np.testing.assert_allclose(report.executed, [0.4, -0.4])
    assert not report.flags
    assert world.command(None).executed.size == 0
    assert world.state.mode == Mode.HOLDING
    world.wait(3.0)
    assert is_at_rest(world.state, world.rules, world.now)
    assert not world.moves() or kind == EFFORT
    assert (world.state.mode, world.state.counts.stops) == (Mode.HOLDING, 0)  # silence while holding is no fault
    assert world.state.counts.commands == 21


@over_kinds
@pytest.mark.parametrize("sender", ["dies", "hangs_and_repeats", "sends_nan"])
def test_silence_stops_the_robot_within_the_timeout_plus_one_period(kind: str, sender: str) -> None:
    world = armed_world(kind)
    world.command([0.5, 0.5])
    begun, timeout = world.now, world.rules.command_timeout
    while world.state.mode == Mode.MOVING and world.now < begun + 1.0:
        world.tick()
        if sender == "hangs_and_repeats":
            assert world.command([0.5, 0.5], number=1).flags == Flags.REFUSED
        if sender == "sends_nan":
            assert world.command([np.nan, 0.5]).flags == Flags.REFUSED
    assert world.state.mode == Mode.STOPPED
    assert timeout < world.now - begun <= timeout + PERIOD + 1e-9
    assert world.state.reason == "no command for 0.2 s"
    world.wait(2.0)
    assert world.state.mode == Mode.STOPPED
    assert len(world.outputs) > 200  # it keeps sending
    assert world.arm() == ""
    assert (world.state.mode, world.state.reason) == (Mode.HOLDING, "")


@over_kinds
def test_a_stale_sensor_stops_the_gate_and_prevents_arming(kind: str) -> None:
    world = armed_world(kind)
    world.command([0.5, 0.5])
    world.wait(0.1)
    world.senses = False
    world.command([0.5, 0.5])
    world.wait(0.1 + 2 * PERIOD)
    assert world.state.mode == Mode.STOPPED
    assert "no usable joint state" in world.state.reason
    assert "no usable joint state" in world.arm()
    count = len(world.outputs)
    world.wait(1.0)
    assert len(world.outputs) == count + 100
    assert np.isfinite(world.outputs).all()
    world.senses = True
    world.wait(0.1)
    assert world.state.mode == Mode.STOPPED
    assert world.arm() == ""


REFUSED_ONCE = (
    "cannot arm: joint 0 was not where it was sent after no joint state had arrived; arm again if the robot may move"
)


@over_kinds
@pytest.mark.parametrize("moved", [0.04, 0.8])
def test_a_robot_that_moved_while_its_sensors_were_silent_is_not_pulled_back(kind: str, moved: float) -> None:
    world = armed_world(kind)
    world.command([0.3, 0.3])
    world.wait(0.1)
    world.command(None)
    world.wait(3.0)
    world.senses = False
    world.wait(1.0)
    world.position, world.velocity = world.position + np.array([moved, 0.0]), np.zeros(2)  # without power
    world.sense()
    state, output = ticked(world.state, world.rules, world.now + PERIOD)
    is_far = moved > 0.05
    if kind == POSITION:
        assert (output is None, state.mode) == ((True, Mode.DISARMED) if is_far else (False, Mode.STOPPED))
    elif kind == VELOCITY or is_far:
        np.testing.assert_allclose(output, 0.0, atol=1e-3)
    else:
        np.testing.assert_allclose(output, [-20.0 * moved, 0.0], atol=1e-3)  # it keeps bearing its load
    if kind == POSITION and is_far:
        assert world.arm() == REFUSED_ONCE
        assert world.arm() == ""
        state, output = ticked(world.state, world.rules, world.now + PERIOD)
        np.testing.assert_allclose(output, world.position)


@pytest.mark.parametrize("silence", [0.12, 0.2, 0.5, 3.0])
def test_a_robot_that_lost_its_power_in_a_motion_is_not_pulled_on(silence: float) -> None:
    world = armed_world(POSITION, acceleration=2.0)
    for _ in range(10):
        world.command([2.0, 2.0])
        world.wait(0.1)
    world.senses = False
    world.wait(silence)
    world.position = world.position - 0.8
    world.sense()
    assert world.state.mode == Mode.DISARMED
    world.senses = True
    count = len(world.outputs)
    world.wait(1.0)
    assert len(world.outputs) == count


def test_a_joint_under_load_does_not_sink_while_joint_states_come_with_gaps() -> None:
    world = armed_world(EFFORT)
    world.load, world.velocity = 1.5, np.full(2, 0.5)  # it holds 0.075 rad below the anchor
    world.stop()
    for _ in range(100):
        world.senses = False
        world.wait(0.2)
        world.senses = True
        world.wait(0.02)
        assert (np.abs(world.position) < 0.4).all()


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"position": [0.0, 1.6]}, "position"), ({"velocity": [-4.0, 0.0]}, "velocity"), ({"effort": [7, 0]}, "effort")],
)
@over_kinds
def test_exceeding_a_sensed_limit_stops_the_gate_and_prevents_arming(
    kind: str, changes: dict[str, Any], word: str
) -> None:
    world = armed_world(kind, sensed={"minimum": -1.5, "maximum": 1.5, "velocity": 3.0, "effort": 6.0})
    world.command([0.1, 0.1])
    beyond = {name: np.array(values, dtype=float) for name, values in changes.items()}
    world.sense(**beyond)
    assert world.state.mode == Mode.STOPPED
    assert world.state.reason.startswith(f"{word} of joint {np.flatnonzero(beyond[word])[0]}: expected from -")
    assert word in world.arm()
    world.wait(1.1)  # for this long, a position that jumps there and back counts as that of another publisher
    assert world.arm() == ""


@over_kinds
def test_a_requested_stop_prevents_arming(kind: str) -> None:
    world = armed_world(kind)
    world.request_stop(True)
    assert (world.state.mode, world.state.reason) == (Mode.STOPPED, "a stop is requested")
    assert world.arm() == "cannot arm while a stop is requested"
    world.request_stop(False)
    assert world.state.mode == Mode.STOPPED
    assert world.arm() == ""
    unarmed = World(rules_of(kind))
    unarmed.request_stop(True)
    assert "stop" in unarmed.arm()
    assert unarmed.state.mode == Mode.DISARMED
    released = World(rules_of(kind))
    released.request_stop(True)
    released.request_stop(False)
    assert released.arm() == ""  # at the first attempt, unlike after a stop by the operator


@over_kinds
def test_a_stop_by_the_operator_is_latched_in_every_state(kind: str) -> None:
    reason = "a stop is requested by the service 'stop'"
    unarmed = World(rules_of(kind))
    unarmed.state = stopped_by_operator(unarmed.state, reason)
    unarmed.wait(0.1)
    assert (unarmed.state.mode, unarmed.state.reason, unarmed.outputs) == (Mode.DISARMED, reason, [])
    assert unarmed.arm() == f"cannot arm: {reason}; arm again if the robot may move"
    assert unarmed.arm() == ""
    world = armed_world(kind)
    world.stop("a fault")
    assert stopped_by_operator(world.state, reason).reason == reason
    world.request_stop(True)
    assert (world.state.reason, world.state.counts.stops) == ("a stop is requested", 1)


@pytest.mark.parametrize(
    ("message", "options"),
    [
        ("finite", {"values": [np.nan, 0.0]}),
        ("2 values", {"values": [0.0]}),
        ("stamp", {"values": [0.0, 0.0], "age": 0.3}),
        ("stamp", {"values": None, "age": np.nan}),
        ("number above 5", {"values": None, "number": 4}),
        ("expected instance 1, which is moving the robot", {"values": None, "instance": 2}),
    ],
)
@over_kinds
def test_a_refused_command_is_counted_and_changes_nothing(kind: str, message: str, options: dict[str, Any]) -> None:
    world = armed_world(kind)
    world.command([0.2, 0.2], number=5)
    world.wait(0.1)
    goal, newest = world.state.goal, world.state.motion
    report = world.command(**options)
    assert report.flags == Flags.REFUSED
    assert message in report.reason
    assert newest is not None
    assert np.array_equal(report.executed, newest.value)
    assert (world.state.goal is goal, world.state.motion is newest) == (True, True)
    assert (world.state.counts.refusals, world.state.counts.commands) == (1, 2)


@over_kinds
@pytest.mark.parametrize("moves", [True, False])
def test_arming_resets_the_expected_instance_and_number(kind: str, moves: bool) -> None:
    world = armed_world(kind)
    assert not world.command([0.1, 0.1], instance=2**64 - 1, number=2**64 - 1).reason
    if moves:
        assert "which is moving the robot" in world.command([0.1, 0.1], number=1).reason
        world.stop()
    else:
        world.state = replace(world.state, goal=None, mode=Mode.HOLDING)  # no greater number is available for a hold
    assert "or a newer one" in world.command([0.1, 0.1], number=1).reason
    assert world.arm() == ""
    assert not world.command([0.1, 0.1], number=1).reason


@pytest.mark.parametrize(
    ("kind", "limit", "value", "flag"),
    [
        (POSITION, "maximum", 0.3, Flags.CLAMPED_VALUE),
        (POSITION, "velocity", 1.0, Flags.CLAMPED_VELOCITY),
        (POSITION, "acceleration", 2.0, Flags.CLAMPED_ACCELERATION),
        (POSITION, "step", 0.1, Flags.CLAMPED_STEP),
        (VELOCITY, "maximum", 0.3, Flags.CLAMPED_VALUE),
        (VELOCITY, "acceleration", 1.0, Flags.CLAMPED_ACCELERATION),
        (EFFORT, "minimum", -0.3, Flags.CLAMPED_VALUE),
        (EFFORT, "velocity", 1.0, Flags.CLAMPED_VELOCITY),
    ],
)
def test_the_report_flags_the_limit_that_changed_a_command(kind: str, limit: str, value: float, flag: Flags) -> None:
    generous = {"minimum": -5.0, "maximum": 5.0, "velocity": 100.0, "acceleration": 1e4}
    if kind == EFFORT:
        del generous["acceleration"]
    free, bound = armed_world(kind, **generous), armed_world(kind, **(generous | {limit: value}))
    asked = np.full(2, 0.5 if value > 0 else -0.5)
    assert not free.command(asked).flags
    first = bound.command(asked)
    assert first.flags == flag
    assert (np.abs(first.executed) < 0.5).all()
    assert bound.state.counts.clamps == 1
    bound.wait(0.05)
    second = bound.command(asked)
    bound.wait(0.05)
    np.testing.assert_allclose(bound.outputs[-1], second.executed)  # as the report predicted


@over_kinds
@pytest.mark.parametrize("moment", ["at rest", "in motion", "at a turning point"])
def test_a_gate_that_exits_leaves_the_robot_at_rest(kind: str, moment: str) -> None:
    world = armed_world(kind)
    while moment != "at rest" and world.position[0] < 0.3:
        world.command([1.0, -1.0])
        world.tick()
    while moment == "at a turning point" and world.velocity[0] > 0:
        world.command([-1.0, 1.0])
        world.tick()
    world.leave()
    world.protection.take(world.outputs[-1])
    assert not world.protection.trips
    assert np.abs(world.velocity).max() <= 0.02
    if kind != POSITION:
        assert not world.outputs[-1].any()
    place = world.position
    world.coast(1.0)
    assert np.abs(world.velocity).max() <= 0.02
    np.testing.assert_allclose(world.position, place, atol=0.02)


@pytest.mark.parametrize("fault", ["senses nothing", "timeout"])
def test_efforts_end_at_0_even_if_rest_cannot_be_detected(fault: str) -> None:
    world = armed_world(EFFORT)
    while world.position[0] < 0.5:
        world.command([3.0, 3.0])
        world.tick()
    world.senses = fault != "senses nothing"
    assert world.leave(timeout=0.3) >= 0.3 - 1e-9
    assert not world.outputs[-1].any()


def test_a_robot_is_at_rest_if_no_reading_during_the_rest_time_shows_motion() -> None:
    world = armed_world(EFFORT)
    world.command([1.0, 1.0])
    world.tick()
    world.stop()
    world.senses = False
    slow = ((0.01, 15, False), (0.01, 9, True))
    for speed, ticks, rests in ((1.0, 5, False), slow[0], (-1.0, 1, False), *slow):
        for _ in range(ticks):
            for each in (speed, 0.01):  # two readings a period
                world.sense(velocity=np.array([0.0, each]))
            world.tick()
        assert is_at_rest(world.state, world.rules, world.now) == rests
        assert leave(world.state, world.rules, world.now)[0].releases == rests


@over_kinds
def test_a_gate_that_shuts_down_cannot_be_armed(kind: str) -> None:
    world = armed_world(kind)
    world.command([0.5, 0.5])
    world.tick()
    world.state, is_left = leave(world.state, world.rules, world.now)
    assert (world.state.mode, is_left) == (Mode.STOPPED, False)
    assert "shutting down" in world.arm()
    unarmed = World(rules_of(kind))
    assert unarmed.leave() == 0.0
    assert not unarmed.outputs


def test_joints_that_brake_by_effort_hold_where_they_first_turn() -> None:
    world = armed_world(EFFORT)
    while world.velocity[0] < 3.0:
        world.command([3.0, -3.0])
        world.tick()
    world.stop()
    place, speeds = world.position, []
    for _ in range(300):
        world.tick()
        speeds.append(world.velocity[0])
    assert min(speeds) > -0.2  # the spring, wound up by more than a radian, does not pull back
    assert abs(world.position[0] - place[0]) > 1.0
    assert np.abs(world.outputs[-1]).max() < 0.01
    assert not world.protection.trips


def test_positions_start_at_the_sensed_joints_and_within_the_range() -> None:
    world = World(rules_of(POSITION), start=[0.7, -0.2])
    assert world.arm() == ""
    world.wait(0.05)
    np.testing.assert_array_equal(world.outputs, np.tile([0.7, -0.2], (5, 1)))
    outside = World(rules_of(POSITION), start=[2.5, 0.0])
    assert "joints within their limits" in outside.arm()
    assert outside.state.mode == Mode.DISARMED
    noisy = World(rules_of(POSITION), start=[2.001, 0.0])
    assert noisy.arm() == ""
    noisy.tick()
    assert noisy.outputs[0][0] == 2.0


def test_arming_and_commands_require_a_sensed_joint_state() -> None:
    world = World(rules_of(POSITION))
    world.state = type(world.state)()
    assert "no usable joint state" in world.arm()
    assert "sensed" in world.command([0.0, 0.0]).reason


def test_efforts_keep_bearing_a_load_without_a_sensor() -> None:
    world = armed_world(EFFORT)
    world.load = 1.0  # N m, by which the joints sag until the springs bear it
    world.wait(3.0)
    np.testing.assert_allclose(world.outputs[-1], 1.0, atol=0.05)
    np.testing.assert_allclose(world.position, -1.0 / 20.0, atol=0.01)
    world.senses = False
    world.wait(0.5)
    assert world.state.mode == Mode.STOPPED
    np.testing.assert_allclose(world.outputs[-1], 1.0, atol=0.1)


@pytest.mark.parametrize("bad", ["nan", "age", "order", "large"])
def test_a_bad_joint_state_is_refused_and_the_previous_one_becomes_stale(bad: str) -> None:
    world = armed_world(POSITION)
    changes: dict[str, Any] = {
        "nan": {"position": np.array([np.nan, 0.0])},
        "age": {"stamp": world.now - 1.0},
        "order": {"stamp": world.now - 0.05},
        "large": {"position": np.array([1e300, 0.0])},
    }[bad]
    assert world.sense(**changes)
    assert world.state.counts.refusals == 1
    world.senses = False
    for _ in range(12):
        world.sense(**(changes if bad != "order" else {"stamp": 99.0}))
        world.tick()
    assert world.state.mode == Mode.STOPPED


@over_kinds
def test_a_gate_that_was_late_stops_and_reports_it(kind: str) -> None:
    world = armed_world(kind)
    world.tick()
    world.command([0.5, 0.5])
    world.tick(late=0.05)
    assert world.state.mode == Mode.MOVING
    world.tick(late=0.15)
    assert (world.state.mode, world.state.reason) == (Mode.STOPPED, "the gate itself was late by 0.15 s")


def test_braking_predicts_the_outputs_after_a_stop() -> None:
    world = armed_world(POSITION, acceleration=[3.0, 8.0])
    for _ in range(6):
        world.command([2.0, -1.0])
        world.wait(0.1)
    motion = world.state.motion
    assert motion is not None
    assert motion.rate.any()
    predicted = braking(world.rules.limits, PERIOD, motion)
    assert 2 <= len(predicted) <= 10
    begun = len(world.outputs) - 1
    world.stop()
    world.wait(1.0)
    for seconds, values in predicted:
        np.testing.assert_allclose(world.outputs[begun + round(seconds / PERIOD)], values, atol=1e-12)
    np.testing.assert_allclose(world.outputs[-1], predicted[-1][1], atol=1e-12)
    at_rest = world.state.motion
    assert at_rest is not None
    ((seconds, values),) = braking(world.rules.limits, PERIOD, at_rest)
    assert seconds == 0.0
    assert np.array_equal(values, at_rest.value)
