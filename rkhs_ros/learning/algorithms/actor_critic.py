"""Settings of actor-critics, and the critic and step rule that they select."""

from dataclasses import dataclass
from typing import Any

from rkhs_ros.base.settings import setting, variant
from rkhs_ros.learning.algorithms.algorithm import Algorithm
from rkhs_ros.learning.algorithms.critics import ValueBaseline, pursuit_critic, step_critic, trajectory_critic
from rkhs_ros.learning.algorithms.step_rules import STEP_RULES, KLStep, StepRule
from rkhs_ros.learning.samples import Samples
from rkhs_ros.rkhs.kernels import Array

CRITICS = ("step", "trajectory", "pursuit")


def critic_setting(default: str) -> Any:
    """Declare the choice of a critic."""
    about = (
        "how the critic estimates the natural gradient. step: ridge regression with one equation per step. trajectory: "
        "with one per episode. pursuit: kernel matching pursuit with one per step, after subtracting the value"
    )
    return setting(default, about, choices=CRITICS)


@dataclass(frozen=True)
class ActorCritic(Algorithm):
    """An algorithm whose update direction follows from the estimate of a critic."""

    critic: str = critic_setting("step")
    ridge: float = setting(
        0.01, "penalty on the squared norm of the critic's weight w, see its equations", minimum=1e-12, maximum=1e6
    )
    value_ridge: float = setting(0.01, "penalty on the squared RKHS norm of the value", minimum=1e-12, maximum=1e6)
    trace: float = setting(
        1.0, "lambda of the lambda-returns that the critic fits per step; 1: rewards to go", minimum=0.0, maximum=1.0
    )
    step: StepRule = variant(KLStep(), STEP_RULES, "rule")

    @property
    def value_baseline(self) -> ValueBaseline:
        """Value baseline of the advantages."""
        return ValueBaseline(self.value_ridge, self.trace)

    def natural_gradient(self, samples: Samples, discount: float) -> Array:
        """Return the coefficients of the natural gradient w as the critic estimates it, shape (m, n)."""
        if self.critic == "trajectory":
            return trajectory_critic(samples, discount, self.ridge)
        fit = step_critic if self.critic == "step" else pursuit_critic
        return fit(samples, discount, self.ridge, self.value_baseline)
