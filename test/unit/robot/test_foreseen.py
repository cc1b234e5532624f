"""The command after many periods, without simulating each."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rkhs_ros.robot import motion
from rkhs_ros.robot.limits import EFFORT, KINDS, POSITION, Limits
from rkhs_ros.robot.motion import Setpoint, advance, foreseen, rest_at

JOINTS = 3


def random_limits(kind: str, stream: np.random.Generator) -> Limits:
    def some(low: float, high: float, *others: float) -> np.ndarray:
        values = np.exp(stream.uniform(np.log(low), np.log(high), JOINTS))
        return np.where(stream.random(JOINTS) < 0.1, stream.choice([low, *others], JOINTS), values)

    acceleration: Any = np.full(JOINTS, np.inf) if kind == EFFORT else some(0.01, 1000.0, 0.0)
    velocity = some(0.01, 100.0, 0.0, *([] if kind == POSITION else [np.inf]))
    return Limits(kind, -some(0.1, 5.0), some(0.1, 5.0), velocity, acceleration, some(1e-4, 10.0, np.inf))


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=60)
@given(seed=st.integers(0, 2**63), periods=st.integers(1, 400), period=st.sampled_from([0.001, 0.01, 0.1]))
def test_it_equals_the_simulation_of_each_period(kind: str, seed: int, periods: int, period: float) -> None:
    stream = np.random.default_rng(seed)
    limits = random_limits(kind, stream)
    bounds = limits.bounds()
    state: Setpoint = rest_at(stream.uniform(*bounds))
    for goal in stream.uniform(*bounds, (3, JOINTS)):  # in motion, perhaps away from the goal or too fast for it
        for _ in range(stream.integers(0, 60)):
            state = advance(limits, period, state, goal)
    goal = stream.uniform(*bounds)
    value = foreseen(limits, period, state, goal, periods)
    for _ in range(periods):
        state = advance(limits, period, state, goal)
    np.testing.assert_allclose(value, state.value, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(("velocity", "acceleration"), [(0.0, 1.0), (2.0, 0.0), (2.0, 0.01), (2.0, 1.0), (2.0, 1000.0)])
def test_the_number_of_steps_does_not_grow_with_the_number_of_periods(
    monkeypatch: pytest.MonkeyPatch, velocity: float, acceleration: float
) -> None:
    steps: list[float] = []
    single = motion._stoppable_velocity
    monkeypatch.setattr(motion, "_stoppable_velocity", lambda *each: (steps.append(0.0), single(*each))[1])
    ones = np.ones(1)
    limits = Limits(POSITION, -50.0 * ones, 50.0 * ones, velocity * ones, acceleration * ones, np.inf * ones)
    for rate in (-1.9, 0.0, 1.9) if velocity and acceleration else (0.0,):
        for goal in (-50.0, -0.01, 0.0, 1e-6, 3.0, 50.0):
            steps.clear()
            foreseen(limits, 0.001, Setpoint(np.zeros(1), np.full(1, rate)), np.full(1, goal), periods=60_000)
            assert len(steps) <= 32
