"""Replay: recompute the actions of a policy in episodes that another process ran, from their observations."""

from __future__ import annotations

import numpy as np

from rkhs_ros.base.validation import truncated
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

SAMPLES_AT_ONCE = 2048  # keeps the kernel matrix small


def check_actions(episodes: Episodes, policy: GaussianPolicy, batch: Batch) -> None:
    """Check that the actions of a batch's episodes are bit-identical to the policy's.

    Policy, batch and observations determine the actions. With a history, the inputs contain the recorded actions, so
    actions after the first different one may differ too.

    Raises:
        ValueError: an action differs; the message names the first such environment and step.
    """
    envs, steps = np.nonzero(episodes.mask)
    points = policy.inputs.unfold(episodes.observations, episodes.actions)[envs, steps]
    draws = policy.exploration(batch)  # of the first environments
    exploring = envs < len(draws)
    exploration = draws[envs[exploring], steps[exploring]]
    actions = episodes.actions[envs, steps]
    for begin in range(0, len(points), SAMPLES_AT_ONCE):
        part = slice(begin, begin + SAMPLES_AT_ONCE)
        expected = policy.act(points[part], exploration[part])
        wrong = (expected != actions[part]).any(axis=1)
        if wrong.any():
            first = int(wrong.argmax())
            env, step = envs[begin + first], steps[begin + first]
            raise ValueError(
                f"environment {env} (episode {batch.episodes[env]}), step {step}: "
                f"expected the policy's action {_text(expected[first])}, got {_text(actions[begin + first])}"
            )


def _text(action: Array) -> str:
    return truncated(action.tolist())
