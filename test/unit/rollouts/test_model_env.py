"""Episodes in a dynamics model as an environment are those of `ModelRunner`, and follow Gymnasium's conventions."""

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.streams import Batch, stream
from rkhs_ros.rollouts.model_env import LearntModel
from test.unit.learning.model.test_model_rollouts import HORIZON, SPACES, policy_of, simulated_episodes

INPUTS = {
    "an observation": Inputs(),
    "an angle": Inputs(angles=(0.0,)),
    "a window": Inputs(history=3),
    "monomials": Inputs(history=2, degree=2),
}


def model_of(rng: np.random.Generator, inputs: Inputs = Inputs()) -> LearntModel:  # noqa: B008
    return LearntModel(DynamicsModel.fit(simulated_episodes(rng, rows=40, ending=True), inputs, SPACES, 40), HORIZON, 1)


@pytest.mark.parametrize("inputs", INPUTS.values(), ids=INPUTS)
def test_an_episode_is_that_of_the_runner_with_the_same_draws(rng: np.random.Generator, inputs: Inputs) -> None:
    assert_like_the_runner(model_of(rng, inputs), policy_of(rng, inputs, sd=1.0))


def test_an_episode_beyond_the_limits_is_that_of_the_runner(rng: np.random.Generator) -> None:
    model = model_of(rng)
    narrow = replace(model.dynamics, low=np.array([-2.0, -0.4]), high=np.array([2.0, 0.4]))
    least = narrow.least_reward
    earned = assert_like_the_runner(LearntModel(narrow, HORIZON, 1), policy_of(rng, sd=1.0))
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
