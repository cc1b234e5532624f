"""Replay: what a policy must have done in episodes that somebody else ran, computed again from what was observed."""

from __future__ import annotations

import numpy as np

from rkhs_ros.base.validation import truncated
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

SAMPLES_AT_ONCE = 2048  # so that the kernel's matrix stays small


def check_actions(episodes: Episodes, policy: GaussianPolicy, batch: Batch) -> None:
    """Check that the actions of a batch's episodes are the policy's, to the last bit.

    Policy, batch and observations determine them. A window looks back on the actions of the episodes themselves: the
    first one that is another is found, and those after it in its row may be others because of it.

    Raises:
        ValueError: they are not; the message names the first row with another action and its first such step.
    """
    rows, steps = np.nonzero(episodes.mask)
    points = policy.inputs.unfold(episodes.observations, episodes.actions)[rows, steps]
    draws = policy.exploration(batch)  # of the first rows
    exploring = rows < len(draws)
    exploration = draws[rows[exploring], steps[exploring]]
    actions = episodes.actions[rows, steps]
    for begin in range(0, len(points), SAMPLES_AT_ONCE):
        part = slice(begin, begin + SAMPLES_AT_ONCE)
        seen = points[part]
        expected = policy.act(seen, exploration[part])
        wrong = (expected != actions[part]).any(axis=1)
        if wrong.any():
            first = int(wrong.argmax())
            row, step = rows[begin + first], steps[begin + first]
            raise ValueError(
                f"row {row} (episode {batch.episodes[row]}), step {step}: "
                f"expected the policy's action {_shown(expected[first])}, got {_shown(actions[begin + first])}"
            )


def _shown(action: Array) -> str:
    return truncated(action.tolist())
