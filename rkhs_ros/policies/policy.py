"""A policy to act with, one observation after the other, as an environment's loop wants it."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.validation import require
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, read_policy, save_policy
from rkhs_ros.rkhs.kernels import Array


class Policy:
    """A learnt policy that is called with what is observed and returns what to do, without exploration.

    Owns the window of observations and actions that it looks back on; `reset` empties it when an episode begins.

    Args:
        gaussian: mean, variance and inputs.
        task: what it was learnt on.
        spaces: shape of an observation, bounds, shape and type of an action.

    Raises:
        ValueError: the policy does not fit the spaces.
    """

    def __init__(self, gaussian: GaussianPolicy, task: Task, spaces: Spaces) -> None:
        mean = gaussian.mean
        inputs = gaussian.inputs.dimension(spaces.observation_dim, spaces.action_dim)
        got, expected = (mean.input_dim, mean.output_dim), (inputs, spaces.action_dim)
        require(got == expected, "policy", f"one from {expected[0]} to {expected[1]} dimensions", got)
        self.gaussian = gaussian
        self.task = task
        self.spaces = spaces
        self._observations: deque[Array] = deque(maxlen=gaussian.inputs.history + 1)
        self._actions: deque[Array] = deque(maxlen=gaussian.inputs.history + 1)

    def __call__(self, observation: Any) -> NDArray[np.floating[Any]]:
        """Return the action, within its bounds and in the task's shape and type.

        Args:
            observation: one, or one for each of several rows; the same number of rows until the next `reset`.

        Raises:
            ValueError: the shape is another one, or a number is not finite.
        """
        rows, one = self.spaces.rows(observation)
        require(bool(np.isfinite(rows).all()), "observation", "finite numbers", rows)
        actions = self.spaces.shaped(self._mean(rows))
        return actions[0, ...] if one else actions

    def __repr__(self) -> str:
        """Return what the policy is of in one line."""
        mean = self.gaussian.mean
        sizes = f"{mean.input_dim} inputs, {mean.output_dim} actions, {len(mean.centres)} centres"
        return f"<Policy of {self.task.environment}: {sizes}>"

    def reset(self) -> None:
        """Forget what was observed and done: another episode begins."""
        self._observations.clear()
        self._actions.clear()

    def save(self, path: str | Path) -> None:
        """Write the policy to a file, from which `load` and the nodes read it.

        Raises:
            OSError: it cannot be written.
        """
        save_policy(Path(path), self.gaussian, self.task, self.spaces)

    def _mean(self, rows: Array) -> Array:
        """Return the mean actions, not clipped, shape (rows, action_dim)."""
        if self.gaussian.inputs.history == 1:
            return self.gaussian.mean(self.gaussian.inputs.features(rows))
        if self._observations and len(self._observations[0]) != len(rows):
            expected = f"{len(self._observations[0])} rows as before, or reset() before other ones"
            raise ValueError(f"observation: expected {expected}, got {len(rows)}")
        self._observations.append(rows)
        self._actions.append(np.zeros((len(rows), self.spaces.action_dim)))  # of this step, not known yet
        newest = np.array([len(self._observations) - 1])
        seen, done = (np.stack(list(past), axis=1) for past in (self._observations, self._actions))
        actions = self.gaussian.mean(self.gaussian.inputs.at(newest, seen, done)[:, 0])
        self._actions[-1] = actions
        return actions


def load(path: str | Path) -> Policy:
    """Read a policy from a file: policy.npz of a run, or one that was saved.

    Raises:
        ValueError: the file holds no policy, or a damaged one.
        FileNotFoundError: there is no such file.
    """
    saved = read_policy(Path(path))
    mean = saved.policy.mean  # a file that does not tell the spaces: plain numbers, as many as the mean takes
    return Policy(saved.policy, saved.task, saved.spaces or Spaces.unbounded(mean.input_dim, mean.output_dim))
