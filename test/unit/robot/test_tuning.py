"""The description of a tuning: ranges, contexts and what is refused."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.robot.tuning import Parameter, Trials, best_places, next_places, noise_of, tuning_from

TREE: dict[str, Any] = {
    "node": "controller",
    "parameters": {"p": {"minimum": 1.0, "maximum": 100.0, "scale": "log"}, "limit": {"minimum": -2, "maximum": 4}},
    "sensors": {"axis": {"joints": ["axis"], "fields": ["position"]}},
    "reward": {"topic": "score"},
}


@given(place=st.floats(-1.0, 1.0), scale=st.sampled_from(["linear", "log"]), low=st.floats(0.001, 1.0))
def test_a_place_and_its_value_determine_each_other(place: float, scale: str, low: float) -> None:
    parameter = Parameter(low, 50.0, scale)
    value = parameter.value(place)
    assert low <= value <= 50.0
    assert parameter.place(value) == pytest.approx(place, abs=1e-9)


@given(place=st.floats(-1.0, 1.0), low=st.floats(-0.4, 0.4), step=st.sampled_from([0.1, 0.25, 1.0]))
def test_a_value_in_steps_is_the_nearest_one_in_the_range(place: float, low: float, step: float) -> None:
    parameter = Parameter(low, 2.1)
    value, steps = parameter.value(place, origin=-1.0, step=step), np.arange(-1.0, 3.0, step)
    within = steps[(steps > low - 1e-9) & (steps < 2.1 + 1e-9)]
    assert value == pytest.approx(within[np.abs(within - value).argmin()])
    exact = parameter.value(place)
    assert abs(value - exact) == pytest.approx(np.abs(within - exact).min())


def trials_of(seed: int, count: int, contexts: int = 0) -> Trials:
    """Return trials of two parameters whose best places are 0.3 and -0.5, the first moved by a context."""
    random = np.random.default_rng(seed)
    trials = Trials(np.empty((0, contexts)), np.empty((0, 2)), np.empty(0))
    for _ in range(count):
        context = random.uniform(-0.4, 0.4, contexts)
        places, gain = next_places(trials, context, seed)
        assert gain > 0.0
        assert (np.abs(places) <= 1.0).all()
        reward = -((places[0] - 0.3 - context.sum()) ** 2) - (places[1] + 0.5) ** 2
        rows = (context, places, np.array(reward))
        trials = Trials(*(np.concatenate([old, new[None]]) for old, new in zip(trials, rows, strict=True)))
    return trials


@pytest.mark.parametrize("seed", range(4))
def test_twenty_trials_find_the_maximum_of_a_smooth_reward(seed: int) -> None:
    trials = trials_of(seed, 20)
    assert trials.rewards.max() > -0.01
    np.testing.assert_allclose(best_places(trials, np.empty(0), seed), [0.3, -0.5], atol=0.1)
    np.testing.assert_array_equal(trials_of(seed, 20).places, trials.places)


@pytest.mark.parametrize("seed", range(2))
def test_the_best_parameters_follow_the_context(seed: int) -> None:
    trials = trials_of(seed, 30, contexts=1)
    for shift in (-0.3, 0.3):
        np.testing.assert_allclose(best_places(trials, np.array([shift]), seed), [0.3 + shift, -0.5], atol=0.15)


def test_the_noise_is_the_difference_of_trials_that_repeat_each_other() -> None:
    trials = trials_of(0, 8)
    assert noise_of(trials) == 0.0
    twice = Trials(*(np.concatenate([each, each]) for each in trials))
    noisy = twice._replace(rewards=twice.rewards + np.repeat([0.0, 0.5], 8))
    assert noise_of(noisy) == pytest.approx(0.5)
    assert next_places(trials_of(0, 25), np.empty(0), 0)[1] < 0.01  # nothing more to gain


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"node": ""}, "node: expected the name of a node, got none"),
        ({"parameters": {}}, "parameters: expected a section for each parameter, got {}"),
        ({"parameters": {"p": {"minimum": 2.0}}}, "parameters.p: minimum: expected less than the maximum, 1, got 2.0"),
        ({"parameters": {"p": {"scale": "log"}}}, "parameters.p: minimum: expected more than 0 for scale: log, got"),
        ({"parameters": {"p": {"minimun": 1}}}, "unknown key 'parameters.p.minimun', did you mean"),
        ({"sensors": {}}, "sensors: expected a section for each sensor"),
        ({"reward": {}}, "reward: expected a function or a topic, got neither"),
        ({"context": ["axis positon (rad)"]}, "context: unknown value 'axis positon .rad.', did you mean"),
        ({"trail": {}}, "unknown key 'trail', did you mean 'tri"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        tuning_from(TREE | change)
