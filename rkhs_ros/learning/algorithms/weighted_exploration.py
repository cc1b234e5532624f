"""The settings of PoWER and RKHS-PoWER, the regression of weighted exploration (Eq 23) and the variance (Eq 24)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rkhs_ros.base.settings import setting
from rkhs_ros.base.validation import require
from rkhs_ros.learning.algorithms.algorithm import Algorithm, Experience, Update, measure
from rkhs_ros.learning.algorithms.critics import ValueBaseline
from rkhs_ros.learning.algorithms.variance_update import VARIANCES
from rkhs_ros.learning.algorithms.weightings import WEIGHTINGS, normalised
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Kernel
from rkhs_ros.rkhs.regression import ridge_regression

RIDGE_UNITS = ("action", "variance")


def weighted_regression(samples: Samples, weights: Array, ridge: float, unit: str = "action") -> Function:
    r"""Return h' - h, the regression of the exploration weighted by q (Eq 23), on the dictionary of the centres.

    .. math:: h' = h + \sum_t \kappa(s_t, \cdot)\,\alpha_t, \qquad
        \alpha = D (D \Gamma D + \lambda I)^{-1} D \epsilon, \qquad D = \mathrm{diag}\sqrt{q / g}

    Args:
        samples: samples of the iteration, and of the episodes remembered.
        weights: q, shape (samples,), not negative: signed advantages, as printed, make the system indefinite.
        ridge: lambda.
        unit: one of `RIDGE_UNITS`: lambda as it is, or over the mean variance: no unit.
    """
    columns = zip(samples.exploration.T, samples.variance.T, strict=True)
    penalty = np.full(samples.features.shape[1], ridge / len(weights))
    scales = (1.0 if unit == "action" else 1.0 / g.mean() for g in samples.variance.T)
    coefficients = [
        ridge_regression(samples.features, e[:, None], penalty * scale, weights / g)
        for (e, g), scale in zip(columns, scales, strict=True)
    ]
    return samples.basis.function(np.concatenate(coefficients, axis=1))


@dataclass(frozen=True)
class WeightedExploration(Algorithm):
    """An EM-inspired update without a step size: the mean goes to where exploration earned most."""

    weighting: str = setting("positive", "how the exploration of a step is weighted", choices=tuple(WEIGHTINGS))
    ridge: float = setting(1.0, "penalty lambda on the step's squared norm in the RKHS", minimum=1e-12, maximum=1e6)
    ridge_unit: str = setting(
        "action",
        "what the ridge is measured in: action, as Eq 23 has it; or variance, over the policy's, so that the units of "
        "actions do not matter",
        choices=RIDGE_UNITS,
    )
    value_ridge: float = setting(0.01, "penalty on the value's squared norm in the RKHS", minimum=1e-12, maximum=1e6)
    reuse: int = setting(0, "best episodes so far that are learnt from again", minimum=0, maximum=10_000)
    variance: str = setting(
        "learnt",
        "how the exploration changes: learnt by Eq 24 as mended, constant but for its decay, or as Eq 24 is printed",
        choices=("constant", *VARIANCES),
    )
    sd_minimum: float = setting(0.05, "least standard deviation learnt, in units of action", minimum=1e-6, maximum=1e6)
    sd_maximum: float = setting(4.0, "greatest standard deviation learnt", minimum=1e-6, maximum=1e6)

    def __post_init__(self) -> None:
        """Raise ValueError where a value does not fit, or the bounds of the standard deviation are crossed."""
        super().__post_init__()
        if self.sd_minimum > self.sd_maximum:
            raise ValueError(f"algorithm.sd_minimum: expected at most {self.sd_maximum}, got {self.sd_minimum}")

    def unused(self) -> set[str]:
        """Return the names of the settings of a variance that does not decay or is not learnt, and of no value."""
        fixed = {"sd_minimum", "sd_maximum"}
        names = fixed if self.variance == "constant" else {"exploration_decay", "exploration_minimum"}
        return names | ({"value_ridge"} if self.weighting == "returns" else set())

    @property
    def learns_variance(self) -> bool:
        """Whether it is learnt, by Eq 24."""
        return self.variance != "constant"

    def check_kernel(self, kernel: Kernel) -> None:
        """Raise ValueError where the variance is to be learnt as a mean that the kernel cannot weigh."""
        remedy = "take rbf, polynomial of an even degree, or algorithm.variance=constant"
        good = self.variance != "learnt" or kernel.is_positive
        require(good, "kernel", f"one without negative values for algorithm.variance=learnt ({remedy})", kernel)

    @property
    def value_baseline(self) -> ValueBaseline:
        """The value that advantages are measured from."""
        return ValueBaseline(self.value_ridge)

    def weights(self, samples: Samples, discount: float) -> Array:
        """Return q of each sample, shape (samples,), not negative and with mean 1."""
        return normalised(WEIGHTINGS[self.weighting](samples, discount, self.value_baseline))

    def advance(
        self, policy: GaussianPolicy, change: Function, samples: Samples, weights: Array, experience: Experience
    ) -> Update:
        """Return the policy with a changed mean and the variance of the weights, and the episodes to remember.

        Args:
            policy: the policy.
            change: h' - h.
            samples: samples of the iteration, and of the episodes remembered so far.
            weights: q, shape (samples,).
            experience: what the update learns from.
        """
        moved, error = self.space.move(policy, change, samples.observations)
        new = replace(moved, variance=self._next_variance(policy, samples, weights))
        metrics = measure(samples, new, 1.0, error)
        return Update(new, metrics, self._best(samples.episodes, experience.discount))

    def _next_variance(self, policy: GaussianPolicy, samples: Samples, weights: Array) -> Variance:
        if self.variance == "constant":
            return self.decayed(policy)
        if len(samples.basis.centres) == 0:  # as of a homogeneous kernel at nothing but 0
            return policy.variance
        return VARIANCES[self.variance](samples, weights, self.sd_minimum, self.sd_maximum)  # Eq 24

    def _best(self, episodes: Episodes, discount: float) -> Episodes:
        order = np.argsort(-episodes.returns(discount), kind="stable")
        return episodes.take(order[: self.reuse])
