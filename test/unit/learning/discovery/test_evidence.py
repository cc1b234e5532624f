"""Unwrapped angles are found by their effect, and hidden states lengthen the history."""

from dataclasses import replace
from functools import cache
from typing import Any

import gymnasium
import numpy as np
import pytest

from rkhs_ros.learning import discovery
from rkhs_ros.learning.discovery import Evidence, discover_inputs
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import prediction_error
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

COUNT, HORIZON = 3, 150
SPACES = Spaces((2,), np.array([-2.0]), np.array([2.0]))


def episodes_of(observed: Array, actions: Array) -> Episodes:
    """Return episodes of observations (count, horizon + 1, d) and actions (count, horizon, n)."""
    zeros = np.zeros(actions.shape[:2])
    mask = np.ones(zeros.shape, dtype=bool)
    return Episodes(observed[:, :-1], actions, zeros, mask, observed[:, -1], mask[:, 0] & False)


def spaces_of(episodes: Episodes) -> Spaces:
    return replace(SPACES, observation_shape=(episodes.observations.shape[2],))


@cache
def pendulum(seed: int) -> Episodes:
    """Return episodes of Pendulum-v1 with the angle, which counts its turns, and the angular velocity."""
    env: Any = gymnasium.make("Pendulum-v1").unwrapped
    rng = np.random.default_rng(seed)
    actions = rng.uniform(-2.0, 2.0, (COUNT, HORIZON, 1))
    observed = np.empty((COUNT, HORIZON + 1, 2))
    for one in range(COUNT):
        env.reset(seed=seed * COUNT + one)
        env.state = np.array([rng.uniform(-np.pi, np.pi), 7.0 * rng.choice([-1.0, 1.0])])  # enough for whole turns
        observed[one, 0] = env.state
        for t, action in enumerate(actions[one]):
            env.step(action)
            observed[one, t + 1] = env.state
    return episodes_of(observed, actions)


@cache
def cart(seed: int) -> Episodes:
    """Return episodes of a cart that moves freely for many metres: its position and its velocity."""
    rng = np.random.default_rng(seed)
    actions = rng.uniform(-2.0, 2.0, (COUNT, HORIZON, 1))
    observed = np.zeros((COUNT, HORIZON + 1, 2))
    observed[:, 0] = [0.0, 2.0]
    for t in range(HORIZON):
        position, velocity = observed[:, t].T
        kick = 0.002 * rng.standard_normal(COUNT)
        observed[:, t + 1] = np.stack([position + 0.1 * velocity, 0.99 * velocity + 0.2 * actions[:, t, 0] + kick], 1)
    return episodes_of(observed, actions)


def observing(episodes: Episodes, columns: list[int]) -> Episodes:
    kept = episodes.observations[:, :, columns]
    return replace(episodes, observations=kept, final_observations=episodes.final_observations[:, columns])


def late(episodes: Episodes) -> Episodes:
    before = np.concatenate([episodes.observations[:, :1], episodes.observations[:, :-1]], axis=1)
    return replace(episodes, observations=before, final_observations=episodes.observations[:, -1])


def with_constants(episodes: Episodes, count: int = 8) -> Episodes:
    """Return the episodes with further columns that never change."""
    wider = [(0, 0), (0, 0), (0, count)]
    observations, final = np.pad(episodes.observations, wider), np.pad(episodes.final_observations, wider[1:])
    return replace(episodes, observations=observations, final_observations=final)


def in_degrees(episodes: Episodes) -> Episodes:
    factor = 180.0 / np.pi
    observations, final = factor * episodes.observations, factor * episodes.final_observations
    return replace(episodes, observations=observations, final_observations=final)


def discovered(episodes: Episodes, inputs: Inputs = Inputs(), *, history: bool = True) -> Inputs:  # noqa: B008
    return discover_inputs(inputs, episodes, spaces_of(episodes), history=history)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_unwrapped_angle_of_a_pendulum_is_found(seed: int) -> None:
    radians = discovered(pendulum(seed))
    assert (radians.columns, radians.history) == ([0], 1)
    assert radians.full_turns == pytest.approx([2.0 * np.pi])
    degrees = discovered(in_degrees(pendulum(seed)))
    assert (degrees.columns, degrees.turns, degrees.history) == ([0], (360.0,), 1)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_free_position_is_not_an_angle(seed: int) -> None:
    assert np.ptp(cart(seed).observations[..., 0]) > 2.0 * np.pi
    assert discovered(cart(seed)) == Inputs()


def test_an_angle_without_effect_on_the_motion_is_not_found() -> None:
    """Use the cart as a driven pendulum without gravity: its motion does not have the period of a turn."""
    assert discovered(in_degrees(cart(0))).columns == []


