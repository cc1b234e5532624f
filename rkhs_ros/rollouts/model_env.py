"""The learnt dynamics model of a run as a Gymnasium environment, in which any learner can train."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from rkhs_ros.base.threads import one_thread
from rkhs_ros.base.validation import require
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.model_rollouts import Draws, ModelRunner
from rkhs_ros.learning.model_based.settings import ModelBased
from rkhs_ros.learning.model_based.training_in_model import fit_model, reward_margin
from rkhs_ros.learning.state import State
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

Values = NDArray[np.floating[Any]]
Flags = NDArray[np.bool_]
Info = dict[str, Any]


@dataclass(frozen=True)
class LearntModel:
    """The learnt dynamics model of a run, which can serve as a Gymnasium environment.

    A step of the model is one decision of the policy, which is ``action_repeat`` steps of the task. Its reward is the
    discounted sum of the rewards of these steps.

    Attributes:
        dynamics: the dynamics model, with one step per decision.
        horizon: maximum number of decisions per episode.
        action_repeat: number of steps of the task per decision.
        reward_margin: how far rewards may lie outside the observed range, relative to the width of that range.

    Example::

        environment = result.model.as_env()
        observation, info = environment.reset(seed=0)
        observation, reward, terminated, truncated, info = environment.step(environment.action_space.sample())
    """

    dynamics: DynamicsModel
    horizon: int
    action_repeat: int
    reward_margin: float = 0.0

    @classmethod
    def of(cls, training: Training, state: State, spaces: Spaces) -> LearntModel:
        """Fit the model of a run to all its real episodes.

        The result is bit-identical to the model of the last iteration.

        Raises:
            ValueError: the run has no model or no episode yet, or a prior function does not exist.
            RunError: a prior function failed.
        """
        if not isinstance(training.model, ModelBased):
            raise ValueError("model: expected a run with model-based training, got one without")
        require(len(state.memory) > 0, "model: episodes", "at least one real episode", 0)
        repeat = state.policy.action_repeat
        decisions = state.memory.decisions(repeat, training.discount, spaces)
        with one_thread():
            dynamics = fit_model(training.model, state.policy.inputs, decisions, spaces)
        return cls(dynamics, decisions.horizon, repeat, reward_margin(decisions))

    def __repr__(self) -> str:
        """Return the sizes of the model, since its arrays fill many pages."""
        spaces = self.dynamics.spaces
        return (
            f"<LearntModel of {spaces.observation_dim} observations and {spaces.action_dim} actions,"
            f" horizon {self.horizon}, action_repeat {self.action_repeat}>"
        )

    def as_env(self, caution: float = 1.0) -> ModelEnv:
        """Return the model as a Gymnasium environment.

        Args:
            caution: factor on the deviation of the drawn functions from their posterior mean; 0 for the mean.
        """
        return ModelEnv(self.as_vector_env(1, caution))

    def as_vector_env(self, num_envs: int, caution: float = 1.0) -> ModelVectorEnv:
        """Return the model as a Gymnasium vector environment; see `ModelVectorEnv` for the arguments and errors."""
        return ModelVectorEnv(self, num_envs, caution)


class ModelVectorEnv(VectorEnv[Values, Values, Any]):
    """A dynamics model as a vector environment.

    Each episode uses the random stream of its environment to draw the initial observation of a real episode, functions
    from the posterior, and the noise of all steps. The first step after the end of an episode resets its environment,
    ignores the action and returns the reward 0.

    Args:
        model: the model.
        num_envs: number of environments, at least 1.
        caution: factor on the deviation of the drawn functions from their posterior mean; 0 for the mean.

    Raises:
        ValueError: the number of environments or the caution is invalid.
    """

    metadata: Info = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}

    def __init__(self, model: LearntModel, num_envs: int, caution: float = 1.0) -> None:
        require(type(num_envs) is int and num_envs >= 1, "num_envs", "a whole number >= 1", num_envs)
        require(isinstance(caution, float | int) and 0.0 <= caution < np.inf, "caution", "a number >= 0", caution)
        dynamics, spaces = model.dynamics, model.dynamics.spaces
        self.num_envs = num_envs
        self.single_observation_space = Box(-np.inf, np.inf, spaces.observation_shape, np.float64)
        self.single_action_space = Box(spaces.action_low, spaces.action_high, dtype=spaces.action_low.dtype.type)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._dynamics = dynamics
        self._horizon = model.horizon
        self._runner = ModelRunner(dynamics, caution, reward_margin=model.reward_margin)
        self._streams: list[np.random.Generator] = []
        self._draws: Draws
        history = dynamics.inputs.history
        # The observations of the window end with the current one; the entry before the window is unused.
        self._observations = np.zeros((num_envs, history + 1, spaces.observation_dim))
        self._actions = np.zeros((num_envs, history, spaces.action_dim))
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(self, *, seed: int | list[int | None] | None = None, options: Info | None = None) -> tuple[Values, Info]:
        """Start an episode in every environment.

        Args:
            seed: a seed for each environment, or one number, from which environment i gets ``seed + i``; None to
                continue the random streams.
            options: ignored.

        Returns:
            The observations, in the shape of ``observation_space``, and an empty dictionary.

        Raises:
            ValueError: the number of seeds is wrong.
        """
        if seed is not None or not self._streams:
            given = [seed + index for index in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
            seeds = [None] * self.num_envs if given is None else given
            require(len(seeds) == self.num_envs, "seed", f"{self.num_envs} seeds, one for each environment", len(seeds))
            self._streams = [seeding.np_random(each)[0] for each in seeds]
        return self.restart(self._streams), {}

    def restart(self, streams: list[np.random.Generator]) -> Values:
        """Start an episode in every environment with the given random streams; return the observations."""
        self._streams = streams
        self._begin(np.ones(self.num_envs, dtype=bool))
        return self._current()

    def step(self, actions: ArrayLike) -> tuple[Values, Values, Flags, Flags, Info]:
        """Advance every environment by one step; reset those whose episode has ended.

        Args:
            actions: an action for each environment, clipped to its bounds, in the shape of ``action_space``.

        Returns:
            The observations, in the shape of ``observation_space``; rewards, terminated and truncated, shape
            (num_envs,); and an empty dictionary.

        Raises:
            ResetNeeded: `reset` was not called before.
            ValueError: an action has the wrong size, or is not finite.
        """
        if not self._streams:
            raise ResetNeeded("step: cannot step before reset(); call reset() first")
        newest, over = np.array([self._dynamics.inputs.history]), self._over
        flat = self._flattened(actions, ignored=over)
        inputs = self._dynamics.inputs.at(newest, self._observations, self._actions)[:, 0]
        steps = np.minimum(self._steps, self._horizon - 1)  # results of environments that are reset are discarded below
        made = self._runner.step(self._draws, steps, inputs, self._observations[:, -1], flat)
        self._observations = np.concatenate([self._observations[:, 1:], made.final_observations[:, None]], axis=1)
        self._actions = np.concatenate([self._actions[:, 1:], flat[:, None]], axis=1)
        self._steps += 1
        if over.any():
            self._begin(over)
        rewards, terminated = np.where(over, 0.0, made.rewards[:, 0]), made.terminated & ~over
        truncated = self._steps == self._horizon
        self._over = terminated | truncated
        return self._current(), rewards, terminated, truncated, {}

    def _flattened(self, actions: ArrayLike, ignored: Flags) -> Array:
        """Return checked actions, shape (num_envs, n); those of ignored environments need not be finite."""
        given, size = np.asarray(actions, dtype=np.float64), self._dynamics.spaces.action_dim
        expected = f"finite numbers, {size} for each environment"
        require(given.size == self.num_envs * size, "action", expected, given.tolist())
        flat: Array = given.reshape(self.num_envs, size)
        require(bool(np.isfinite(flat[~ignored]).all()), "action", expected, given.tolist())
        return flat

    def _begin(self, which: Flags) -> None:
        """Start an episode in some environments."""
        streams = [own for own, begins in zip(self._streams, which, strict=True) if begins]
        first = np.stack([self._dynamics.draw_start(own) for own in streams])
        draws = self._runner.draw(streams, self._horizon)
        self._draws = draws if which.all() else self._draws.with_rows(which, draws)
        self._observations[which], self._actions[which], self._steps[which] = first[:, None], 0.0, 0
        self._over = self._over & ~which

    def _current(self) -> Values:
        now: Array = self._observations[:, -1]
        return now.reshape(self.observation_space.shape or ()).copy()


class ModelEnv(gymnasium.Env[Values, Values]):
    """A dynamics model as a single environment.

    With the same random stream, its episodes are those of a vector environment.

    Args:
        environments: a vector environment of one environment.
    """

    metadata: Info = {"render_modes": []}

    def __init__(self, environments: ModelVectorEnv) -> None:
        self.observation_space = environments.single_observation_space
        self.action_space = environments.single_action_space
        self._environments = environments

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Values, Info]:
        """Start an episode; without a seed, continue the random stream ``np_random``. Options are ignored."""
        super().reset(seed=seed)
        return self._environments.restart([self.np_random])[0], {}

    def step(self, action: ArrayLike) -> tuple[Values, float, bool, bool, Info]:
        """Advance by one step, which is one decision, with an action in the shape of ``action_space``.

        Raises:
            ResetNeeded: `reset` was not called before.
            ValueError: the action has the wrong size, or is not finite.
        """
        observations, rewards, terminated, truncated, info = self._environments.step(np.asarray(action)[None])
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info
