"""Replay: recompute the actions of a policy in episodes that another process ran, from their observations."""

import numpy as np

from rkhs_ros.base.validation import truncated
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch

SAMPLES_AT_ONCE = 2048  # keeps the kernel matrix small


def check_actions(episodes: Episodes, policy: GaussianPolicy, batch: Batch) -> None:
    """Check that the actions of a batch's episodes are bit-identical to the policy's.

    Policy, batch and observations determine the actions. With a history, the inputs contain the recorded actions, so
    actions after the first different one may differ too.

    Raises:
        ValueError: an action differs; the message names the first such environment and step.
    """
    repeat = policy.action_repeat
    envs, decisions = np.nonzero(episodes.mask[:, ::repeat])
    decided = episodes.actions[:, ::repeat]
    points = policy.inputs.unfold(episodes.observations[:, ::repeat], decided)[envs, decisions]
    exploration = policy.exploration(batch)[envs, decisions] if batch.explore else None
    expected = np.zeros_like(decided)
    for begin in range(0, len(points), SAMPLES_AT_ONCE):
        part = slice(begin, begin + SAMPLES_AT_ONCE)
        expected[envs[part], decisions[part]] = policy.act(
            points[part], None if exploration is None else exploration[part]
        )
    held = np.repeat(expected, repeat, axis=1)[:, : episodes.horizon]
    wrong = (held != episodes.actions).any(axis=2) & episodes.mask
    if wrong.any():
        env, step = np.argwhere(wrong)[0]
        raise ValueError(
            f"environment {env} (episode {batch.episodes[env]}), step {step}: "
            f"expected the policy's action {truncated(held[env, step].tolist())}, "
            f"got {truncated(episodes.actions[env, step].tolist())}"
        )
