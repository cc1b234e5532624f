"""Episodes in a dynamics model as an environment are those of `ModelRunner`, and follow Gymnasium's conventions."""

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch, stream
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from rkhs_ros.rollouts.model_env import LearntModel

SPACES = Spaces((2,), np.array([-1.0]), np.array([1.0]))
HORIZON, EPISODES = 12, 3
INPUTS = {
    "an observation": Inputs(),
    "an angle": Inputs(angles=(0.0,)),
    "a window": Inputs(history=3),
    "monomials": Inputs(history=2, degree=2),
}


def episodes_of(rng: np.random.Generator) -> Episodes:
    """Return episodes of an oscillator, which end when the first number is above 1."""
    count, horizon = 40, HORIZON
    observations, actions = np.zeros((count, horizon + 1, 2)), rng.uniform(-1.5, 1.5, (count, horizon, 1))
    observations[:, 0] = rng.uniform(-0.8, 0.8, (count, 2))
    for t in range(horizon):
        x, v = observations[:, t].T
        push = np.clip(actions[:, t, 0], -1.0, 1.0) + 0.05 * rng.standard_normal(count)
        observations[:, t + 1] = np.stack([x + 0.3 * v, v - 0.3 * np.sin(x) + 0.4 * push], axis=1)
    over = observations[:, 1:, 0] > 1.0
    terminated = over.any(axis=1)
    last = np.where(terminated, over.argmax(axis=1), horizon - 1)
    mask = np.arange(horizon) <= last[:, None]
    rewards = np.where(mask, 1.0 - observations[:, :-1, 0] ** 2 - 5.0 * over, 0.0)
    final = observations[np.arange(count), last + 1]
    kept = mask[:, :, None]
    return Episodes(
        np.where(kept, observations[:, :-1], 0.0), np.where(kept, actions, 0.0), rewards, mask, final, terminated
    )


def policy_of(rng: np.random.Generator, inputs: Inputs) -> GaussianPolicy:
    size = inputs.dimension(2, 1)
    mean = Function(RBF((2.0,)), rng.normal(size=(8, size)), 0.3 * rng.normal(size=(8, 1)))
    return GaussianPolicy(mean, ConstantVariance(np.array([1.0])), inputs)


def model_of(rng: np.random.Generator, inputs: Inputs = Inputs()) -> LearntModel:  # noqa: B008
    return LearntModel(DynamicsModel.fit(episodes_of(rng), inputs, SPACES, 40), HORIZON, 1)


@pytest.mark.parametrize("inputs", INPUTS.values(), ids=INPUTS)
def test_an_episode_is_that_of_the_runner_with_the_same_draws(rng: np.random.Generator, inputs: Inputs) -> None:
    assert_like_the_runner(model_of(rng, inputs), policy_of(rng, inputs))


def test_an_episode_beyond_the_limits_is_that_of_the_runner(rng: np.random.Generator) -> None:
    model = model_of(rng)
    narrow = replace(model.dynamics, low=np.array([-2.0, -0.4]), high=np.array([2.0, 0.4]))
    least = narrow.least_reward
    earned = assert_like_the_runner(LearntModel(narrow, HORIZON, 1), policy_of(rng, Inputs()))
    assert 0.1 < np.mean(np.concatenate(earned) == least) < 0.9
    assert any(least not in each for each in earned)


def assert_like_the_runner(model: LearntModel, policy: GaussianPolicy) -> list[np.ndarray]:
    """Compare twenty episodes, and return their rewards."""
    environment, runner, terminated, earned = model.as_env(), ModelRunner(model.dynamics), 0, []
    for number in range(20):
        batch = Batch(7, 4 * number, 1, HORIZON, explore=True)  # of these numbers, which start like real episodes
        expected, acting = runner.collect(policy, batch), Acting(policy, batch, explore=True)
        environment.np_random = stream(batch.seed, "imagination", batch.first_episode)
        observation, _ = environment.reset()
        for step in range(expected.count):
            np.testing.assert_array_equal(observation, expected.observations[0, step])
            action = acting(step, observation[None])[0]
            np.testing.assert_array_equal(action, expected.actions[0, step])
            observation, reward, ends, cut, _ = environment.step(action)
            # The runner evaluates the rewards of an episode in one product.
            np.testing.assert_allclose(reward, expected.rewards[0, step], rtol=1e-9, atol=1e-9)
            assert (ends or cut) == (step == expected.count - 1)
        np.testing.assert_array_equal(observation, expected.final_observations[0])
        assert ends == expected.terminated[0]
        with pytest.raises(ResetNeeded):
            environment.step(action)
        terminated += ends
        earned.append(expected.rewards[0, : expected.count])
    assert 0 < terminated < 20
    return earned


def test_the_environment_follows_gymnasium(rng: np.random.Generator) -> None:
    model = model_of(rng)
    with pytest.raises(ResetNeeded, match=r"^step: cannot step before reset\(\); call reset\(\) first$"):
        model.as_env().step(np.zeros(1))
    with pytest.warns(UserWarning, match="infinity"):  # the bounds of the observations are not known
        check_env(model.as_env(), skip_render_check=True)
