"""Optimism also rewards the model's uncertainty, so that a run that is stuck explores further."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.learning.model_based.real_experience import is_stuck
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import ModelBased
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Array
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from sim_nodes.envs.lever_stafford import Pendulum
from test.unit.conftest import model_free, refuse

MODEL = ModelBased(updates=15, rollouts=20, centres=60)
TRAINING = model_free(
    iterations=6,
    episodes_per_iteration=1,
    evaluate_every=0,
    horizon=60,
    exploration_sd=(0.5,),
    algorithm=RKHSNAC(centres=30),
    model=MODEL,
)


class WithoutRewards(Pendulum):
    """The pendulum without rewards, whose angle wraps around."""

    def __init__(self, num_envs: int = 1, max_episode_steps: int | None = None) -> None:
        super().__init__(num_envs, max_episode_steps, angle="wrap")

    def reward(self, states: Array, actions: Array) -> Array:
        return 0.0 * super().reward(states, actions)


def iterations_of(seed: int, task: Any = WithoutRewards) -> Iterator[Iteration]:
    training = replace(TRAINING, seed=seed, inputs=Inputs(angles=(0.0,)))
    return train(training, InlineRunner(Simulation(task)))


def learn(seed: int) -> list[Iteration]:
    return list(iterations_of(seed))


def cells(iterations: list[Iteration]) -> int:
    """Return the number of visited cells of a grid over the angle and the angular velocity."""
    episodes = iterations[-1].state.memory
    places = np.floor(episodes.flat(episodes.observations) / [np.pi / 8, 0.4])
    return len(np.unique(places, axis=0))


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [0, 1])
def test_a_task_without_rewards_is_explored_further_with_optimism(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    optimistic = learn(seed)
    monkeypatch.setattr(ModelRunner, "_novelty", lambda _, points: np.zeros(points.shape[:2]))
    assert cells(optimistic) > 1.2 * cells(learn(seed))


def episodes_with(returns: list[float], *, steps: int = 10, greatest: float = 1.0) -> Episodes:
    """Return episodes with given undiscounted returns, in which one step earns ``greatest``."""
    rewards = np.tile(np.array(returns)[:, None] / steps, (1, steps))
    rewards[:, 0], rewards[:, 1] = greatest, 2.0 * rewards[:, 0] - greatest
    nothing = np.zeros((*rewards.shape, 1))
    return Episodes.without_ends(nothing, nothing, rewards, np.ones(rewards.shape, dtype=bool))


@pytest.mark.parametrize(
    ("returns", "stuck"),
    [
        ([0.0], False),
        ([0.0, 0.0, 0.0], False),  # too early
        ([0.0, 0.0, 0.0, 0.0], True),
        ([0.0, -5.0, 0.4, -2.0, 0.0], True),  # of 10 that could be gained
        ([0.0, -5.0, 0.6, -2.0, 0.0], False),
        ([9.0, 9.04, 9.04, 9.04], True),
        ([9.0, 9.06, 9.0, 9.0], False),  # of 1 that could be gained
    ],
)
def test_a_run_is_stuck_while_no_return_is_clearly_above_the_first(returns: list[float], stuck: bool) -> None:
    episodes = episodes_with(returns)
    np.testing.assert_allclose(episodes.returns(1.0), returns, atol=1e-12)
    assert is_stuck(episodes, 1, 1.0) == stuck
    twice = episodes.take(np.repeat(np.arange(len(returns)), 2))
    assert is_stuck(twice, 2, 1.0) == stuck


def test_the_reward_of_reaching_a_goal_is_not_expected_in_every_step() -> None:
    rewards, nothing = np.full((4, 40), -0.1), np.zeros((4, 40, 1))
    rewards[3, 9], rewards[3, 10:] = 30.0, 0.0
    mask = np.arange(40) < np.array([[40], [40], [40], [10]])
    episodes = Episodes.without_ends(nothing, nothing, rewards, mask)
    assert is_stuck(episodes, 1, 1.0)  # at 30 per step
    assert not is_stuck(replace(episodes, terminated=np.array([False, False, False, True])), 1, 1.0)


def test_informative_rewards_from_the_start_cause_no_optimism(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ModelRunner, "_novelty", refuse)
    next(iterations_of(0, lambda **options: Pendulum(angle="wrap", **options)))


def constant(action: float) -> GaussianPolicy:
    mean = Function(RBF((1e4,)), np.zeros((1, 3)), np.array([[action]]))
    return GaussianPolicy(mean, ConstantVariance(np.full(1, 1e-12)), Inputs(angles=(0.0,)))


def test_novelty_is_small_at_visited_states_and_large_elsewhere() -> None:
    first = next(iterations_of(0))
    episodes, spaces = first.state.memory, Simulation(WithoutRewards).spaces
    model = DynamicsModel.fit(episodes, Inputs(angles=(0.0,)), spaces, 100)
    visited = episodes.flat(episodes.observations)
    elsewhere = np.column_stack([np.linspace(-1.0, 1.0, len(visited)), np.full(len(visited), 10.0)])
    means = []
    for starts in (visited, elsewhere):
        runner = ModelRunner(replace(model, starts=starts, visited=starts), optimism=1.0)
        rollouts = runner.collect(constant(0.0), Batch(0, 0, 200, 1, explore=False))
        rewards = rollouts.rewards[:, 0]
        assert (rewards >= 0.0).all()
        means.append(rewards.mean())
        points = np.column_stack([model.inputs.features(rollouts.observations[:, 0]), rollouts.actions[:, 0]])
        expected = (model.state_delta.sd(points) / model.state_delta.targets.scale).mean(axis=1)
        np.testing.assert_allclose(rewards, expected)
    near, far = means
    assert near < 0.3
    assert far > 3.0 * near


def test_novelty_is_finite_if_columns_are_constant_or_on_a_circle() -> None:
    rng = np.random.default_rng(0)
    first = next(iterations_of(0))
    angle = first.state.memory.observations[..., :1]
    observed = np.concatenate([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=2)
    final = np.concatenate([np.cos(angle[:, -1]), np.sin(angle[:, -1]), np.ones_like(angle[:, -1])], axis=1)
    episodes = replace(first.state.memory, observations=observed, final_observations=final)
    spaces = replace(Simulation(WithoutRewards).spaces, observation_shape=(3,), observation_names=())
    model = DynamicsModel.fit(episodes, Inputs(), spaces, 30)
    assert model.coordinates.circles == ((0, 1),)
    policy = GaussianPolicy(
        Function(RBF((1.0,)), rng.normal(size=(3, 3)), rng.normal(size=(3, 1))), ConstantVariance(np.ones(1))
    )
    rewards = ModelRunner(model, optimism=1.0).collect(policy, Batch(0, 0, 10, 20, explore=True)).rewards
    assert np.isfinite(rewards).all()
    assert rewards.max() > 0.0
