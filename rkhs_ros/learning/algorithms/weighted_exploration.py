"""Settings of PoWER and RKHS-PoWER, with the regression of weighted exploration (Eq 23) and the variance (Eq 24)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rkhs_ros.base.settings import setting
from rkhs_ros.base.validation import require
from rkhs_ros.learning.algorithms.algorithm import Algorithm, Update, measure
from rkhs_ros.learning.algorithms.critics import ValueBaseline
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import FunctionVariance, KernelVariance, Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Kernel
from rkhs_ros.rkhs.pursuit import sparsify
from rkhs_ros.rkhs.regression import by_blocks, ridge_regression

WEIGHTINGS = ("positive", "returns", "as_published")
LEAST_MASS = 1e-9  # centres with a smaller mass relative to the largest are removed


def learnt(samples: Samples, weights: Array, sd_range: tuple[float, ...]) -> KernelVariance:
    r"""Return the kernel-weighted mean of squared exploration, with each sample assigned to its nearest centre.

    .. math:: g(s) = \frac{\sum_t q_t \epsilon_t^2 \kappa(s_t, s)}{\sum_t q_t \kappa(s_t, s)}

    Args:
        samples: samples of the iteration.
        weights: q, shape (samples,), not negative.
        sd_range: minimum and maximum standard deviation.
    """
    weights = np.maximum(weights, 0.0) if (weights > 0).any() else np.ones_like(weights)
    kernel, centres = samples.basis.kernel, samples.basis.centres
    points = samples.observations
    nearest = by_blocks(lambda rows: kernel(points[rows], centres).argmax(axis=1), len(points))
    mass = np.bincount(nearest, weights, len(centres))
    squares = (weights[:, None] * samples.exploration**2).T
    sums = np.stack([np.bincount(nearest, column, len(centres)) for column in squares], axis=1)
    used = mass > LEAST_MASS * mass.max()
    low, high = _bounds(samples, sd_range)
    return KernelVariance(kernel, centres[used], mass[used], sums[used] / mass[used, None], low, high)


def as_published(samples: Samples, weights: Array, sd_range: tuple[float, ...]) -> FunctionVariance:
    r"""Return the function of Eq 24 as published, with as many centres as the basis.

    .. math:: g(s) = \sum_t \kappa(s_t, s)\,\beta_t, \qquad
        \beta_t = \frac{\epsilon_t^2 A_t}{\kappa(s_t, s_t) \sum_k \epsilon_k^2 A_k}

    Squared exploration occurs in numerator and denominator and cancels, so the value is not related to its size.
    """
    kernel = samples.basis.kernel
    squares = weights[:, None] * samples.exploration**2
    shares = squares / np.where(squares.sum(axis=0) == 0, 1.0, squares.sum(axis=0))
    beta = shares / np.maximum(kernel.diagonal(samples.observations), np.finfo(float).tiny)[:, None]
    whole = Function(kernel, samples.observations, beta)
    thinned = sparsify(whole, samples.observations, budget=len(samples.basis.centres)).function
    return FunctionVariance(thinned, *_bounds(samples, sd_range))


def _bounds(samples: Samples, sd_range: tuple[float, ...]) -> tuple[Array, Array]:
    ones = np.ones(samples.exploration.shape[1])
    return sd_range[0] ** 2 * ones, sd_range[1] ** 2 * ones


Learnt = Callable[[Samples, Array, tuple[float, ...]], Variance]
VARIANCES: dict[str, Learnt] = {"learnt": learnt, "as_published": as_published}


def weighted_regression(samples: Samples, weights: Array, ridge: float, *, relative: bool = False) -> Function:
    r"""Return h' - h, the regression of the exploration weighted by q (Eq 23), in the samples' basis.

    .. math:: h' = h + \sum_t \kappa(s_t, \cdot)\,\alpha_t, \qquad
        \alpha = D (D \Gamma D + \lambda I)^{-1} D \epsilon, \qquad D = \mathrm{diag}\sqrt{q / g}

    Args:
        samples: samples of the iteration and of the reused episodes.
        weights: q, shape (samples,), not negative; signed advantages, as published, make the system indefinite.
        ridge: lambda.
        relative: whether to divide lambda by the mean variance.
    """
    columns = zip(samples.exploration.T, samples.variance.T, strict=True)
    penalty = np.full(samples.features.shape[1], ridge / len(weights))
    scales = (1.0 / g.mean() if relative else 1.0 for g in samples.variance.T)
    coefficients = [
        ridge_regression(samples.features, e[:, None], penalty * scale, weights / g)
        for (e, g), scale in zip(columns, scales, strict=True)
    ]
    return samples.basis.function(np.concatenate(coefficients, axis=1))


def weighting_setting(default: str) -> Any:
    """Declare the choice of a weighting."""
    about = (
        "how the exploration of a step is weighted: by positive advantages; by returns; or as_published, rkhs_power by "
        "signed advantages, and power by returns for each weight on its own (Eq 6)"
    )
    return setting(default, about, choices=WEIGHTINGS)


@dataclass(frozen=True)
class WeightedExploration(Algorithm):
    """An EM-inspired update without a step size that moves the mean towards successful exploration."""

    weighting: str = weighting_setting("positive")
    ridge: float = setting(
        1.0,
        "penalty lambda on the squared norm of the change in the mean; relative to the policy's variance if that is "
        "constant, and so independent of the units of actions; otherwise as in Eq 23",
        minimum=1e-12,
        maximum=1e6,
    )
    value_ridge: float = setting(0.001, "penalty on the squared RKHS norm of the value", minimum=1e-12, maximum=1e6)
    reuse: int = setting(0, "number of best episodes so far that the next update reuses", minimum=0, maximum=10_000)
    variance: str = setting(
        "constant",
        "how the variance changes. learnt: by the corrected Eq 24. as_published: by the published Eq 24. constant: "
        "only by its decay",
        choices=("constant", *VARIANCES),
    )

    @property
    def learns_variance(self) -> bool:
        """Whether the variance is learnt by Eq 24."""
        return self.variance != "constant"

    def check_kernel(self, kernel: Kernel) -> None:
        """Raise ValueError if the variance is learnt but the kernel has negative values."""
        remedy = "use rbf, a polynomial of even degree, or algorithm.variance=constant"
        good = self.variance != "learnt" or kernel.is_positive
        require(good, "kernel", f"one without negative values for algorithm.variance=learnt ({remedy})", kernel)

    @property
    def value_baseline(self) -> ValueBaseline:
        """Value baseline of the advantages."""
        return ValueBaseline(self.value_ridge)

    def weights(self, samples: Samples, discount: float) -> Array:
        r"""Return the weight q of each sample, shape (samples,); weights are non-negative and have mean 1.

        They are :math:`\max(A, 0)`, which ignores steps that were worse than expected, or :math:`\max(R, 0)` like
        Kober and Peters (2011). With mean 1, the effect of a ridge does not depend on the rewards' units.
        """
        positive = self.weighting == "positive"
        values = self.value_baseline.advantages if positive else Samples.rewards_to_go
        q = np.maximum(values(samples, discount), 0.0)
        mean = q.mean()
        return q / mean if mean > 0 else np.ones_like(q)

    def advance(self, policy: GaussianPolicy, change: Function, samples: Samples, weights: Array) -> Update:
        """Return the policy with the changed mean and the new variance.

        Args:
            policy: the policy.
            change: h' - h.
            samples: samples of the iteration and of the reused episodes.
            weights: q, shape (samples,).
        """
        moved, error = self.move(policy, change, samples.observations)
        new = replace(moved, variance=self._next_variance(policy, samples, weights))
        return Update(new, measure(samples, new, 1.0, error))

    def _next_variance(self, policy: GaussianPolicy, samples: Samples, weights: Array) -> Variance:
        if self.variance == "constant":
            return self.decayed(policy)
        if len(samples.basis.centres) == 0:  # for example, a homogeneous kernel with all samples at 0
            return policy.variance
        return VARIANCES[self.variance](samples, weights, self.sd_range)  # Eq 24

    def remembered(self, episodes: Episodes, discount: float) -> Episodes:
        """Return the episodes with the greatest returns."""
        order = np.argsort(-episodes.returns(discount), kind="stable")
        return episodes.take(order[: self.reuse])
