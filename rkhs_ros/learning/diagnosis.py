"""Signs that a run does not learn, and the settings to try.

The diagnosis reads the iterations of a run and never changes them.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf, isnan, nan

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Iteration, Row
from rkhs_ros.policies.spaces import Spaces

PATIENCE = 5  # iterations for which a sign lasts; returns of fewer often differ by luck
EXPLOITS = 0.75  # gap between the two returns, relative to the range of real returns; random starts alone cause 0.5
BAD = 0.5  # error of a model that predicts the newest episodes badly; predicting the mean change has the error 1
TESTS = 4  # newest models to compare; any model fails in states that are new, and the first iteration has none to test
ALIKE = 0.1  # relative gap of the two returns up to which a model is good, even if irrelevant columns have large errors
SATURATED = 0.95  # share of actions at their bounds; good policies that switch between bounds have less
FEW = 3  # iterations without a change of the reward, since fewer may just not have reached it, or of cut episodes


@dataclass(frozen=True)
class Summary:
    """What the diagnosis needs of an iteration; the defaults stand for unknown values and cause no advice.

    Attributes:
        exploration_return: mean return of the exploration episodes.
        evaluation_return: mean return of the evaluation episodes; nan without evaluation.
        model_return: mean return of the model rollouts; nan without a model.
        model_error: error of the previous model; nan without one.
        lowest_reward: lowest reward of a step.
        highest_reward: highest reward of a step.
        terminates: whether the task terminated an episode.
        is_cut: whether the task truncated all exploration episodes before the horizon.
        saturated: share of the actions of the policy mean that are at or beyond a bound; nan without evaluation.
    """

    exploration_return: float
    evaluation_return: float = nan
    model_return: float = nan
    model_error: float = nan
    lowest_reward: float = -inf
    highest_reward: float = inf
    terminates: bool = False
    is_cut: bool = False
    saturated: float = nan


def exploits_model(recent: Sequence[Summary]) -> bool:
    """Return whether the return in the model is far above the evaluation return, now and in most recent iterations.

    The gap is relative to the range of all real returns, because returns have no natural zero.
    """
    known = [each for each in recent if not (isnan(each.evaluation_return) or isnan(each.model_return))][-PATIENCE:]
    returns = [each.exploration_return for each in recent] + [each.evaluation_return for each in known]
    far = EXPLOITS * (max(returns) - min(returns))
    above = [_gap(each) > ALIKE and each.model_return - each.evaluation_return > far for each in known]
    return len(known) == PATIENCE and above[-1] and sum(above) >= PATIENCE - 1


def _gap(summary: Summary) -> float:
    """Return by how much the model's return exceeds the evaluation's, or the exploration's, relative to the larger."""
    model, real = summary.model_return, summary.evaluation_return
    real = summary.exploration_return if isnan(real) else real
    return (model - real) / max(abs(model), abs(real)) if model != real else 0.0


def has_constant_reward(recent: Sequence[Summary]) -> bool:
    """Return whether all rewards so far are equal, and no episode was terminated, which would change the return."""
    lowest, highest = min(each.lowest_reward for each in recent), max(each.highest_reward for each in recent)
    return len(recent) >= FEW and lowest == highest and not any(each.terminates for each in recent)


def is_always_cut(recent: Sequence[Summary]) -> bool:
    """Return whether the task truncated all newest episodes before the horizon, up to which the model plans."""
    last = recent[-FEW:]
    return len(last) == FEW and all(each.is_cut for each in last)


def saturates(recent: Sequence[Summary]) -> bool:
    """Return whether nearly all actions of the policy mean are at their bounds."""
    known = [each.saturated for each in recent if not isnan(each.saturated)][-PATIENCE:]
    return len(known) == PATIENCE and min(known) >= SATURATED


def predicts_badly(recent: Sequence[Summary]) -> bool:
    """Return whether the newest model and most of those before predicted both steps and returns badly."""
    last = [each for each in recent if not isnan(each.model_error)][-TESTS:]
    bad = [each.model_error >= BAD and not abs(_gap(each)) <= ALIKE for each in last]
    return len(bad) == TESTS and bad[-1] and sum(bad) > TESTS / 2


SIGNS: tuple[tuple[Callable[[Sequence[Summary]], bool], str], ...] = (
    (
        has_constant_reward,
        "the reward has not changed so far; try a reward that rises towards the goal, or a larger horizon",
    ),
    (
        is_always_cut,
        "the task truncates all episodes before the horizon; try horizon=STEPS with their number of steps",
    ),
    (
        saturates,
        "nearly all actions of the policy mean are at their bounds; try wider bounds, a cost of the actions in the "
        "reward or a smaller exploration_sd",
    ),
    (
        predicts_badly,
        "the model predicts the newest episodes badly; try more episodes_per_iteration, inputs.history=2, less noisy "
        "observations, or model.form=none for contacts",
    ),
    (
        exploits_model,
        "the return in the model is far above the evaluation return; try more episodes_per_iteration, a smaller "
        "model.updates or a known model.reward_fn",
    ),
)  # causes before their consequences


def advice_on(recent: Sequence[Summary]) -> list[str]:
    """Return the advice for all signs of the iterations so far, at least one, the most important first."""
    return [advice for is_sign, advice in SIGNS if is_sign(recent)]


class Diagnosis:
    """Diagnosis of a run, which gives each advice once.

    Owns the summaries of the iterations.

    Args:
        spaces: spaces of its task.
        earlier: iterations before a resumed run.
        given: advice that was given before, as text.
    """

    def __init__(self, spaces: Spaces, earlier: Iterable[Summary] = (), given: Iterable[str] = ()) -> None:
        self._spaces = spaces
        self._recent = list(earlier)
        self._given = set(given)

    def advise(self, iteration: Iteration) -> str | None:
        """Return the advice for an iteration, None if there is none or it was given before."""
        self._recent.append(summary_of(iteration, iteration.exploration, iteration.evaluation, self._spaces))
        advice = next((each for each in advice_on(self._recent) if each not in self._given), None)
        self._given.add(advice or "")
        return advice


def summary_of(iteration: Iteration | Row, exploration: Episodes, evaluation: Episodes, spaces: Spaces) -> Summary:
    """Return the summary of an iteration, from its returns and its episodes, of which evaluations may be none."""
    rewards = np.concatenate([each.flat(each.rewards) for each in (exploration, evaluation)])
    return Summary(
        exploration_return=iteration.exploration_return,
        evaluation_return=iteration.evaluation_return,
        model_return=iteration.model_return,
        model_error=iteration.model_error,
        lowest_reward=float(rewards.min()),
        highest_reward=float(rewards.max()),
        terminates=bool(exploration.terminated.any() or evaluation.terminated.any()),
        is_cut=not exploration.terminated.any() and bool(exploration.mask.sum(axis=1).max() < exploration.horizon),
        saturated=_saturated(evaluation, spaces),
    )


def _saturated(evaluation: Episodes, spaces: Spaces) -> float:
    """Return the share of the actions of an evaluation that are at or beyond a bound."""
    actions = evaluation.flat(evaluation.actions)
    low, high = (bound.ravel() for bound in (spaces.action_low, spaces.action_high))
    return float(np.mean((actions <= low) | (actions >= high))) if len(actions) else nan
