"""What a person knows of a task and need not be learnt: its reward, when it ends, or a part of how it changes."""

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
    """Functions that take the place of learnt ones; None where the model is to learn.

    All take rows: observations of shape (n, d) as they were seen, actions within their bounds of shape (n, m).

    Attributes:
        reward_fn: from observations, actions and the observations after them to the rewards, shape (n,).
        termination_fn: from observations to whether the task ends the episode there, 1 or 0 or booleans, shape (n,).
        dynamics_fn: from observations and actions to a part of how the observations change in a step, shape (n, d); the
            model learns what is left.
    """

    reward_fn: Callable[[Array, Array, Array], Array] | None = None
    termination_fn: Callable[[Array], Array] | None = None
    dynamics_fn: Callable[[Array, Array], Array] | None = None

    @classmethod
    def named(cls, reward: str, end: str, change: str, observation_dim: int) -> Priors:
        """Return the functions of those names, ``package.module:function`` each; empty for none.

        Raises:
            ValueError: there is no such function.
        """
        return cls(
            reward_fn=_checked("model.reward_fn", reward, ()) if reward else None,
            termination_fn=partial(_ends, _checked("model.termination_fn", end, ()), end) if end else None,
            dynamics_fn=_checked("model.dynamics_fn", change, (observation_dim,)) if change else None,
        )


def _checked(what: str, name: str, shape: tuple[int, ...]) -> Callable[..., Array]:
    """Return the function of that name, whose values for each row must be finite and have that shape."""
    return partial(_call, what, name, user_function(name, what), shape)


def _ends(function: Callable[[Array], Array], name: str, observations: Array) -> Array:
    """Return which observations end an episode.

    Raises:
        RunError: the function fails, or returns anything but 1 and 0.
    """
    values = function(observations)
    if not np.isin(values, (0.0, 1.0)).all():
        raise RunError(f"model.termination_fn: {name}: values: expected 1 or 0 of each row, got others")
    return values


def _call(what: str, name: str, function: Callable[..., Array], shape: tuple[int, ...], *rows: Array) -> Array:
    """Return what a user's function makes of rows, of which it is given copies.

    Raises:
        RunError: it raises, or what it returns has another shape or is not finite.
    """
    expected = len(rows[0]), *shape
    try:
        values = np.asarray(call_user_function(function, *rows))
        require(values.shape == expected, "values", f"the shape {expected}", values.shape)
        finite = finite_array(values, expected, "values")
        require(bool((np.abs(finite) <= LARGEST).all()), "values", f"at most {LARGEST:g} in size", "greater ones")
        return finite
    except (RunError, TypeError, ValueError) as error:  # what it returns may be no array
        raise RunError(f"{what}: {name}: {truncated(error)}") from error
