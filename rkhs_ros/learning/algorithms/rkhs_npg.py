"""RKHS-NPG: the natural policy gradient in RKHS (section 3.1 of the paper, Algorithm 1)."""

from dataclasses import dataclass

from rkhs_ros.base.settings import setting, variant
from rkhs_ros.learning.algorithms.algorithm import Algorithm, Experience, Update
from rkhs_ros.learning.algorithms.function_spaces import Sparse
from rkhs_ros.learning.algorithms.step_rules import STEP_RULES, KLStep, StepRule
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.regression import relative_ridge_regression


@dataclass(frozen=True)
class RKHSNPG(Sparse, Algorithm):
    r"""Ascent along the natural gradient, computed with the N x N Gram matrix of the trajectories (Eq 18 to 20).

    .. math:: h \leftarrow h + \alpha \sum_i \hat R_i \sum_t K(s_{it}, \cdot)\, u_{it}, \qquad
        \hat R = (\Lambda + \lambda N I)^{-1} (R - b 1)

    The published form has no baseline b. Learning then stalls, because the mean of the returns dominates their
    differences.
    """

    baseline: str = setting(
        "intercept",
        "what is subtracted from the returns. intercept: an intercept of the regression. as_published: nothing",
        choices=("intercept", "as_published"),
    )
    ridge: float = setting(
        0.1, "ridge lambda N, relative to the mean diagonal of the Gram matrix", minimum=1e-12, maximum=1e6
    )
    step: StepRule = variant(KLStep(), STEP_RULES, "rule")

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy after one step along the natural gradient."""
        samples = self.samples(policy, experience.episodes)
        scores = samples.trajectory_features(discount=1.0)  # grad log P(xi), Eq 19; Lambda is their Gram
        returns = samples.episodes.returns(experience.discount)  # R
        with_intercept = self.baseline != "as_published"
        gradient = relative_ridge_regression(scores, returns, self.ridge, intercept=with_intercept)  # with R hat, Eq 18
        return self.gradient_step(policy, samples.as_coefficients(gradient), samples, experience, self.step)  # Eq 20
