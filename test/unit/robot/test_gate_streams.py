"""Whatever a gate receives, its outputs never trigger a robot's protective stop."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from rkhs_ros.robot.gate_state import Mode, Rules
from rkhs_ros.robot.limits import EFFORT, KINDS, POSITION, advance, rest_at
from test.unit.robot.gate_streams import NASTY, PERIOD, World, play, rules_of

pytestmark = pytest.mark.slow

STREAMS = 40  # of each kind of command
seeds = st.integers(0, 2**63)
over_kinds = pytest.mark.parametrize("kind", KINDS)


def random_rules(kind: str, stream: np.random.Generator) -> Rules:
    """Return rules with random limits, of which some are 0 or infinite."""
    joints = int(stream.integers(1, 4))

    def some(low: float, high: float, others: tuple[float, ...]) -> np.ndarray:
        values = np.exp(stream.uniform(np.log(low), np.log(high), joints))
        return np.where(stream.random(joints) < 0.15, stream.choice(others, joints), values)

    limits: dict[str, Any] = {"minimum": -some(0.01, 5, (0.0,)), "maximum": some(0.01, 5, (0.0,))}
    limits["velocity"] = some(0.01, 100, (0.0,) if kind == POSITION else (0.0, np.inf))
    if kind != EFFORT:
        limits["acceleration"] = some(0.01, 1000, (0.0,))
    return rules_of(kind, joints, sensed={"velocity": 50.0}, **limits, step=some(0.001, 10, (0.0, np.inf)))


@over_kinds
@settings(max_examples=STREAMS)
@given(seed=seeds)
def test_no_stream_triggers_the_robots_protective_stop(kind: str, seed: int) -> None:
    stream = np.random.default_rng(seed)
    world = play(random_rules(kind, stream), stream)
    assert not world.protection.trips
    assert all(later - earlier >= PERIOD for earlier, later in zip(world.times, world.times[1:], strict=False))


@over_kinds
@settings(max_examples=STREAMS)
@given(seed=seeds, periods=st.integers(1, 400), period=st.sampled_from([0.001, 0.01, 0.1]))
def test_many_periods_at_once_equal_them_one_by_one(kind: str, seed: int, periods: int, period: float) -> None:
    stream = np.random.default_rng(seed)
    limits = random_rules(kind, stream).limits
    bounds = limits.bounds()
    state = rest_at(stream.uniform(*bounds))
    for goal in stream.uniform(*bounds, (3, limits.joints)):  # in motion, perhaps away from the goal or too fast for it
        state = advance(limits, period, state, goal, int(stream.integers(0, 60)))
    goal = stream.uniform(*bounds)
    together = advance(limits, period, state, goal, periods)
    for _ in range(periods):
        state = advance(limits, period, state, goal)
    np.testing.assert_allclose(together.value, state.value, rtol=0.0, atol=1e-9)


@over_kinds
def test_streams_move_the_robot_and_would_stop_it_without_the_gate(kind: str) -> None:
    worlds = [play(rules_of(kind), np.random.default_rng(seed)) for seed in range(30)]
    assert not any(world.protection.trips for world in worlds)
    assert all(world.bare.trips for world in worlds)
    assert sum(np.ptp(world.outputs, axis=0).min() > 0.1 for world in worlds if world.outputs) > 5
    modes = {world.state.mode for world in worlds}
    assert {Mode.HOLDING, Mode.MOVING, Mode.STOPPED} <= modes


@over_kinds
@settings(max_examples=10)
@given(seed=seeds)
def test_a_disarmed_gate_sends_nothing(kind: str, seed: int) -> None:
    stream, world = np.random.default_rng(seed), World(rules_of(kind))
    for _ in range(30):
        world.command(stream.choice([*NASTY, *stream.uniform(-2, 2, 9)], 2))
        world.request_stop(bool(stream.integers(2)))
        world.wait(stream.uniform(0, 0.1))
    assert not world.outputs
    assert world.state.mode == Mode.DISARMED


@over_kinds
@settings(max_examples=10)
@given(seed=seeds, seconds=st.floats(0.0, 0.5))
def test_a_stopped_gate_comes_to_rest_and_ignores_commands(kind: str, seed: int, seconds: float) -> None:
    world, alone = World(rules_of(kind)), World(rules_of(kind))
    for each in (world, alone):
        stream = np.random.default_rng(seed)
        each.arm()
        for _ in range(round(seconds / 0.05)):
            each.command(stream.uniform(-3, 3, 2))
            each.wait(0.05)
        each.stop()
    for _ in range(40):
        world.command(stream.uniform(-3, 3, 2), instance=int(stream.integers(1, 3)))
        for each in (world, alone):
            each.wait(0.05)
    assert world.state.mode == Mode.STOPPED
    assert np.array_equal(world.outputs, alone.outputs)  # commands make no difference
    assert not world.protection.trips
    assert np.abs(world.velocity).max() < 0.02
    assert np.ptp(world.outputs[-10:], axis=0).max() < 0.02
