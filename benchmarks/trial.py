"""The input of a learner in the table of tasks, its learning curve, and what measures it."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rkhs_ros.app.inline import runner_of
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config
from rkhs_ros.studies.aggregates import Estimate, median_over_runs

FIXED_SEED, FIXED_STARTS, LONG_STARTS = 987654, 20, 5  # of the evaluation episodes, which no run explores
LONG = 1000  # steps from which an episode is long
Success = Callable[[Array], Array]  # from observations, shape (N, H, d), to whether each episode succeeds


@dataclass(frozen=True)
class Trial:
    """The input of a learner.

    Attributes:
        config: task, seed, and the settings of learners that use them.
        episodes: budget; the learner stops after the first update that reaches it.
        discounted: whether the thresholds of the task are for the discounted return.
        repeat: steps for which learners without an own choice hold an action.
        success: criterion of the task, if it has one besides the return.
    """

    config: Config
    episodes: int
    discounted: bool = False
    repeat: int = 1
    success: Success | None = None

    @property
    def judged_by(self) -> float:
        """Discount of the return that the thresholds are for."""
        return self.config.training.discount if self.discounted else 1.0

    @property
    def evaluation(self) -> Batch:
        """The evaluation episodes after each update, which are the same for all learners and seeds."""
        horizon = self.config.training.horizon
        return Batch(FIXED_SEED, 0, LONG_STARTS if horizon >= LONG else FIXED_STARTS, horizon, explore=False)


class Point(NamedTuple):
    """One point of a learning curve, after an update.

    Attributes:
        episodes: real exploration episodes so far.
        steps: steps of these episodes.
        cpu_seconds: CPU time of training and exploration so far, over all threads, without evaluations.
        undiscounted_return: mean over the evaluation episodes.
        discounted_return: the same with the task's discount.
        least_return: the least undiscounted return.
        succeeded: share of the episodes that meet the task's own criterion; nan if it has none.
        action_repeat: steps for which the policy holds an action.
    """

    episodes: int
    steps: int
    cpu_seconds: float
    undiscounted_return: float
    discounted_return: float
    least_return: float
    succeeded: float
    action_repeat: int


class Meter:
    """Counts episodes, steps and CPU time of a learner. Owns the counts.

    Args:
        trial: what the learner learns.
    """

    def __init__(self, trial: Trial) -> None:
        self.episodes = 0
        self.steps = 0
        self._trial = trial
        self._begin = time.process_time()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Exclude the CPU time of the block."""
        at = time.process_time()
        yield
        self._begin += time.process_time() - at

    def point(self, rewards: Array, observations: Array, action_repeat: int) -> Point:
        """Return the point of the curve for evaluation episodes.

        Args:
            rewards: shape (N, H), 0 after the end of an episode.
            observations: raw observations before each action, shape (N, H, d).
            action_repeat: steps for which the policy holds an action.
        """
        seconds, success = time.process_time() - self._begin, self._trial.success
        discounts = self._trial.config.training.discount ** np.arange(rewards.shape[1])
        undiscounted = rewards.sum(axis=1)
        return Point(
            self.episodes,
            self.steps,
            seconds,
            float(undiscounted.mean()),
            float((rewards @ discounts).mean()),
            float(undiscounted.min()),
            float(success(observations).mean()) if success else float("nan"),
            action_repeat,
        )


class MeteredRunner:
    """Rolls out policies in the task of a trial, counts exploration episodes, and evaluates.

    Args:
        trial: what the learner learns.
    """

    def __init__(self, trial: Trial) -> None:
        self.meter = Meter(trial)
        self._trial = trial
        self._runner = runner_of(trial.config.environment)
        self.spaces = self._runner.spaces

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""
        episodes = self._runner.collect(policy, batch)
        self.meter.episodes += len(episodes)
        self.meter.steps += int(episodes.mask.sum())
        return episodes

    def evaluated(self, policy: GaussianPolicy) -> Point:
        """Return the point of the curve for a policy."""
        with self.meter.paused():
            episodes = self._runner.collect(policy, self._trial.evaluation)
        return self.meter.point(episodes.rewards, episodes.observations, policy.action_repeat)


NEVER = 1e15  # episodes or steps, instead of infinity, so that means and differences are defined


def median_until(values: Array) -> Estimate:
    """Return the median over the runs of counts, some of which may be infinite."""
    estimate = median_over_runs(np.minimum(values, NEVER))
    return Estimate(*(np.inf if number > NEVER / 1e5 else float(number) for number in estimate))
