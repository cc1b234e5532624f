"""RKHS-NAC: the episodic natural actor-critic in RKHS (section 3.2 of the paper, Algorithm 1)."""

from __future__ import annotations

from dataclasses import dataclass

from rkhs_ros.learning.actor_critic import ActorCritic
from rkhs_ros.learning.algorithm import Experience, Update
from rkhs_ros.learning.spaces import SparseSettings
from rkhs_ros.policies.gaussian import GaussianPolicy


@dataclass(frozen=True)
class RKHSNAC(SparseSettings, ActorCritic):
    r"""The natural actor-critic in the RKHS: what the critic estimates *is* the natural gradient (Eq 22).

    .. math:: h \leftarrow h + \alpha w, \qquad A(s, a) = \langle w, K(s, \cdot)\, \Sigma^{-1} (a - h(s)) \rangle
    """

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy one natural step on."""
        samples = self.space.samples(policy, experience.episodes)
        w = self.chosen_critic.fit(samples, experience.discount)  # Eq 12, which makes it that of Eq 22
        return self.climb(policy, w, samples, experience, self.step)  # h + alpha w, Eq 15 and 20
