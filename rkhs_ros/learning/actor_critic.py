"""What actor-critics share: a critic that estimates the advantage by its compatible function (Eq 12)."""

from __future__ import annotations

from dataclasses import dataclass

from rkhs_ros.base.settings import setting, variant
from rkhs_ros.learning.algorithm import Algorithm
from rkhs_ros.learning.critics import CRITICS, PENALTIES, pursuit_critic, step_critic, trajectory_critic
from rkhs_ros.learning.features import Samples
from rkhs_ros.learning.steps import STEP_RULES, KLStep, StepRule
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class ActorCritic(Algorithm):
    r"""An algorithm with a critic: the w of :math:`A(s, a) = \langle w, K(s, \cdot) \Sigma^{-1} (a - h(s)) \rangle`."""

    critic: str = setting("step", "equations of the critic: of each step or of each episode", choices=tuple(CRITICS))
    regression: str = setting(
        "ridge",
        "how the critic solves them: ridge regression, or kernel matching pursuit after the value",
        choices=("ridge", "pursuit"),
    )
    ridge: float = setting(0.01, "penalty on the squared norm of w in the RKHS", minimum=1e-12, maximum=1e6)
    value_ridge: float = setting(0.01, "penalty on the value's squared norm in the RKHS", minimum=1e-12, maximum=1e6)
    trace: float = setting(
        1.0, "lambda of the returns that the step critic fits; 1: rewards to go", minimum=0.0, maximum=1.0
    )
    ridge_norm: str = setting(
        "norm",
        "what the ridge penalises: the norms of functions; or scale_free: each coefficient by the mean square of its "
        "column, which does not change with the coordinates",
        choices=PENALTIES,
    )
    step: StepRule = variant(KLStep(), STEP_RULES, "rule")

    def natural_gradient(self, samples: Samples, discount: float) -> Array:
        """Return the coefficients of w in the samples' coordinates, shape (m, n)."""
        step = {"value_ridge": self.value_ridge, "trace": self.trace}
        if self.regression == "pursuit":
            return pursuit_critic(samples, discount, self.ridge, self.ridge_norm, equations=self.critic, **step)
        if self.critic == "step":
            return step_critic(samples, discount, self.ridge, self.ridge_norm, **step)
        return trajectory_critic(samples, discount, self.ridge, self.ridge_norm)
