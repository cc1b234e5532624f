"""Find the observation columns that are angles from how they change."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.rkhs.kernels import Array

TURNS = tuple(scale * turn for turn in (2.0 * np.pi, 360.0) for scale in (1.0, 1e3, 1e-3))  # of usual units
EXTENT = 1.1  # largest range of an angle with observation noise, in turns
LONGEST_STEP = 0.4  # largest change of an angle in a step, in turns
LONGEST_MEAN_STEP = 0.15  # largest root mean square of these changes; 0.29 for unrelated angles
LONGEST_WRAPPING_STEP = 3.0  # largest step that wraps, relative to the others; a switch rests in between


def with_wrapped_angles(inputs: Inputs, episodes: Episodes) -> Inputs:
    """Return the inputs with the columns that wrap around, in addition to the known angles.

    Args:
        inputs: inputs so far.
        episodes: episodes with raw observations.
    """
    before, after = (episodes.flat(each) for each in (episodes.observations, episodes.next_observations))
    turns = inputs.turns_by_column
    for column in sorted(set(range(before.shape[1])) - set(turns)):
        turn = _turn(before[:, column], after[:, column])
        if turn is not None:
            turns[column] = turn
    return with_angles(inputs, turns)


def with_angles(inputs: Inputs, turns: dict[int, float]) -> Inputs:
    """Return the inputs with the given angles: the value of a full turn by column."""
    if turns.keys() == set(inputs.columns):
        return inputs
    columns = sorted(turns)
    if not columns:
        return replace(inputs, angles="none", turns=())
    return replace(inputs, angles=tuple(map(float, columns)), turns=tuple(turns[column] for column in columns))


def with_features(episodes: Episodes, inputs: Inputs) -> Episodes:
    """Return the episodes with features of the observations, including those of angles that wrap around.

    Args:
        episodes: episodes with raw observations.
        inputs: inputs so far.
    """
    inputs = with_wrapped_angles(inputs, episodes)
    return replace(episodes, observations=inputs.features(episodes.observations))


def _turn(before: Array, after: Array) -> float | None:
    """Return the full turn of an angle that wraps around, None for another column.

    All its values are within one turn. Some step changes it by more than half a turn, and modulo a turn all steps are
    short. The steps that wrap are not much longer than the others, unlike those of a switch between two values.
    """
    changes, extent = after - before, np.ptp(np.concatenate([before, after]))
    for turn in TURNS:
        jumps: NDArray[np.bool_] = np.abs(changes) > 0.5 * turn
        if extent <= turn * EXTENT and jumps.any():
            short = np.abs(np.remainder(changes / turn + 0.5, 1.0) - 0.5)
            usual = short[~jumps].max(initial=0.0)
            is_smooth = usual > 0.0 and short[jumps].max() <= LONGEST_WRAPPING_STEP * usual
            if is_smooth and short.max() <= LONGEST_STEP and np.sqrt(np.mean(short**2)) <= LONGEST_MEAN_STEP:
                return turn
    return None
