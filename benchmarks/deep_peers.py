"""Train SAC of Stable-Baselines3 and CrossQ of sb3-contrib with default settings, on the inputs of our policies.

Both are imported on first use, since the import is slow and they may not be installed.
"""

from importlib import import_module
from typing import Any

import gymnasium
import numpy as np

import sim_nodes.envs  # noqa: F401  # registers the project's tasks
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config
from trial import Meter, Point, Trial

MODULES = {"SAC": "stable_baselines3", "CrossQ": "sb3_contrib"}
EVALUATED_EVERY = 5  # episodes


class SeenThrough(gymnasium.Wrapper[Array, Array, Any, Any]):
    """An environment whose observations are the inputs of a policy. Owns the observations and actions of the episode.

    Args:
        env: an environment with flat observations and actions.
        inputs: the inputs to compute from them.
        horizon: steps of an episode.
    """

    def __init__(self, env: Any, inputs: Inputs, horizon: int) -> None:
        super().__init__(env)
        self._inputs, self._horizon = inputs, horizon
        size = inputs.dimension(env.observation_space.shape[0], env.action_space.shape[0])
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def reset(self, **options: Any) -> tuple[Array, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(**options)
        self._step = 0
        self._seen = np.zeros((1, self._horizon + 1, len(observation)))
        self._done = np.zeros((1, self._horizon + 1, *self.env.action_space.shape))
        return self._shown(observation), info

    def step(self, action: Array) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Run a step."""
        self._done[0, self._step] = action
        observation, *rest = self.env.step(action)
        self._step += 1
        return self._shown(observation), *rest

    def _shown(self, observation: Array) -> Array:
        self._seen[0, self._step] = observation
        return self._inputs.at(np.array([self._step]), self._seen, self._done)[0, 0]


def world(config: Config) -> SeenThrough:
    """Return the environment of a configuration, truncated at the horizon."""
    environment, training = config.environment, config.training
    env = gymnasium.make(environment.id, max_episode_steps=training.horizon, **environment.options)
    return SeenThrough(env, training.inputs, training.horizon)


def learn(name: str, trial: Trial) -> list[Point]:
    """Return the learning curve of a learner, given by the name of its class."""
    import_module("torch").set_num_threads(1)
    training, budget = trial.config.training, trial.episodes
    meter, evaluated, points = Meter(training.discount), world(trial.config), []
    make = getattr(import_module(MODULES[name]), name)
    model = make("MlpPolicy", world(trial.config), gamma=training.discount, seed=training.seed, device="cpu")

    def after_step(variables: dict[str, Any], _: dict[str, Any]) -> bool:
        meter.steps += 1
        meter.episodes += int(variables["dones"][0])
        if variables["dones"][0] and (meter.episodes % EVALUATED_EVERY == 0 or meter.episodes == budget):
            with meter.paused():
                rows = training.evaluation_episodes
                batch = Batch(training.seed, len(points) * rows, rows, training.horizon, explore=False)
                rewards = np.array([_rewards(model, evaluated, seed, batch) for seed in batch.environment_seeds()])
            points.append(meter.point(rewards))
        return meter.episodes < budget

    model.learn(budget * training.horizon, callback=after_step)
    return points


def _rewards(model: Any, env: SeenThrough, seed: int, batch: Batch) -> Array:
    """Return the rewards of an evaluation episode, shape (horizon,), 0 after its end."""
    rewards, step, over = np.zeros(batch.horizon), 0, False
    observation, _ = env.reset(seed=seed)
    while not over:
        action, _ = model.predict(observation, deterministic=True)
        observation, rewards[step], terminated, truncated, _ = env.step(action)
        over, step = terminated or truncated, step + 1
    return rewards
