"""Settings of actor-critics, and the critic and step rule that they select."""

from dataclasses import dataclass

from rkhs_ros.base.settings import setting, variant
from rkhs_ros.learning.algorithms.algorithm import Algorithm
from rkhs_ros.learning.algorithms.critics import (
    RIDGE_NORMS,
    Critic,
    StepCritic,
    StepPursuitCritic,
    TrajectoryCritic,
    TrajectoryPursuitCritic,
    ValueBaseline,
)
from rkhs_ros.learning.algorithms.step_rules import STEP_RULES, KLStep, StepRule

EQUATIONS = ("step", "trajectory")


@dataclass(frozen=True)
class ActorCritic(Algorithm):
    """An algorithm whose update direction follows from the estimate of a critic."""

    critic: str = setting(
        "step", "equations of the critic: one per step, or one per episode (trajectory)", choices=EQUATIONS
    )
    regression: str = setting(
        "ridge",
        "how the critic solves its equations: ridge regression, or kernel matching pursuit after subtracting the value",
        choices=("ridge", "pursuit"),
    )
    ridge: float = setting(
        0.01, "penalty on the squared RKHS norm of the critic's weight w", minimum=1e-12, maximum=1e6
    )
    value_ridge: float = setting(0.01, "penalty on the squared RKHS norm of the value", minimum=1e-12, maximum=1e6)
    trace: float = setting(
        1.0, "lambda of the lambda-returns that the step critic fits; 1: rewards to go", minimum=0.0, maximum=1.0
    )
    ridge_norm: str = setting(
        "norm",
        "penalty of the ridge. norm: the squared norms of the functions. scale_free: the squared coefficients, each "
        "weighted by the mean square of its column in the regression; the scale of the coordinates then has no effect",
        choices=RIDGE_NORMS,
    )
    step: StepRule = variant(KLStep(), STEP_RULES, "rule")

    @property
    def value_baseline(self) -> ValueBaseline:
        """Value baseline of the advantages."""
        return ValueBaseline(self.value_ridge, self.ridge_norm, self.trace)

    @property
    def chosen_critic(self) -> Critic:
        """Critic that the settings select."""
        baseline = self.value_baseline
        critics: dict[tuple[str, str], Critic] = {
            ("step", "ridge"): StepCritic(self.ridge, baseline, self.ridge_norm),
            ("step", "pursuit"): StepPursuitCritic(self.ridge, baseline),
            ("trajectory", "ridge"): TrajectoryCritic(self.ridge, self.ridge_norm),
            ("trajectory", "pursuit"): TrajectoryPursuitCritic(self.ridge),
        }
        return critics[self.critic, self.regression]
