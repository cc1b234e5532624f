"""Find angles that do not wrap, and whether the past helps, by how well models with other inputs predict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from rkhs_ros.learning.discovery.angles import with_angles, with_wrapped_angles
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import Transitions, coordinates_of
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array, deviations
from rkhs_ros.rkhs.posterior import Posterior

MOST_STEPS = 1000  # last steps that a comparison uses
CENTRES = 100  # of its models
FEWEST_STEPS = 100  # for a longer history
BLOCK = 5  # consecutive steps that are predicted by a model of the other blocks
LONGEST_HISTORY = 3
FALLS = 0.6  # factor on the error of poorly predicted columns that justifies a longer history
FALLS_MEDIAN = 0.8  # the same for the median column
KEPT, KEPT_MEDIAN = 0.8, 0.95  # likewise, for a longer history that was found to be kept
POOR = 0.2  # error of a poorly predicted column, in standard deviations of its change
GAIN, GAIN_PER_STEP = 20.0, 0.5  # of log evidence, that together justify an angle
WIDE = 1.0  # range of a column that may be an angle, in turns
TURNS = (2.0 * np.pi, 360.0)


def discover_inputs(
    inputs: Inputs, episodes: Episodes, spaces: Spaces, *, history: bool, given: Inputs | None = None
) -> Inputs:
    """Return the inputs with the angles that the episodes reveal, and a history that is longer by one step if it helps.

    Few episodes may have revealed what more episodes refute. So earlier findings are checked first.

    Args:
        inputs: inputs so far, without monomials.
        episodes: all episodes, with raw observations.
        spaces: spaces of the task.
        history: whether the history may change.
        given: inputs before anything was found; None keeps all inputs so far.
    """

    @cache
    def errors(some: Inputs) -> Array:
        return _errors(some, episodes, spaces)

    @cache
    def evidence(some: Inputs) -> float:
        return _evidence(some, episodes, spaces)

    if given is not None:
        if history and inputs.history > given.history and not _needs_history(inputs, errors):
            inputs, history = replace(inputs, history=inputs.history - 1), False
        inputs = _without_refuted_angles(inputs, episodes, given, evidence)
    inputs = with_wrapped_angles(inputs, episodes)
    inputs = _with_unwrapped_angles(inputs, episodes, evidence)
    if history and inputs.history < LONGEST_HISTORY and episodes.mask.sum() >= FEWEST_STEPS:
        longer = replace(inputs, history=inputs.history + 1)
        if _predicts_better(errors(inputs), errors(longer)):
            return longer
    return inputs


def _with_unwrapped_angles(inputs: Inputs, episodes: Episodes, evidence: Callable[[Inputs], float]) -> Inputs:
    """Return the inputs with the wide columns whose effect has the period of a turn."""
    extents = np.ptp(episodes.flat(episodes.observations), axis=0)
    for column in sorted(set(range(len(extents))) - set(inputs.columns)):
        for turn in TURNS:
            if extents[column] < WIDE * turn:
                continue
            changed = with_angles(inputs, inputs.turns_by_column | {column: turn})
            if evidence(changed) > evidence(inputs) + _least_gain(episodes):
                inputs = changed
                break
    return inputs


def _without_refuted_angles(
    inputs: Inputs, episodes: Episodes, given: Inputs, evidence: Callable[[Inputs], float]
) -> Inputs:
    """Return the inputs without the angles that were found, do not wrap, and now hardly raise the evidence."""
    certain = {*given.columns, *with_wrapped_angles(given, episodes).columns}
    for column in [each for each in inputs.columns if each not in certain]:
        others = {each: turn for each, turn in inputs.turns_by_column.items() if each != column}
        fewer = with_angles(inputs, others)
        if evidence(inputs) - evidence(fewer) < 0.5 * _least_gain(episodes):
            inputs = fewer
    return inputs


def _least_gain(episodes: Episodes) -> float:
    """Return the gain of log evidence that justifies an angle; half of it keeps an angle that was found."""
    return max(GAIN, GAIN_PER_STEP * min(int(episodes.mask.sum()), MOST_STEPS))


def _last_steps(inputs: Inputs, episodes: Episodes, spaces: Spaces) -> tuple[Transitions, Array, list[int]]:
    """Return the last steps, their changes, and the columns that change by themselves."""
    enough = int(np.searchsorted(np.cumsum(episodes.mask.sum(axis=1)[::-1]), MOST_STEPS)) + 1
    steps = Transitions.of(episodes.take(slice(-enough, None)), inputs, spaces).last(MOST_STEPS)
    coordinates = coordinates_of(steps, inputs)
    return steps, coordinates.difference(steps.observations, steps.next_observations), coordinates.columns


def _evidence(inputs: Inputs, episodes: Episodes, spaces: Spaces) -> float:
    """Return the log evidence of a model of the changes."""
    steps, changes, _ = _last_steps(inputs, episodes, spaces)
    return Posterior.fit(steps.points, changes, CENTRES).evidence


def _errors(inputs: Inputs, episodes: Episodes, spaces: Spaces) -> Array:
    """Return the root mean square error of each column's change, in its standard deviations, on held-out blocks."""
    steps, changes, columns = _last_steps(inputs, episodes, spaces)
    odd = (np.arange(len(changes)) // BLOCK) % 2 == 1
    errors = np.empty_like(changes)
    for fold in (odd, ~odd):
        errors[fold] = changes[fold] - Posterior.fit(steps.points[~fold], changes[~fold], CENTRES).mean(
            steps.points[fold]
        )
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)) / deviations(changes))[columns]


def _predicts_better(errors: Array, longer: Array, falls: float = FALLS, median: float = FALLS_MEDIAN) -> bool:
    """Return whether the errors with a longer history are clearly smaller, where they matter."""
    ratios, poor = longer / np.maximum(errors, np.finfo(float).tiny), errors > POOR
    return bool(poor.any() and np.exp(np.mean(np.log(ratios[poor]))) < falls and np.median(ratios) < median)


def _needs_history(inputs: Inputs, errors: Callable[[Inputs], Array]) -> bool:
    """Return whether the errors are still smaller than with a history that is shorter by one step."""
    shorter = replace(inputs, history=inputs.history - 1)
    return _predicts_better(errors(shorter), errors(inputs), KEPT, KEPT_MEDIAN)
