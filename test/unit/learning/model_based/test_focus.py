"""Training for the initial observations alone, if they are almost the same."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.learning.model_based import training_in_model
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import ModelBased
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from test.unit.conftest import model_free

ROWS, STEPS = 4, 30


def walks(rng: np.random.Generator, starts: Array) -> Episodes:
    """Return episodes whose columns move by small steps in the direction of the action, from given observations."""
    rows, d = starts.shape
    actions = rng.uniform(-1.0, 1.0, (rows, STEPS, 1))
    moves = 0.2 * actions + 0.02 * rng.standard_normal((rows, STEPS, d))
    observations = starts[:, None] + np.concatenate([np.zeros((rows, 1, d)), np.cumsum(moves, axis=1)], axis=1)
    return of_observations(observations, actions)


def of_observations(observations: Array, actions: Array) -> Episodes:
    """Return episodes that end by their time limit, with rewards of 0."""
    shape = actions.shape[:2]
    before, last = observations[:, :-1], observations[:, -1]
    return Episodes(before, actions, np.zeros(shape), np.ones(shape, dtype=bool), last, np.zeros(shape[0], dtype=bool))


def fitted(episodes: Episodes, inputs: Inputs | None = None) -> DynamicsModel:
    spaces = Spaces(episodes.observations.shape[2:], -np.ones(1), np.ones(1))
    return DynamicsModel.fit(episodes, inputs or Inputs(), spaces, 20)


@pytest.mark.parametrize(("share", "varies"), [(0.0, False), (0.08, False), (0.12, True), (1.0, True)])
def test_starts_vary_if_their_spread_is_not_small(rng: np.random.Generator, share: float, varies: bool) -> None:
    still = walks(rng, np.zeros((ROWS, 2)))
    spread = still.flat(still.observations).std(axis=0)[0]
    shift = share * spread * np.outer([-1.0, 1.0, -1.0, 1.0], [1.0, 0.0])
    observations, final = still.observations + shift[:, None], still.final_observations + shift
    moved = replace(still, observations=observations, final_observations=final)
    assert fitted(moved).starts_vary == varies


def test_neither_units_nor_offsets_matter(rng: np.random.Generator) -> None:
    unit = 1e3
    for spread in (0.01, 1.0):
        episodes = walks(rng, spread * rng.standard_normal((ROWS, 2)))
        told = replace(
            episodes,
            observations=unit * (episodes.observations + 5.0),
            final_observations=unit * (episodes.final_observations + 5.0),
        )
        assert fitted(told).starts_vary == fitted(episodes).starts_vary


def test_columns_of_noise_and_constants_do_not_matter(rng: np.random.Generator) -> None:
    episodes = walks(rng, 0.01 * rng.standard_normal((ROWS, 2)))
    observations = np.concatenate([episodes.observations, episodes.final_observations[:, None]], axis=1)
    shape = (ROWS, STEPS + 1, 1)
    more = np.concatenate([observations, rng.standard_normal(shape), np.ones(shape)], axis=2)
    assert not fitted(of_observations(more, episodes.actions)).starts_vary


def test_an_angle_at_its_jump_does_not_vary(rng: np.random.Generator) -> None:
    episodes = walks(rng, np.pi + 0.01 * np.array([[-1.0], [1.0], [-1.0], [1.0]]))

    def wrap(angles: Array) -> Array:
        return np.mod(angles + np.pi, 2 * np.pi) - np.pi

    wrapped = replace(
        episodes, observations=wrap(episodes.observations), final_observations=wrap(episodes.final_observations)
    )
    assert fitted(wrapped).starts_vary
    assert not fitted(wrapped, Inputs(angles=(0,))).starts_vary


def ridges_of_a_run(environment: str) -> list[tuple[float, float]]:
    """Return the ridge and the value ridge of all updates of two iterations, without repetitions."""
    used: dict[tuple[float, float], None] = {}

    @dataclass(frozen=True)
    class Spy(RKHSNAC):
        def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
            used[self.ridge, self.value_ridge] = None
            return super().update(policy, experience)

    learn(Spy(centres=10, ridge=0.01, value_ridge=0.001), environment)
    return list(used)


def learn(algorithm: RKHSNAC, environment: str) -> None:
    """Train for two iterations."""
    model = ModelBased(updates=2, rollouts=4, centres=20)
    shared = {"iterations": 2, "episodes_per_iteration": 1, "evaluation_episodes": 1, "exploration_sd": "range"}
    with InlineRunner(Simulation(environment)) as runner:
        list(train(model_free(**shared, horizon=20, algorithm=algorithm, model=model), runner))


def test_ridges_are_smaller_once_the_starts_are_known_to_be_the_same() -> None:
    usual, small = (0.01, 0.001), (1e-4, 1e-5)
    assert ridges_of_a_run("rkhs/CartPoleSwingUp-v0") == [usual, small]
    assert ridges_of_a_run("Pendulum-v1") == [usual]  # which starts at random angles


@pytest.mark.parametrize(("environment", "count"), [("rkhs/CartPoleSwingUp-v0", 1), ("Pendulum-v1", 5)])
def test_rollouts_share_five_worlds_and_visit_states_if_starts_vary(
    environment: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    used = []

    class Spy(ModelRunner):
        def __init__(self, model: DynamicsModel, **options: Any) -> None:
            used.append((len(options.get("worlds", ())), options.get("visited_starts", True)))
            super().__init__(model, **options)

    monkeypatch.setattr(training_in_model, "ModelRunner", Spy)
    learn(RKHSNAC(centres=10), environment)
    assert used[-2:] == [(count, count > 1), (0, False)]  # the policy for use is the best in all functions
