"""What a few exploring episodes reveal about a task, before it is trained."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rkhs_ros.learning.discovery import (
    CHANGE,
    FEWEST_DECISIONS,
    FEWEST_STEPS,
    LONGEST_HISTORY,
    change_per_decision,
    choose_action_repeat,
    discover_inputs,
    longest_repeat,
    with_features,
)
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.rewards import reward_depends_on_action_only
from rkhs_ros.learning.model_based.training_in_model import inputs_may_change
from rkhs_ros.learning.state import Known, settings_of
from rkhs_ros.learning.training_settings import AUTO, ModelBased, Training
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces

NOT_TESTED = "not tested, since kernel.form, the grid or kernel.bandwidth depends on the inputs"
TOO_FAST = 0.6  # change per decision above which the policy hardly reacts, in standard deviations


@dataclass(frozen=True)
class TaskCheck:
    """What exploring episodes reveal about a task."""

    episodes: Episodes  # with raw observations
    spaces: Spaces
    action_repeat: int  # that ``action_repeat=auto`` chooses
    change_per_step: float  # of the observation, in standard deviations
    change_per_decision: float  # with this action repeat
    longest_repeat: int  # that could have been chosen
    inputs: Inputs  # with the angles and the history that the data reveal
    given_history: int
    inputs_may_change: bool  # False if other settings depend on the inputs, which are then not searched
    decisions: int  # with this action repeat

    @classmethod
    def of(cls, episodes: Episodes, training: Training, spaces: Spaces) -> TaskCheck:
        """Check a task.

        The episodes explore with the first policy; their observations are raw.
        """
        first = episodes.take(slice(training.episodes_per_iteration))  # those that the run would use
        features = with_features(first, training.inputs)
        repeat = choose_action_repeat(features)
        decisions = episodes.decisions(repeat, training.discount, spaces)
        inputs = training.inputs
        may_change = inputs_may_change(inputs, training.algorithm, training.kernel)
        if may_change:
            inputs = discover_inputs(inputs, decisions, spaces, history=True)
        return cls(
            episodes=episodes,
            spaces=spaces,
            action_repeat=repeat,
            change_per_step=change_per_decision(features, 1),
            change_per_decision=change_per_decision(features, repeat),
            longest_repeat=longest_repeat(features),
            inputs=inputs,
            given_history=training.inputs.history,
            inputs_may_change=may_change,
            decisions=decisions.count,
        )

    def settings(self, training: Training) -> list[str]:
        """Return the settings that differ from those of a run and that the run would not find, as ``KEY=VALUE``."""
        discovery = training.model.discovery if isinstance(training.model, ModelBased) else "none"
        angles = training.inputs if discovery == "none" else self.inputs
        history = self.inputs.history if discovery == "all" else training.inputs.history
        inputs = replace(self.inputs, angles=angles.angles, turns=angles.turns, history=history)
        repeat = self.action_repeat if training.action_repeat == AUTO else int(training.action_repeat)
        return settings_of(Known(repeat, inputs), Known(self.action_repeat, self.inputs))

    def lines(self, step_seconds: float | None) -> list[tuple[str, str]]:
        """Return the findings as names and values.

        The duration of a step in seconds is None if it is unknown.
        """
        episodes, spaces = self.episodes, self.spaces
        lengths, terminated = episodes.mask.sum(axis=1), int(episodes.terminated.sum())
        each = step_seconds or 0.0
        timed = f" ({lengths.mean() * each:.3g} s at {each:.3g} s per step)" if each else ""
        steps = " to ".join(map(str, dict.fromkeys((lengths.min(), lengths.max()))))
        rewards = episodes.flat(episodes.rewards)
        reward = f"{rewards.min():.4g} to {rewards.max():.4g}"
        if not self._reward_varies():
            reward = f"never changes: {rewards[0]:.4g}; if this stays so, nothing can be learnt"
        elif reward_depends_on_action_only(episodes, spaces):
            reward += "; a cost of the actions explains it"
        low, high = (bound.ravel() for bound in (spaces.action_low, spaces.action_high))
        bounds = dict.fromkeys(f"{a:.4g} to {b:.4g}" for a, b in zip(low, high, strict=True))
        others = f"{len(episodes) - terminated} at the time limit or the horizon"
        return [
            ("episodes", f"{len(episodes)} of {steps} steps{timed}"),
            ("ends", f"{terminated} of {len(episodes)} terminated by the task, {others}"),
            ("change per step", f"{self.change_per_step:.2f} sd of the observations"),
            ("action_repeat", self._repeat()),
            ("angles", ", ".join(self._angles()) or ("none found" if self.inputs_may_change else NOT_TESTED)),
            ("history", self._history()),
            ("reward", reward),
            ("actions", f"{len(low)}, bounds {', '.join(bounds)}"),
        ]

    def problems(self) -> list[str]:
        """Return what no setting of a run mends, each with what to do about it; empty if there is nothing."""
        is_bounded = bool(np.isfinite([self.spaces.action_low, self.spaces.action_high]).all())
        found = {
            "reward: give one that changes": not self._reward_varies(),
            "observations: give some that change": self.episodes.horizon > 1 and not self.change_per_step > 0.0,
            "change per decision: run the task at a higher control rate": self.change_per_decision > TOO_FAST,
            "actions: set exploration_sd in their units": not is_bounded,
        }
        return [problem for problem, is_found in found.items() if is_found]

    def _name(self, column: int) -> str:
        names = self.spaces.observation_names
        return f"{column} ({names[column]})" if names else str(column)

    def _repeat(self) -> str:
        text = f"auto chooses {self.action_repeat}: {self.change_per_decision:.2f} sd per decision"
        if self.change_per_decision < CHANGE and self.action_repeat == self.longest_repeat:
            return f"{text}, the most with {FEWEST_DECISIONS} decisions in the longest of these episodes"
        return f"{text}, the nearest to {CHANGE:g}"

    def _angles(self) -> Iterator[str]:
        for column, turn in zip(self.inputs.columns, self.inputs.full_turns.tolist(), strict=True):
            unit = {6.283: "in radians", 360.0: "in degrees"}.get(round(turn, 3), f"(a full turn is {turn:.4g})")
            yield f"{self._name(column)} {unit}"

    def _history(self) -> str:
        if not self.inputs_may_change:
            return NOT_TESTED
        if self.decisions < FEWEST_STEPS:
            return f"not tested: {self.decisions} decisions of at least {FEWEST_STEPS}; raise --episodes"
        history = self.inputs.history
        if history > self.given_history:
            return f"inputs.history={history} predicts better"
        if history >= LONGEST_HISTORY:
            return f"more than {LONGEST_HISTORY} is not tested"
        return "a longer one does not help"

    def _reward_varies(self) -> bool:
        return bool(np.ptp(self.episodes.flat(self.episodes.rewards)) > 0)
