"""What the data of a task reveal about how it is written down: its time scale, its angles and its memory.

The number of steps for which the policy holds an action is chosen from the first episodes and corrected by the next. A
decision must change what is observed. If the observation changes little between two decisions, white exploration noise
averages out, the learnt model's small errors add up over many steps, and the return depends little on a single action.
If it changes much, the policy cannot react. Angles that wrap show in their jumps; angles that do not, and whether the
past helps, show in the evidence of models with other inputs.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import coordinates_of
from rkhs_ros.learning.model.transitions import Transitions
from rkhs_ros.policies.gaussian import MOST_REPEAT
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array, spreads
from rkhs_ros.rkhs.posterior import Posterior

CHANGE = 0.3  # root mean square of an observation's change per decision, in its standard deviations
NOISE = 1.0  # a column that changes more than this in a step is noise, and does not count
FEWEST_DECISIONS = 50  # in the longest episode
CLEARLY = 1.5  # ratio of two action repeats above which they differ by more than one choice does by chance
TURNS = tuple(scale * turn for turn in (2.0 * np.pi, 360.0) for scale in (1.0, 1e3, 1e-3))  # of usual units
EXTENT = 1.1  # largest range of an angle with observation noise, in turns
LONGEST_STEP = 0.4  # largest change of an angle in a step, in turns
LONGEST_MEAN_STEP = 0.15  # largest root mean square of these changes; 0.29 for unrelated angles
LONGEST_WRAPPING_STEP = 3.0  # largest step that wraps, relative to the others; a switch rests in between
MOST_STEPS = 1000  # last steps that a comparison uses
CENTRES = 100  # of its models
FEWEST_STEPS = 100  # for a longer history
LONGEST_HISTORY = 3
GAIN, GAIN_PER_NUMBER = 20.0, 0.5  # of log evidence, in all and per observed change, that justify further inputs
UNWRAPPED_TURNS = (2.0 * np.pi, 360.0)


def choose_action_repeat(episodes: Episodes) -> int:
    """Return the action repeat whose change per decision is the nearest to `CHANGE`, by ratio.

    Longer ones than the first above `CHANGE` do not count: after about one period of an oscillation, the change is
    small again.

    Args:
        episodes: exploration episodes, with the features of the observations.
    """
    changes: list[float] = []
    for repeat in range(1, longest_repeat(episodes) + 1):
        changes.append(change_per_decision(episodes, repeat))
        if changes[-1] > CHANGE:
            break
    distances = [abs(np.log(change / CHANGE)) if change > 0 else np.inf for change in changes]
    return 1 + int(np.argmin(distances))


def correct_action_repeat(repeat: int, episodes: Episodes) -> int:
    """Return the choice from more episodes if it differs clearly from an earlier choice, otherwise the earlier one.

    Args:
        repeat: the earlier choice.
        episodes: all episodes so far, with the features of the observations.
    """
    better = choose_action_repeat(episodes)
    return better if max(better, repeat) > CLEARLY * min(better, repeat) else repeat


def longest_repeat(episodes: Episodes) -> int:
    """Return the longest action repeat that leaves `FEWEST_DECISIONS` in the longest episode."""
    longest = int(episodes.mask.sum(axis=1).max())
    return max(1, min(MOST_REPEAT, longest // FEWEST_DECISIONS))


def change_per_decision(episodes: Episodes, repeat: int) -> float:
    """Return the median over columns of the change of an observation in ``repeat`` steps; 0 if nothing changes.

    Columns that are constant within each episode, such as a goal, do not count.
    """
    deviations, once = episodes.flat(episodes.observations).std(axis=0), _changes(episodes, 1)
    moving = once > 0
    relative = _changes(episodes, repeat)[moving] / deviations[moving]
    signals = once[moving] / deviations[moving] < NOISE
    return float(np.median(relative[signals] if signals.any() else relative)) if moving.any() else 0.0


def _changes(episodes: Episodes, steps: int) -> Array:
    """Return the root mean square of the changes of the observations in a number of steps, shape (d,)."""
    both = episodes.mask[:, steps:]
    changes = (episodes.observations[:, steps:] - episodes.observations[:, :-steps])[both]
    return (
        np.asarray(np.sqrt(np.mean(changes**2, axis=0))) if len(changes) else np.zeros(episodes.observations.shape[2])
    )


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
        for turn in UNWRAPPED_TURNS:
            if extents[column] < turn:
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
    enough = int(np.searchsorted(np.cumsum(episodes.mask.sum(axis=1)[::-1]), MOST_STEPS)) + 1
    steps = Transitions.of(episodes.take(slice(-enough, None)), inputs, spaces).last(MOST_STEPS)
    coordinates = coordinates_of(steps, inputs)
    changes = coordinates.difference(steps.observations, steps.next_observations)
    moving = np.count_nonzero(spreads(changes))
    least_gain = max(GAIN, GAIN_PER_NUMBER * len(changes) * moving)
    return Evidence(Posterior.fit(steps.points, changes, CENTRES).evidence, least_gain)
