"""``rkhs serve``: serve a Python function as the policy of a simulator or a robot."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from itertools import count
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.ros import require_ros
from rkhs_ros.base.user_code import call_user_function, user_function
from rkhs_ros.base.validation import REAL_KINDS, require, truncated

Policy = Callable[[NDArray[Any]], Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("function", metavar="MODULE:FUNCTION", help="function of an observation that returns an action")
    add("--episodes", type=int, metavar="N", help="number of episodes (default: until Ctrl-C)")
    add("--horizon", type=int, metavar="H", help="steps of an episode (default: that of the task)")
    add("--seed", type=int, default=0, metavar="N", help="seed of a simulator's randomness (default: %(default)s)")
    add("--namespace", default="", metavar="NS", help="namespace of the node")
    add(
        "--timeout",
        type=float,
        default=10.0,
        metavar="S",
        help="seconds to wait for a silent node (default: %(default)s)",
    )


def run(options: argparse.Namespace) -> int:
    """Run episodes, and print the steps and the undiscounted return of each.

    Raises:
        ValueError: ROS is missing, or the function or the task does not exist.
        RunError: the function fails or returns an invalid action, or the node does not respond.
    """
    require_ros("rkhs serve")
    require(options.episodes is None or options.episodes >= 1, "--episodes", "at least 1", options.episodes)
    function = user_function(options.function, "serve")
    from rkhs_ros.nodes.remote.remote_env import RemoteEnv  # here, since the import needs ROS

    environment = RemoteEnv(namespace=options.namespace, timeout=options.timeout, horizon=options.horizon)
    try:
        for number in count(1) if options.episodes is None else range(1, options.episodes + 1):
            outcome = _episode(environment, function, options.function, options.seed if number == 1 else None)
            print(f"episode {number}: {outcome}", flush=True)
    finally:
        environment.close()
    return 0


def _episode(environment: gymnasium.Env[Any, Any], function: Policy, name: str, seed: int | None) -> str:
    """Run an episode with the function as the policy, and return its outcome in one line."""
    observation, info = environment.reset(seed=seed)
    total, steps, over = 0.0, 0, False
    while not over:
        action = action_of(function, observation, environment.action_space, f"{name}: step {steps}")
        observation, reward, terminated, truncated, info = environment.step(action)
        total, steps, over = total + float(reward), steps + 1, terminated or truncated
    discarded = info.get("discard_reason")
    return f"discarded after {steps} steps: {discarded}" if discarded else f"{steps} steps, return {total:.6g}"


def action_of(function: Policy, observation: NDArray[Any], space: Any, where: str) -> NDArray[Any]:
    """Return the action of a function for an observation.

    Raises:
        RunError: the function fails, or the action is not in the space.
    """
    try:
        answer = np.asarray(call_user_function(function, observation))
    except (RunError, ValueError) as error:
        raise RunError(f"{where}: {error}") from error
    expected = f"{where}: expected an action of shape {space.shape} within its bounds"
    if answer.dtype.kind not in REAL_KINDS or answer.size != np.prod(space.shape):
        raise RunError(f"{expected}, got {truncated(f'{answer.dtype} of shape {answer.shape}')}")
    action = answer.reshape(space.shape).astype(space.dtype)
    if not ((action >= space.low) & (action <= space.high) & np.isfinite(action)).all():
        raise RunError(f"{expected}, got {truncated(answer)}")
    return action
