"""The learnt dynamics model of a run as a Gymnasium environment, in which any learner can train."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from rkhs_ros.base.processes import one_thread
from rkhs_ros.base.validation import require
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.model_rollouts import Draws, ModelRunner
from rkhs_ros.learning.model_based.training_in_model import fit_model
from rkhs_ros.learning.state import State
from rkhs_ros.learning.training_settings import ModelBased, Training
from rkhs_ros.policies.inputs import Window
from rkhs_ros.policies.spaces import Spaces

Values = NDArray[np.floating[Any]]
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

    Example::

        environment = result.model.as_env()
        observation, info = environment.reset(seed=0)
        observation, reward, terminated, truncated, info = environment.step(environment.action_space.sample())
    """

    dynamics: DynamicsModel
    horizon: int
    action_repeat: int

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
        priors = training.model.priors(spaces.observation_dim, repeat, training.discount)
        with one_thread():
            dynamics = fit_model(training.model, state.policy.inputs, decisions, spaces, priors)
        return cls(dynamics, decisions.horizon, repeat)

    def __repr__(self) -> str:
        """Return the sizes of the model, since its arrays fill many pages."""
        spaces = self.dynamics.spaces
        return (
            f"<LearntModel of {spaces.observation_dim} observations and {spaces.action_dim} actions,"
            f" horizon {self.horizon}, action_repeat {self.action_repeat}>"
        )

    def as_env(self) -> ModelEnv:
        """Return the model as a Gymnasium environment."""
        return ModelEnv(self)


class ModelEnv(gymnasium.Env[Values, Values]):
    """A dynamics model as an environment.

    Each episode draws from the random stream ``np_random`` an initial observation like those of real episodes,
    functions from the posterior, and the noise of all steps.
    """

    metadata: Info = {"render_modes": []}

    def __init__(self, model: LearntModel) -> None:
        self._dynamics, spaces = model.dynamics, model.dynamics.spaces
        self.observation_space = Box(-np.inf, np.inf, spaces.observation_shape, np.float64)
        self.action_space = Box(spaces.action_low, spaces.action_high, dtype=spaces.action_low.dtype.type)
        self._horizon = model.horizon
        self._runner = ModelRunner(self._dynamics)
        self._draws: Draws | None = None

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Values, Info]:
        """Start an episode; without a seed, continue the random stream. Options are ignored."""
        super().reset(seed=seed)
        self._path = self._dynamics.draw_start(self.np_random)[None, None]  # observations so far, shape (1, t + 1, d)
        self._draws = self._runner.draw([self.np_random], self._horizon)
        self._window = Window(self._dynamics.inputs, self._dynamics.spaces.action_dim)
        return self._observation(), {}

    def step(self, action: ArrayLike) -> tuple[Values, float, bool, bool, Info]:
        """Advance by one step, which is one decision, with an action in the shape of ``action_space``.

        Raises:
            ResetNeeded: no episode has begun, or the last one is over.
            ValueError: the action has the wrong size, or is not finite.
        """
        if self._draws is None:
            raise ResetNeeded("step: cannot step before reset(); call reset() first")
        given, size = np.asarray(action, dtype=np.float64), self._dynamics.spaces.action_dim
        good = given.size == size and bool(np.isfinite(given).all())
        require(good, "action", f"{size} finite numbers", given.tolist())
        flat = given.reshape(1, size)
        inputs = self._window.observed(self._path[:, -1])
        self._window.acted(flat)
        made = self._runner.step(self._draws, self._path, inputs, flat)
        self._path = np.concatenate([self._path, made.final_observations[:, None]], axis=1)
        ends = bool(made.terminated[0]), self._path.shape[1] > self._horizon
        if any(ends):
            self._draws = None
        return self._observation(), float(made.rewards[0, 0]), *ends, {}

    def _observation(self) -> Values:
        now: Values = self._path[0, -1]
        return now.reshape(self.observation_space.shape or ()).copy()
