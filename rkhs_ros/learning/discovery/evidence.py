"""Find angles that do not wrap, and whether the past helps, by the evidence of models with other inputs."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from rkhs_ros.learning.discovery.angles import with_angles, with_wrapped_angles
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import Transitions, coordinates_of
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.posterior import Posterior

MOST_STEPS = 1000  # last steps that a comparison uses
CENTRES = 100  # of its models
FEWEST_STEPS = 100  # for a longer history
LONGEST_HISTORY = 3
GAIN, GAIN_PER_NUMBER = 20.0, 0.5  # of log evidence, in all and per observed change, that justify further inputs
WIDE = 1.0  # range of a column that may be an angle, in turns
TURNS = (2.0 * np.pi, 360.0)


class Evidence(NamedTuple):
    """The evidence of a model of the changes.

    Attributes:
        log: its logarithm, up to a constant.
        least_gain: gain that justifies further inputs; half of it keeps those that were found.
    """

    log: float
    least_gain: float


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
    def evidence(some: Inputs) -> Evidence:
        return _evidence(some, episodes, spaces)

    if given is not None:
        if history and inputs.history > given.history:
            shorter = replace(inputs, history=inputs.history - 1)
            if evidence(inputs).log - evidence(shorter).log < 0.5 * evidence(inputs).least_gain:
                inputs, history = shorter, False
        inputs = _without_refuted_angles(inputs, episodes, given, evidence)
    inputs = with_wrapped_angles(inputs, episodes)
    inputs = _with_unwrapped_angles(inputs, episodes, evidence)
    if history and inputs.history < LONGEST_HISTORY and episodes.mask.sum() >= FEWEST_STEPS:
        longer = replace(inputs, history=inputs.history + 1)
        if evidence(longer).log - evidence(inputs).log > evidence(inputs).least_gain:
            return longer
    return inputs


def _with_unwrapped_angles(inputs: Inputs, episodes: Episodes, evidence: Callable[[Inputs], Evidence]) -> Inputs:
    """Return the inputs with the wide columns whose effect has the period of a turn."""
    extents = np.ptp(episodes.flat(episodes.observations), axis=0)
    for column in sorted(set(range(len(extents))) - set(inputs.columns)):
        for turn in TURNS:
            if extents[column] < WIDE * turn:
                continue
            changed = with_angles(inputs, inputs.turns_by_column | {column: turn})
            if evidence(changed).log - evidence(inputs).log > evidence(inputs).least_gain:
                inputs = changed
                break
    return inputs


def _without_refuted_angles(
    inputs: Inputs, episodes: Episodes, given: Inputs, evidence: Callable[[Inputs], Evidence]
) -> Inputs:
    """Return the inputs without the angles that were found, do not wrap, and now hardly raise the evidence."""
    certain = {*given.columns, *with_wrapped_angles(given, episodes).columns}
    for column in [each for each in inputs.columns if each not in certain]:
        others = {each: turn for each, turn in inputs.turns_by_column.items() if each != column}
        fewer = with_angles(inputs, others)
        if evidence(inputs).log - evidence(fewer).log < 0.5 * evidence(inputs).least_gain:
            inputs = fewer
    return inputs


def _evidence(inputs: Inputs, episodes: Episodes, spaces: Spaces) -> Evidence:
    """Return the evidence of a model of the last steps."""
    enough = int(np.searchsorted(np.cumsum(episodes.mask.sum(axis=1)[::-1]), MOST_STEPS)) + 1
    steps = Transitions.of(episodes.take(slice(-enough, None)), inputs, spaces).last(MOST_STEPS)
    coordinates = coordinates_of(steps, inputs)
    changes = coordinates.difference(steps.observations, steps.next_observations)
    least_gain = max(GAIN, GAIN_PER_NUMBER * len(changes) * len(coordinates.columns))
    return Evidence(Posterior.fit(steps.points, changes, CENTRES).evidence, least_gain)
