"""RKHS-NAC: the episodic natural actor-critic in RKHS (section 3.2 of the paper, Algorithm 1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rkhs_ros.learning.algorithm import Algorithm, Metrics, measure
from rkhs_ros.learning.critics import CRITICS
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.features import Samples
from rkhs_ros.learning.steps import STEP_RULES, KLStep, StepRule
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.settings import setting, variant


@dataclass(frozen=True)
class RKHSNAC(Algorithm):
    r"""Natural actor-critic: the critic's weight *is* the natural gradient (Eq 22).

    .. math:: h \leftarrow h + \alpha w, \qquad A(s, a) = \langle w, K(s, \cdot) \Sigma^{-1} (a - h(s)) \rangle
    """

    critic: str = setting("step", "equations of the critic: of each step or of each episode", choices=tuple(CRITICS))
    ridge: float = setting(0.01, "penalty on the critic's squared norms in the RKHS", minimum=1e-12, maximum=1e6)
    exploration_decay: float = setting(1.0, "factor on the standard deviation each iteration", minimum=0.0, maximum=1.0)
    exploration_minimum: float = setting(0.05, "standard deviation not decayed below", minimum=1e-6, maximum=1e6)
    step: StepRule = variant(KLStep(), STEP_RULES, "rule")

    def update(self, policy: GaussianPolicy, episodes: Episodes, discount: float) -> tuple[GaussianPolicy, Metrics]:
        """Return the policy one natural step on."""
        samples = Samples.of(policy, episodes, self.centres)
        coefficients = CRITICS[self.critic](samples, discount, self.ridge)  # w of Eq 12
        direction = samples.features @ coefficients  # w(s_t)
        step_size = self.step.step_size(direction, samples.variance)  # Eq 15
        gradient = samples.basis.function(step_size * coefficients)  # alpha w, Eq 22
        moved, error = self.move(policy, gradient, samples.observations)
        decayed = replace(moved, variance=self._decay(moved))
        return decayed, measure(policy, decayed, samples.observations, step_size, error)

    def _decay(self, policy: GaussianPolicy) -> ConstantVariance:
        if not isinstance(policy.variance, ConstantVariance):
            raise ValueError("RKHS-NAC: expected a constant variance to decay, got one that depends on the state")
        return policy.variance.decay(self.exploration_decay, self.exploration_minimum)
