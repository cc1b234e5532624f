"""RKHS-NAC: the episodic natural actor-critic in RKHS (section 3.2 of the paper, Algorithm 1)."""

from __future__ import annotations

from dataclasses import dataclass

from rkhs_ros.learning.actor_critic import ActorCritic
from rkhs_ros.learning.algorithm import Experience, Update
from rkhs_ros.learning.spaces import Sparse
from rkhs_ros.policies.gaussian import GaussianPolicy


@dataclass(frozen=True)
class NaturalActorCritic(ActorCritic):
    r"""Natural actor-critic: the critic's weight *is* the natural gradient (Eq 22).

    .. math:: h \leftarrow h + \alpha w, \qquad A(s, a) = \langle w, K(s, \cdot) \Sigma^{-1} (a - h(s)) \rangle
    """

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy one natural step on."""
        samples = self.samples(policy, experience.episodes)
        gradient = self.natural_gradient(samples, experience.discount)  # w, Eq 12 and 22
        return self.climb(policy, gradient, samples, experience, self.step)  # h + alpha w, Eq 15 and 20


@dataclass(frozen=True)
class RKHSNAC(Sparse, NaturalActorCritic):
    """The natural actor-critic in the RKHS."""
