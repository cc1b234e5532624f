"""What the data of a task revealed, as settings of a run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rkhs_ros.learning.state import State, chooses_action_repeat
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.inputs import Inputs


class Known(NamedTuple):
    """What a run knows about its task: at which rate and from which inputs the policy decides.

    Attributes:
        action_repeat: action repeat of the policy; 0 if it is still to be chosen.
        inputs: inputs of the policy.
    """

    action_repeat: int
    inputs: Inputs

    @classmethod
    def at(cls, state: State, training: Training) -> Known:
        """Return what is known in a state of a run."""
        return cls(0 if chooses_action_repeat(state, training) else state.policy.action_repeat, state.policy.inputs)

    @classmethod
    def of(cls, training: Training) -> Known:
        """Return what the settings of a run specify."""
        return cls(training.action_repeat if isinstance(training.action_repeat, int) else 0, training.inputs)


def settings_of(before: Known, after: Known) -> list[str]:
    """Return the settings that differ from what was known before, as ``KEY=VALUE``.

    Args:
        before: what was known.
        after: what is known now.
    """
    settings = []
    if after.action_repeat != before.action_repeat:
        settings.append(f"action_repeat={after.action_repeat}")
    if after.inputs.columns != before.inputs.columns:
        columns = ",".join(map(str, after.inputs.columns))
        settings.append(f"inputs.angles=[{columns}]" if columns else "inputs.angles=none")
        if columns and not np.allclose(after.inputs.full_turns, 2 * np.pi):
            settings.append(f"inputs.turns=[{','.join(map(repr, after.inputs.full_turns.tolist()))}]")
    if after.inputs.history != before.inputs.history:
        settings.append(f"inputs.history={after.inputs.history}")
    return settings
