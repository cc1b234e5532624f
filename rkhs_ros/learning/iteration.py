"""An iteration of the training loop, and its numbers."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from rkhs_ros.learning.algorithms.algorithm import Metrics
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.state import Known, State
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.kernels import Array

UNDISCOUNTED = 1.0
NEGLIGIBLE = 1e-4  # error of a mean that is shown with four digits, relative to it


class Row(NamedTuple):
    """Numbers of an iteration: one line of curve.csv, whose page defines them. Update.msg has all but seconds."""

    iteration: int
    episodes: int
    steps: int
    evaluation_episodes: int
    exploration_return: float
    exploration_return_sd: float
    evaluation_return: float
    evaluation_return_sd: float
    undiscounted_exploration_return: float
    undiscounted_evaluation_return: float
    centres: int
    step_size: float
    kl: float
    sparsification_error: float
    model_return: float
    model_error: float
    seconds: float


@dataclass(frozen=True)
class Iteration:
    """One iteration of the training loop.

    Attributes:
        before: what was known about the task before the iteration.
        state: state of the run after the iteration.
        exploration: exploration episodes before the update.
        exploration_returns: returns of these episodes, shape (N,).
        evaluation: evaluation episodes after the update; empty in an iteration without evaluation.
        evaluation_returns: returns of these episodes.
        metrics: metrics of the update; with a model, of its last update.
        model_return: expected return of the policy; nan without a model.
        model_error: error of the previous model on this iteration's episodes; nan if there was none.
        tried: episodes in which the line search tried step sizes, in the order of collection.
    """

    before: Known
    state: State
    exploration: Episodes
    exploration_returns: Array
    evaluation: Episodes
    evaluation_returns: Array
    metrics: Metrics
    model_return: float = float("nan")
    model_error: float = float("nan")
    tried: tuple[Episodes, ...] = ()

    @property
    def number(self) -> int:
        """Number of the iteration, from 1."""
        return self.state.iterations

    @property
    def episodes_used(self) -> int:
        """Number of exploration episodes so far, including this iteration."""
        return self.state.explored

    @property
    def known(self) -> Known:
        """What is known about the task after the iteration."""
        return Known(self.policy.action_repeat, self.policy.inputs)

    @property
    def policy(self) -> GaussianPolicy:
        """Policy after the update."""
        return self.state.policy

    @property
    def exploration_return(self) -> float:
        """Mean return of the exploration episodes."""
        return float(self.exploration_returns.mean())

    @property
    def evaluation_return(self) -> float:
        """Mean return of the evaluation episodes; nan in an iteration without evaluation."""
        return float(self.evaluation_returns.mean()) if len(self.evaluation) else float("nan")

    @property
    def evaluation_return_sd(self) -> float:
        """Standard deviation of the returns of the evaluation episodes; nan in an iteration without evaluation."""
        return float(self.evaluation_returns.std()) if len(self.evaluation) else float("nan")

    @property
    def undiscounted_evaluation_return(self) -> float:
        """Mean undiscounted return of the evaluation episodes; nan in an iteration without evaluation."""
        return float(self.evaluation.returns(UNDISCOUNTED).mean()) if len(self.evaluation) else float("nan")

    @property
    def evaluation_error(self) -> float:
        """Standard error of the evaluation return; 0 in an iteration without evaluation."""
        return standard_error(self.evaluation_return_sd, len(self.evaluation))

    @property
    def evaluation_bound(self) -> float:
        """The evaluation return minus its standard error; nan in an iteration without evaluation.

        The greatest of many means is often luck: a few very good episodes. Such episodes also widen the interval.
        """
        return self.evaluation_return - self.evaluation_error

    def row(self, seconds: float) -> Row:
        """Return the numbers of the iteration, which finished a number of seconds after the start of the run."""
        metrics = self.metrics
        return Row(
            iteration=self.number,
            episodes=self.episodes_used,
            steps=self.state.steps,
            evaluation_episodes=self.state.evaluated,
            exploration_return=self.exploration_return,
            exploration_return_sd=float(self.exploration_returns.std()),
            evaluation_return=self.evaluation_return,
            evaluation_return_sd=self.evaluation_return_sd,
            undiscounted_exploration_return=float(self.exploration.returns(UNDISCOUNTED).mean()),
            undiscounted_evaluation_return=self.undiscounted_evaluation_return,
            centres=metrics.centres,
            step_size=float(metrics.step_size),
            kl=float(metrics.kl),
            sparsification_error=float(metrics.sparsification_error),
            model_return=self.model_return,
            model_error=self.model_error,
            seconds=seconds,
        )


def standard_error(sd: float, episodes: int) -> float:
    r"""Return the standard error of a mean return, 0 for a single return.

    .. math:: \hat\sigma / \sqrt{M - 1}

    Args:
        sd: standard deviation of the returns, without Bessel's correction.
        episodes: number of returns M.
    """
    return sd / math.sqrt(episodes - 1) if episodes > 1 else 0.0


def with_error(mean: float, error: float) -> str:
    """Return a mean with four digits, and its standard error if that shows in them."""
    return f"{mean:.4g}" + (f" \u00b1 {float(f'{error:.2g}'):g}" if error > NEGLIGIBLE * abs(mean) else "")
