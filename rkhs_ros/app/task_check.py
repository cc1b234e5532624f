"""What a few exploring episodes reveal about a task, before it is trained."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rkhs_ros.learning.discovery import (
    CHANGE,
    FEWEST_DECISIONS,
    FEWEST_STEPS,
    change_per_decision,
    choose_action_repeat,
    discover_inputs,
    longest_repeat,
    with_features,
)
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import reward_depends_on_action_only
from rkhs_ros.learning.model_based.training_in_model import inputs_may_change
from rkhs_ros.learning.state import Known, settings_of
from rkhs_ros.learning.training_settings import AUTO, ModelBased, Training
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

SAME = 1.0 - 1e-9  # absolute correlation of columns that repeat each other
NOT_TESTED = "not tested, since inputs.degree, the grid or kernel.bandwidth depends on the inputs"
TOO_FAST = 0.6  # change per decision above which the policy hardly reacts, in standard deviations


@dataclass(frozen=True)
class TaskCheck:
    """What exploring episodes reveal about a task.

    Attributes:
        episodes: the episodes, with raw observations.
        spaces: spaces of the task.
        action_repeat: the number that ``action_repeat=auto`` chooses.
        change_per_step: change of the observation per step, in standard deviations.
        change_per_decision: the same per decision with this action repeat.
        longest_repeat: longest action repeat that could have been chosen.
        inputs: inputs with the angles and the history that the data reveal.
        inputs_may_change: whether inputs were searched; False if other settings depend on the inputs.
        decisions: number of decisions with this action repeat.
    """

    episodes: Episodes
    spaces: Spaces
    action_repeat: int
    change_per_step: float
    change_per_decision: float
    longest_repeat: int
    inputs: Inputs
    inputs_may_change: bool
    decisions: int

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
            inputs_may_change=may_change,
            decisions=decisions.count,
        )

    @property
    def observations(self) -> Array:
        """All observations, shape (samples, d)."""
        return self.episodes.flat(self.episodes.observations)

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
        return [
            ("episodes", self._lengths(step_seconds)),
            ("ends", self._ends()),
            ("change per step", f"{self.change_per_step:.2f} sd of the observations"),
            ("action_repeat", self._repeat()),
            ("angles", ", ".join(self._angles()) or ("none found" if self.inputs_may_change else NOT_TESTED)),
            ("constant columns", ", ".join(map(self._name, constant_columns(self.observations))) or "none"),
            ("repeated columns", ", ".join(self._repeats()) or "none"),
            ("history", self._history()),
            ("reward", self._reward()),
            ("actions", self._actions()),
        ]

    def problems(self) -> list[str]:
        """Return what no setting of a run mends, each with what to do about it; empty if there is nothing."""
        problems = []
        if not self._reward_varies():
            problems.append("reward: give one that changes")
        if self.change_per_decision > TOO_FAST:
            problems.append("change per decision: run the task at a higher control rate")
        if not self._is_bounded():
            problems.append("actions: set exploration_sd in their units")
        return problems

    def _name(self, column: int) -> str:
        names = self.spaces.observation_names
        return f"{column} ({names[column]})" if names else str(column)

    def _repeat(self) -> str:
        text = f"auto chooses {self.action_repeat}: {self.change_per_decision:.2f} sd per decision"
        if self.change_per_decision < CHANGE and self.action_repeat == self.longest_repeat:
            return f"{text}, the most with {FEWEST_DECISIONS} decisions in the longest of these episodes"
        return f"{text}, the nearest to {CHANGE:g}"

    def _lengths(self, step_seconds: float | None) -> str:
        lengths = self.episodes.mask.sum(axis=1)
        steps = _range(lengths.tolist())
        if step_seconds is None:
            return f"{len(lengths)} of {steps} steps"
        return (
            f"{len(lengths)} of {steps} steps ({lengths.mean() * step_seconds:.3g} s at {step_seconds:.3g} s per step)"
        )

    def _ends(self) -> str:
        terminated, count = int(self.episodes.terminated.sum()), len(self.episodes)
        return f"{terminated} of {count} terminated by the task, {count - terminated} at the time limit or the horizon"

    def _angles(self) -> Iterator[str]:
        for column, turn in zip(self.inputs.columns, self.inputs.full_turns.tolist(), strict=True):
            unit = {6.283: "radians", 360.0: "degrees"}.get(round(turn, 3), f"a full turn is {turn:.4g}")
            yield f"{self._name(column)} in {unit}" if unit.endswith("s") else f"{self._name(column)} ({unit})"

    def _repeats(self) -> Iterator[str]:
        for column, earlier in repeated_columns(self.observations):
            yield f"{self._name(column)} repeats {self._name(earlier)}"

    def _history(self) -> str:
        if not self.inputs_may_change:
            return NOT_TESTED
        if self.decisions < FEWEST_STEPS:
            return f"not tested: {self.decisions} decisions of at least {FEWEST_STEPS}; raise --episodes"
        history = self.inputs.history
        return f"inputs.history={history} predicts better" if history > 1 else "a longer one does not help"

    def _reward_varies(self) -> bool:
        return bool(np.ptp(self.episodes.flat(self.episodes.rewards)) > 0)

    def _reward(self) -> str:
        rewards = self.episodes.flat(self.episodes.rewards)
        if not self._reward_varies():
            return f"never changes: {rewards[0]:.4g}; if this stays so, nothing can be learnt"
        text = f"{rewards.min():.4g} to {rewards.max():.4g}"
        explained = reward_depends_on_action_only(self.episodes, self.spaces)
        return text + ("; a cost of the actions explains it" if explained else "")

    def _is_bounded(self) -> bool:
        return bool(np.isfinite([self.spaces.action_low, self.spaces.action_high]).all())

    def _actions(self) -> str:
        low, high = (bound.ravel() for bound in (self.spaces.action_low, self.spaces.action_high))
        bounds = dict.fromkeys(f"{a:.4g} to {b:.4g}" for a, b in zip(low, high, strict=True))
        return f"{len(low)}, bounds {', '.join(bounds)}"


def _range(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return str(low) if low == high else f"{low} to {high}"


def constant_columns(observations: Array) -> list[int]:
    """Return the columns that never change."""
    return [int(column) for column in np.flatnonzero(np.ptp(observations, axis=0) == 0)]


def repeated_columns(observations: Array) -> list[tuple[int, int]]:
    """Return the columns that are another one, except for an offset and a factor, each with the earlier column."""
    moving = np.flatnonzero(np.ptp(observations, axis=0) > 0).tolist()
    values = observations[:, moving] - observations[:, moving].mean(axis=0)
    values = values / np.linalg.norm(values, axis=0)
    same = np.triu(np.abs(values.T @ values) > SAME, k=1)
    return [
        (moving[later], moving[int(same[:, later].argmax())]) for later in range(len(moving)) if same[:, later].any()
    ]
