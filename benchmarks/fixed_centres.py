"""Run CMA-ES on the weights of a policy with fixed centres, on the tasks of two configurations.

One evaluation episode scores each candidate, and counts. After each generation the mean of the distribution is
evaluated like a policy of RKHS-NAC, which does not count. Three initial standard deviations of the weights are tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from cmaes import CMA

from rkhs_ros.app.inline import runner_of
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.fixed import grid
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Array
from rkhs_ros.runs.config import Config

NEGLIGIBLE_VARIANCE = ConstantVariance(np.array([1e-18]))  # almost none


class Features(NamedTuple):
    """The features of the policy, and the initial standard deviations of its weights to try."""

    centres: Array
    kernel: RBF
    sds: Sequence[float]


FEATURES = {
    "pendulum_few_nac": Features(
        grid(np.array([-3.2, -4.0]), np.array([3.2, 4.0]), (8, 5)), RBF((0.8, 1.6)), (1.0, 2.0, 4.0)
    ),
    "toy_few_nac": Features(grid(np.array([-4.0]), np.array([4.0]), (20,)), RBF((0.7,)), (0.25, 0.5, 1.0)),
}


def search(config: Config, features: Features, sd: float) -> Iterator[tuple[int, float]]:
    """Yield the episodes used and the evaluation return after each generation.

    Args:
        config: configuration with the task, the budget of episodes, and the evaluation.
        features: features of the policy.
        sd: initial standard deviation of the weights; their initial mean is 0.
    """
    training = config.training
    score, rows = scorer(config, features), training.evaluation_episodes
    cma = CMA(np.zeros(len(features.centres)), sd, seed=training.seed)
    budget = training.iterations * training.episodes_per_iteration
    for generation, used in enumerate(range(0, budget, cma.population_size)):
        candidates = [cma.ask() for _ in range(cma.population_size)]
        # From a batch that explores, so that they differ from the evaluation episodes.
        cma.tell([(x, -score(x, used + i, 1, explore=True)) for i, x in enumerate(candidates)])
        yield used + len(candidates), score(cma.mean, generation * rows, rows, explore=False)


def scorer(config: Config, features: Features) -> Callable[..., float]:
    """Return a function from weights to their mean return over consecutive episodes."""
    training, runner = config.training, runner_of(config.environment)

    def score(weights: Array, first: int, rows: int, *, explore: bool) -> float:
        policy = GaussianPolicy(Function(features.kernel, features.centres, weights[:, None]), NEGLIGIBLE_VARIANCE)
        episodes = runner.collect(policy, Batch(training.seed, first, rows, training.horizon, explore=explore))
        return float(episodes.returns(training.discount).mean())

    return score
