"""Prior knowledge of a task that replaces learnt parts of the model: reward, termination or dynamics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.user_code import call_user_function, user_function
from rkhs_ros.base.validation import LARGEST, finite_array, require, truncated
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class Priors:
    """User functions that replace learnt parts of the model; None for a part that is learnt.

    All functions take batches: raw observations of shape (n, d) and clipped actions of shape (n, m). Rewards and
    changes are those of a step of the task. A step of the model is a decision, which may hold its action for several.

    Attributes:
        reward_fn: maps observations, actions and next observations to rewards, shape (n,).
        termination_fn: maps observations to whether the task terminates there, booleans or 0 and 1, shape (n,).
        dynamics_fn: maps observations and actions to a part of the change of the observations in one step, shape
            (n, d); the model learns the rest.
        action_repeat: number of steps of a decision.
        discount: discount factor of the rewards, per step.
    """

    reward_fn: Callable[[Array, Array, Array], Array] | None = None
    termination_fn: Callable[[Array], Array] | None = None
    dynamics_fn: Callable[[Array, Array], Array] | None = None
    action_repeat: int = 1
    discount: float = 1.0

    def moved(self, observations: Array, actions: Array) -> Array:
        """Return the observations after the known changes of a decision, shape (n, d)."""
        if self.dynamics_fn is not None:
            for _ in range(self.action_repeat):
                observations = observations + self.dynamics_fn(observations, actions)
        return observations

    @classmethod
    def named(cls, reward: str, end: str, change: str, observation_dim: int) -> Priors:
        """Import the functions with the given names ``package.module:function``; an empty name gives None.

        Raises:
            ValueError: a function does not exist.
        """
        return cls(
            reward_fn=_checked("model.reward_fn", reward, ()) if reward else None,
            termination_fn=partial(_terminations, _checked("model.termination_fn", end, ()), end) if end else None,
            dynamics_fn=_checked("model.dynamics_fn", change, (observation_dim,)) if change else None,
        )


def _checked(what: str, name: str, shape: tuple[int, ...]) -> Callable[..., Array]:
    """Return the named function with a check that it returns finite values of the given shape per row."""
    return partial(_call, what, name, user_function(name, what), shape)


def _terminations(function: Callable[[Array], Array], name: str, observations: Array) -> Array:
    values = function(observations)
    if not np.isin(values, (0.0, 1.0)).all():
        raise RunError(f"model.termination_fn: {name}: values: expected 0 or 1 for each row, got other values")
    return values


def _call(what: str, name: str, function: Callable[..., Array], shape: tuple[int, ...], *rows: Array) -> Array:
    """Call a user's function with copies of the rows."""
    expected = len(rows[0]), *shape
    try:
        values = np.asarray(call_user_function(function, *rows))
        require(values.shape == expected, "values", f"the shape {expected}", values.shape)
        finite = finite_array(values, expected, "values")
        require(bool((np.abs(finite) <= LARGEST).all()), "values", f"magnitudes of at most {LARGEST:g}", "larger ones")
        return finite
    except (RunError, TypeError, ValueError) as error:  # the return value may not be an array
        raise RunError(f"{what}: {name}: {truncated(error)}") from error
