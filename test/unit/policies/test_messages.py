"""Messages between learner, policy and simulators: round trips, and rejection of invalid messages."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.messages import policy_message, policy_of
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.definitions import Types
from rkhs_ros.recordings.messages import episodes_message, episodes_of
from test.unit.conftest import arrays_of, random_episodes, random_policy

ROWS, HORIZON = 3, 4
BATCH = Batch(0, 0, ROWS, HORIZON, explore=True)


@pytest.fixture
def episodes(rng: np.random.Generator) -> Episodes:
    return random_episodes(rng, random_policy(rng), ROWS, HORIZON, masked=True)


def test_episodes_survive_a_round_trip_bit_identically(episodes: Episodes) -> None:
    back = episodes_of(episodes_message(Types(), 1, 1, episodes), BATCH, Spaces.unbounded(2, 2))
    before, after = arrays_of(episodes), arrays_of(back)
    assert {name: array.tobytes() for name, array in before.items()} == {n: a.tobytes() for n, a in after.items()}


@pytest.mark.parametrize("length", [0, HORIZON + 1])
def test_an_episode_of_invalid_length_is_rejected(episodes: Episodes, length: int) -> None:
    message = episodes_message(Types(), 1, 1, episodes)
    message.lengths[-1] = length
    with pytest.raises(ValueError, match="episodes' lengths: expected 1 to 4 steps"):
        episodes_of(message, BATCH, Spaces.unbounded(2, 2))


@pytest.mark.parametrize("name", ["observations", "actions", "rewards", "final_observations"])
def test_non_finite_episodes_are_rejected(episodes: Episodes, name: str) -> None:
    message = episodes_message(Types(), 1, 1, episodes)
    getattr(message, name)[-1] = np.inf
    with pytest.raises(ValueError, match=f"episodes' {name.replace('_', ' ')}: expected finite numbers"):
        episodes_of(message, BATCH, Spaces.unbounded(2, 2))


@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (lambda p: setattr(p, "centres", p.centres[:-1]), "centres: expected rows of 2 numbers, got 9 numbers"),
        (lambda p: p.weights.__setitem__(-1, np.nan), "weights: expected finite numbers"),
        (lambda p: setattr(p.variance, "name", "constnt"), "variance: expected one of constant, kernel, function"),
        (lambda p: setattr(p, "action_repeat", 0), "action_repeat: expected 1 to 1000, got 0"),
        (lambda p: setattr(p.inputs, "turns", [360.0]), "inputs.turns: expected 0 numbers, one per angle, or none"),
    ],
)
def test_invalid_policies_are_rejected(rng: np.random.Generator, spoil: Callable[[Any], object], error: str) -> None:
    message = policy_message(Types(), random_policy(rng), 1)
    spoil(message)
    with pytest.raises(ValueError, match=error):
        policy_of(message)
