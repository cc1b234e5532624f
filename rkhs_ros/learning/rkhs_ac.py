"""RKHS-AC: the actor-critic in RKHS of Lever and Stafford (2015), section 2.3 of the paper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.settings import setting, variant
from rkhs_ros.learning.actor_critic import ActorCritic
from rkhs_ros.learning.algorithm import Experience, Update
from rkhs_ros.learning.features import Samples
from rkhs_ros.learning.spaces import Sparse
from rkhs_ros.learning.steps import STEP_RULES, FixedStep, StepRule
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class PlainActorCritic(ActorCritic):
    r"""Actor-critic: up the plain gradient, each kernel function weighted by score and advantage (Eq 9, 10).

    .. math:: h \leftarrow h + \frac{\alpha}{N} \sum_{i,t} A(s_{it}, a_{it}) K(s_{it}, \cdot)\, u_{it}, \qquad
        u = \Sigma^{-1} (a - h(s))
    """

    step: StepRule = variant(FixedStep(0.005), STEP_RULES, "rule")

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy one plain step on."""
        samples = self.samples(policy, experience.episodes)
        advantage = self._advantage(samples, experience.discount)
        total = samples.features.T @ (samples.score * advantage[:, None])
        return self.climb(policy, total / len(experience.episodes), samples, experience, self.step)  # Eq 9, 10

    def _advantage(self, samples: Samples, discount: float) -> Array:
        critic = samples.features @ self.natural_gradient(samples, discount)  # w(s)
        return np.asarray(np.sum(critic * samples.score, axis=1))  # <w, K(s, .) u>, Eq 12


@dataclass(frozen=True)
class RKHSAC(Sparse, PlainActorCritic):
    """The actor-critic in the RKHS; the advantage by kernel matching pursuit."""

    regression: str = setting(
        "pursuit",
        "how the critic solves its equations: ridge regression, or kernel matching pursuit after the value",
        choices=("ridge", "pursuit"),
    )