@pytest.mark.parametrize("task", [pendulum, cart])
@pytest.mark.parametrize("hide", [late, lambda episodes: observing(episodes, [0])], ids=["late", "no velocities"])
@pytest.mark.parametrize("seed", [0])
def test_a_hidden_state_lengthens_the_history_by_one_step(task: Any, hide: Any, seed: int) -> None:
    hidden, known = hide(task(seed)), Inputs(angles=(0.0,)) if task is pendulum else Inputs()
    longer = discovered(hidden, known)
    assert longer == replace(known, history=2)
    assert discovered(hidden, known, history=False) == known
    assert discovered(hidden, longer) == longer  # once more does not help


@pytest.mark.parametrize("task", [pendulum, cart])
def test_columns_that_never_change_neither_hide_that_a_history_helps_nor_lower_the_error(task: Any) -> None:
    known = Inputs(angles=(0.0,)) if task is pendulum else Inputs()
    hidden = observing(task(0), [0])
    assert discovered(with_constants(hidden), known).history == discovered(hidden, known).history == 2
    errors = [
        prediction_error(its.take(slice(2)), its.take(slice(2, 4)), known, spaces_of(its), 100)
        for its in (hidden, with_constants(hidden))
    ]
    assert errors[1] == pytest.approx(errors[0], rel=0.1)


@pytest.mark.parametrize(("steps", "history"), [(99, 1), (100, 2)])
def test_a_hundred_steps_lengthen_the_history(steps: int, history: int) -> None:
    hidden = late(cart(0)).take(slice(1))
    assert discovered(replace(hidden, mask=hidden.mask & (np.arange(HORIZON) < steps))).history == history


def test_a_history_has_at_most_three_steps() -> None:
    later = late(late(late(cart(0))))
    assert discovered(later, Inputs(history=2)).history == 3
    assert discovered(observing(later, [0]), Inputs(history=3)).history == 3


def test_a_noisy_observation_of_the_whole_state_keeps_the_history() -> None:
    rng, clean = np.random.default_rng(0), cart(0)
    noise = 0.01 * clean.observations.std(axis=(0, 1)) * rng.standard_normal(clean.observations.shape)
    assert discovered(replace(clean, observations=clean.observations + noise)).history == 1


def test_known_angles_stay_if_nothing_is_found() -> None:
    known = Inputs(angles=(0.0,), turns=(10.0,))
    assert discovered(cart(0), known, history=False) == known


@pytest.mark.parametrize("seed", [0, 1])
def test_a_history_and_an_angle_that_are_not_needed_are_dropped(seed: int) -> None:
    wrong = Inputs(history=2, angles=(0.0,), turns=(2.0 * np.pi,))
    episodes = cart(seed)
    spaces = spaces_of(episodes)
    found = discover_inputs(wrong, episodes, spaces, history=True, given=Inputs())
    assert found == Inputs()
    assert discover_inputs(wrong, episodes, spaces, history=True, given=wrong) == wrong
    assert discover_inputs(wrong, episodes, spaces, history=False, given=Inputs()).history == 2


@pytest.mark.parametrize("seed", [0, 1])
def test_a_history_and_an_angle_that_are_needed_are_kept(seed: int) -> None:
    episodes, angle = pendulum(seed), Inputs(angles=(0.0,), turns=(2.0 * np.pi,))
    assert discover_inputs(angle, episodes, spaces_of(episodes), history=True, given=Inputs()) == angle
    hidden, longer = observing(episodes, [0]), replace(angle, history=2)
    assert discover_inputs(longer, hidden, spaces_of(hidden), history=True, given=angle) == longer
    late_cart = late(cart(seed))
    longer = Inputs(history=2)
    assert discover_inputs(longer, late_cart, spaces_of(late_cart), history=True, given=Inputs()) == longer


@pytest.mark.parametrize(("gain", "from_one", "from_two"), [(110.0, 2, 2), (90.0, 1, 2), (55.0, 1, 2), (45.0, 1, 1)])
def test_half_of_the_gain_that_adds_a_step_keeps_it(
    monkeypatch: pytest.MonkeyPatch, gain: float, from_one: int, from_two: int
) -> None:
    monkeypatch.setattr(discovery, "_evidence", lambda its, *others: Evidence(gain * (its.history > 1), 100.0))
    for before, after in ((1, from_one), (2, from_two)):
        inputs = Inputs(history=before)
        assert discover_inputs(inputs, cart(0), SPACES, history=True, given=Inputs()).history == after


@pytest.mark.parametrize(("count", "steps", "gain"), [(1, 15, 20.0), (3, HORIZON, 450.0), (9, HORIZON, 1000.0)])
def test_the_gain_that_adds_inputs_grows_with_the_predicted_numbers(count: int, steps: int, gain: float) -> None:
    episodes = cart(0).take(np.arange(count) % COUNT)
    episodes = replace(episodes, mask=episodes.mask & (np.arange(HORIZON) < steps))
    assert discovery._evidence(Inputs(), episodes, SPACES).least_gain == gain
