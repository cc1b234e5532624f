"""The number of steps for which the policy holds an action, chosen from the first episodes and corrected by the next.

A decision must change what is observed. If the observation changes little between two decisions, white exploration
noise averages out, the learnt model's small errors add up over many steps, and the return depends little on a single
action. If it changes much, the policy cannot react.
"""

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.rkhs.kernels import Array

CHANGE = 0.3  # root mean square of an observation's change per decision, in its standard deviations
NOISE = 1.0  # a column that changes more than this in a step is noise, and does not count
FEWEST_DECISIONS = 50  # in the longest episode
MOST_REPEAT = 100
CLEARLY = 1.5  # ratio of two action repeats above which they differ by more than one choice does by chance


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
    """Return the median over columns of the change of an observation in ``repeat`` steps; 0 if nothing changes."""
    deviations = episodes.flat(episodes.observations).std(axis=0)
    moving = deviations > 0
    relative = [_changes(episodes, steps)[moving] / deviations[moving] for steps in (1, repeat)]
    signals = relative[0] < NOISE
    return float(np.median(relative[1][signals] if signals.any() else relative[1])) if moving.any() else 0.0


def _changes(episodes: Episodes, steps: int) -> Array:
    """Return the root mean square of the changes of the observations in a number of steps, shape (d,)."""
    both = episodes.mask[:, steps:]
    changes = (episodes.observations[:, steps:] - episodes.observations[:, :-steps])[both]
    return (
        np.asarray(np.sqrt(np.mean(changes**2, axis=0))) if len(changes) else np.zeros(episodes.observations.shape[2])
    )
