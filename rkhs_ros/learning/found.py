"""What the data of a task revealed, as settings and in one line."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rkhs_ros.learning.discovery.action_repeat import change_per_decision
from rkhs_ros.learning.episodes import Episodes
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


def newly_found(before: Known, after: Known, episodes: Episodes) -> str:
    """Return what was found in addition to what was known before, as settings; empty if nothing.

    Args:
        before: what was known.
        after: what is known now.
        episodes: the newest episodes, with raw observations.
    """
    parts = []
    if after.action_repeat != before.action_repeat:
        features = replace(episodes, observations=after.inputs.features(episodes.observations))
        change = change_per_decision(features, after.action_repeat)
        parts.append(f"action_repeat {after.action_repeat} (change per decision {change:.2f} sd)")
    if after.inputs.columns != before.inputs.columns:
        parts.append(_angles(after.inputs))
    if after.inputs.history != before.inputs.history:
        parts.append(f"inputs.history {after.inputs.history}")
    return ", ".join(parts)


def _angles(inputs: Inputs) -> str:
    if not inputs.columns:
        return "inputs.angles none"
    turns = ", ".join(f"{turn:.4g}" for turn in inputs.full_turns)
    return f"inputs.angles {inputs.columns} (a full turn is {turns})"
