"""A policy that acts one observation at a time, as in the loop of a Gymnasium environment."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.validation import require
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Window
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, read_policy, save_policy
from rkhs_ros.rkhs.kernels import Array


class Policy:
    """A trained policy that maps an observation to an action, without exploration.

    It stores the window of past observations and actions; call `reset` at the start of each episode.

    Args:
        gaussian: mean, variance and inputs.
        task: the task that the policy was trained on.
        spaces: shape of an observation; bounds, shape and type of an action.

    Raises:
        ValueError: the dimensions of the policy and the spaces differ.

    Example::

        policy = rkhs_ros.load("policy.npz")
        policy.reset()
        action = policy(observation)
    """

    _held: Array | None  # mean actions of the last decision
    _steps_held: int

    def __init__(self, gaussian: GaussianPolicy, task: Task, spaces: Spaces) -> None:
        mean = gaussian.mean
        inputs = gaussian.inputs.dimension(spaces.observation_dim, spaces.action_dim)
        got, expected = (mean.input_dim, mean.output_dim), (inputs, spaces.action_dim)
        require(got == expected, "policy", f"one from {expected[0]} to {expected[1]} dimensions", got)
        self.gaussian = gaussian
        self.task = task
        self.spaces = spaces
        self.reset()

    def __call__(self, observation: Any) -> NDArray[np.floating[Any]]:
        """Return the action, clipped to its bounds, in the task's shape and type.

        Args:
            observation: one observation, or a batch with one per environment; the batch size may change only after
                `reset`.

        Raises:
            ValueError: the shape is wrong, or a number is not finite.
        """
        rows, one = self.spaces.rows(observation)
        require(bool(np.isfinite(rows).all()), "observation", "finite numbers", rows)
        if self._held is not None and self.gaussian.has_memory:
            expected = f"a batch of {len(self._held)} as before, or reset() first"
            require(len(self._held) == len(rows), "observation", expected, len(rows))
        if self._held is None or self._steps_held >= self.gaussian.action_repeat:
            self._held, self._steps_held = self.gaussian.mean(self._window.observed(rows)), 0
            self._window.acted(self._held)
        self._steps_held += 1
        actions = self.spaces.shaped(self._held)
        return actions[0, ...] if one else actions

    def reset(self) -> None:
        """Clear the window and the repeated action before a new episode."""
        self._window = Window(self.gaussian.inputs, self.spaces.action_dim)
        self._held, self._steps_held = None, 0

    def save(self, path: str | Path) -> None:
        """Write the policy to a file for `load` and the nodes.

        Raises:
            OSError: the file cannot be written.
        """
        save_policy(Path(path), self.gaussian, self.task, self.spaces)


def load(path: str | Path) -> Policy:
    """Load a policy from a file: policy.npz of a run, or a file from `Policy.save`.

    Raises:
        ValueError: the file is not a policy, or is damaged.
        FileNotFoundError: the file does not exist.
    """
    policy, task, spaces = read_policy(Path(path))
    mean = policy.mean  # a file without spaces: use unbounded ones of the mean's dimensions
    return Policy(policy, task, spaces or Spaces.unbounded(mean.input_dim, mean.output_dim))
