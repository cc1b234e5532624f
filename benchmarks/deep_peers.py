"""Train SAC of Stable-Baselines3 and CrossQ of sb3-contrib with default settings, on the inputs of our policies.

Both are imported on first use, since the import is slow and they may not be installed.
"""

from importlib import import_module
from typing import Any

import gymnasium
import numpy as np

import sim_nodes.envs  # noqa: F401  # registers the project's tasks
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.rkhs.kernels import Array
from trial import Meter, Point, Trial

MODULES = {"SAC": "stable_baselines3", "CrossQ": "sb3_contrib"}
EVALUATED_EVERY = 5  # episodes


class SeenThrough(gymnasium.Wrapper[Array, Array, Any, Any]):
    """An environment whose observations are the inputs of a policy, which holds its actions. Owns the episode.

    Args:
        env: an environment with flat observations and actions.
        inputs: the inputs to compute from its observations and actions.
        horizon: steps of an episode.
        repeat: steps for which an action is held; its reward is the sum of theirs.

    Attributes:
        observations: raw observations before each step of the episode, shape (horizon, d).
        rewards: rewards of the steps, shape (horizon,), 0 after the end.
        total: number of steps of all episodes so far.
    """

    def __init__(self, env: Any, inputs: Inputs, horizon: int, repeat: int) -> None:
        super().__init__(env)
        self._inputs, self._horizon, self._repeat = inputs, horizon, repeat
        self.total = 0
        size = inputs.dimension(env.observation_space.shape[0], env.action_space.shape[0])
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def reset(self, **options: Any) -> tuple[Array, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(**options)
        self._steps, self._decisions = 0, 0
        self.rewards = np.zeros(self._horizon)
        self.observations = np.zeros((self._horizon, len(observation)))
        self._seen = np.zeros((1, self._horizon + 1, len(observation)))
        self._done = np.zeros((1, self._horizon + 1, *self.env.action_space.shape))
        self._now = observation
        return self._shown(), info

    def step(self, action: Array) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Run the steps of a decision."""
        self._done[0, self._decisions] = action
        earned = 0.0
        for _ in range(self._repeat):
            self.observations[self._steps] = self._now
            self._now, reward, terminated, truncated, info = self.env.step(action)
            self.rewards[self._steps] = reward
            earned += float(reward)
            self._steps, self.total = self._steps + 1, self.total + 1
            if terminated or truncated:
                break
        self._decisions += 1
        return self._shown(), earned, terminated, truncated, info

    def _shown(self) -> Array:
        self._seen[0, self._decisions] = self._now
        return self._inputs.at(np.array([self._decisions]), self._seen, self._done)[0, 0]


def world(trial: Trial) -> SeenThrough:
    """Return the environment of a trial, flattened and truncated at the horizon."""
    environment, training = trial.config.environment, trial.config.training
    env: Any = gymnasium.make(environment.id, max_episode_steps=training.horizon, **environment.options)
    if not isinstance(env.observation_space, gymnasium.spaces.Box):
        env = gymnasium.wrappers.FlattenObservation(env)
    return SeenThrough(env, training.inputs, training.horizon, trial.repeat)


def learn(name: str, trial: Trial) -> list[Point]:
    """Return the learning curve of a learner, given by the name of its class."""
    import_module("torch").set_num_threads(1)
    training, budget = trial.config.training, trial.episodes
    meter, evaluated, points, env = Meter(trial), world(trial), list[Point](), world(trial)
    seeds = [seed % 2**32 for seed in trial.evaluation.environment_seeds()]  # dm_control accepts no others
    model = getattr(import_module(MODULES[name]), name)("MlpPolicy", env, seed=training.seed, device="cpu")

    def after_step(variables: dict[str, Any], _: dict[str, Any]) -> bool:
        if variables["dones"][0]:
            meter.episodes, meter.steps = meter.episodes + 1, env.total
            if meter.episodes % EVALUATED_EVERY == 0 or meter.episodes == budget:
                with meter.paused():
                    episodes = [_episode(model, evaluated, seed) for seed in seeds]
                rewards, observations = (np.array(each) for each in zip(*episodes, strict=True))
                points.append(meter.point(rewards, observations, trial.repeat))
        return meter.episodes < budget

    model.learn(budget * training.horizon, callback=after_step)
    return points


def _episode(model: Any, env: SeenThrough, seed: int) -> tuple[Array, Array]:
    """Return the rewards and observations of an evaluation episode, shapes (horizon,) and (horizon, d)."""
    over, (observation, _) = False, env.reset(seed=seed)
    while not over:
        action, _ = model.predict(observation, deterministic=True)
        observation, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
    return env.rewards, env.observations
