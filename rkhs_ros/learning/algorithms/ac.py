"""AC: the actor-critic with a compatible critic (Konda and Tsitsiklis, 1999), a parametric baseline (Eq 5)."""

from dataclasses import dataclass

from rkhs_ros.base.settings import variant
from rkhs_ros.learning.algorithms.actor_critic import ActorCritic
from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.function_spaces import Grid
from rkhs_ros.learning.algorithms.step_rules import STEP_RULES, FixedStep, StepRule
from rkhs_ros.policies.gaussian import GaussianPolicy


@dataclass(frozen=True)
class AC(Grid, ActorCritic):
    r"""The actor-critic on a grid of centres: ascent along the plain gradient (Eq 5).

    .. math:: \theta \leftarrow \theta + \frac{\alpha}{N} \sum_{i,t} A(s_{it}, a_{it})\, \phi(s_{it})\, u_{it}
    """

    step: StepRule = variant(FixedStep(0.005), STEP_RULES, "rule")

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy after one step along the plain gradient."""
        samples = self.samples(policy, experience.episodes)  # phi, Eq 3
        w = self.natural_gradient(samples, experience.discount)
        advantages = samples.compatible_advantages(w)  # <w, phi u>
        gradient = samples.policy_gradient(advantages)  # Eq 5
        return self.gradient_step(policy, gradient, samples, experience, self.step)
