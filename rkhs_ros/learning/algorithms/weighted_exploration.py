"""Settings of PoWER and RKHS-PoWER, with the regression of weighted exploration (Eq 23) and the variance (Eq 24)."""

from dataclasses import dataclass, replace

import numpy as np

from rkhs_ros.base.settings import setting
from rkhs_ros.base.validation import require
from rkhs_ros.learning.algorithms.algorithm import Algorithm, Update, measure
from rkhs_ros.learning.algorithms.critics import ValueBaseline
from rkhs_ros.learning.algorithms.variance_update import VARIANCES
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Kernel
from rkhs_ros.rkhs.regression import ridge_regression

RIDGE_UNITS = ("action", "variance")


def weighted_regression(samples: Samples, weights: Array, ridge: float, unit: str = "action") -> Function:
    r"""Return h' - h, the regression of the exploration weighted by q (Eq 23), in the samples' basis.

    .. math:: h' = h + \sum_t \kappa(s_t, \cdot)\,\alpha_t, \qquad
        \alpha = D (D \Gamma D + \lambda I)^{-1} D \epsilon, \qquad D = \mathrm{diag}\sqrt{q / g}

    Args:
        samples: samples of the iteration and of the reused episodes.
        weights: q, shape (samples,), not negative; signed advantages, as published, make the system indefinite.
        ridge: lambda.
        unit: one of `RIDGE_UNITS`: ``action`` uses lambda as given, ``variance`` divides it by the mean variance.
    """
    columns = zip(samples.exploration.T, samples.variance.T, strict=True)
    penalty = np.full(samples.features.shape[1], ridge / len(weights))
    scales = (1.0 if unit == "action" else 1.0 / g.mean() for g in samples.variance.T)
    coefficients = [
        ridge_regression(samples.features, e[:, None], penalty * scale, weights / g)
        for (e, g), scale in zip(columns, scales, strict=True)
    ]
    return samples.basis.function(np.concatenate(coefficients, axis=1))


WEIGHTINGS = ("positive", "returns")


@dataclass(frozen=True)
class WeightedExploration(Algorithm):
    """An EM-inspired update without a step size that moves the mean towards successful exploration."""

    weighting: str = setting("positive", "how the exploration of a step is weighted", choices=WEIGHTINGS)
    ridge: float = setting(
        1.0, "penalty lambda on the squared norm of the change in the mean", minimum=1e-12, maximum=1e6
    )
    ridge_unit: str = setting(
        "variance",
        "unit of the ridge: action, as in Eq 23; or variance, relative to the policy's variance and so independent of "
        "the units of actions",
        choices=RIDGE_UNITS,
    )
    value_ridge: float = setting(0.001, "penalty on the squared RKHS norm of the value", minimum=1e-12, maximum=1e6)
    reuse: int = setting(0, "number of best episodes so far that the next update reuses", minimum=0, maximum=10_000)
    variance: str = setting(
        "constant",
        "how the variance changes. learnt: by the corrected Eq 24. as_published: by the published Eq 24. constant: "
        "only by its decay",
        choices=("constant", *VARIANCES),
    )
    sd_minimum: float = setting(
        0.05, "minimum of a learnt standard deviation, in units of the action", minimum=1e-6, maximum=1e6
    )
    sd_maximum: float = setting(
        4.0, "maximum of a learnt standard deviation, in units of the action", minimum=1e-6, maximum=1e6
    )

    def __post_init__(self) -> None:
        """Raise ValueError if a value is invalid or the bounds of the standard deviation are swapped."""
        super().__post_init__()
        if self.sd_minimum > self.sd_maximum:
            raise ValueError(f"algorithm.sd_minimum: expected at most {self.sd_maximum}, got {self.sd_minimum}")

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
        moved, error = self.space.move(policy, change, samples.observations)
        new = replace(moved, variance=self._next_variance(policy, samples, weights))
        return Update(new, measure(samples, new, 1.0, error))

    def _next_variance(self, policy: GaussianPolicy, samples: Samples, weights: Array) -> Variance:
        if self.variance == "constant":
            return self.decayed(policy)
        if len(samples.basis.centres) == 0:  # for example, a homogeneous kernel with all samples at 0
            return policy.variance
        return VARIANCES[self.variance](samples, weights, self.sd_minimum, self.sd_maximum)  # Eq 24

    def remembered(self, episodes: Episodes, discount: float) -> Episodes:
        """Return the episodes with the greatest returns."""
        order = np.argsort(-episodes.returns(discount), kind="stable")
        return episodes.take(order[: self.reuse])
