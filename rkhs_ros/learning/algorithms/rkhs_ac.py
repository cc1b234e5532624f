"""RKHS-AC: the actor-critic in RKHS of Lever and Stafford (2015), section 2.3 of the paper."""

from dataclasses import dataclass

from rkhs_ros.learning.algorithms.actor_critic import ActorCritic, critic_setting
from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.function_spaces import Sparse
from rkhs_ros.policies.gaussian import GaussianPolicy


@dataclass(frozen=True)
class RKHSAC(Sparse, ActorCritic):
    r"""The actor-critic in the RKHS: ascent along the plain gradient; matching pursuit fits the advantage.

    .. math:: h \leftarrow h + \frac{\alpha}{N} \sum_{i,t} A(s_{it}, a_{it})\, K(s_{it}, \cdot)\, u_{it}, \qquad
        u = \Sigma^{-1} (a - h(s))
    """

    critic: str = critic_setting("pursuit")

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy after one step along the plain gradient."""
        samples = self.samples(policy, experience.episodes)
        w = self.natural_gradient(samples, experience.discount)  # Eq 11
        advantages = samples.compatible_advantages(w)  # <w, K(s, .) u>, Eq 12
        gradient = samples.policy_gradient(advantages)  # Eq 9
        return self.gradient_step(policy, gradient, samples, experience, self.step)  # Eq 10
