"""RKHS-NAC: the episodic natural actor-critic in RKHS (section 3.2 of the paper, Algorithm 1)."""

from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.settings import setting
from rkhs_ros.learning.algorithms.actor_critic import ActorCritic
from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.function_spaces import Sparse
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class RKHSNAC(Sparse, ActorCritic):
    r"""The natural actor-critic in the RKHS: the critic's estimate *is* the natural gradient (Eq 22).

    .. math:: h \leftarrow h + \alpha w, \qquad A(s, a) = \langle w, K(s, \cdot)\, \Sigma^{-1} (a - h(s)) \rangle

    A learnt variance follows its own natural gradient, with a standard deviation between 0.01 and 10 times the first
    one. In the paper the variance is constant.

    .. math:: \sqrt2 \log\sigma \leftarrow \sqrt2 \log\sigma + \alpha v, \qquad
        v = \frac1n \sum_t \big(A_t - A(s_t, a_t)\big) (\epsilon_t^2 / \sigma^2 - 1) / \sqrt2
    """

    value_ridge: float = setting(0.001, "penalty on the squared RKHS norm of the value", minimum=1e-12, maximum=1e6)
    trace: float = setting(
        0.95, "lambda of the lambda-returns that the critic fits per step; 1: rewards to go", minimum=0.0, maximum=1.0
    )
    variance: str = setting(
        "constant",
        "how the variance changes: constant except for its decay, or learnt along its natural gradient",
        choices=("constant", "learnt"),
    )
    reuse: int = setting(
        0, "number of newest episodes of earlier iterations that an update reuses", minimum=0, maximum=10_000
    )

    @property
    def learns_variance(self) -> bool:
        """Whether the variance follows its natural gradient."""
        return self.variance == "learnt"

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy after one step along the natural gradient."""
        samples = self.samples(policy, experience.episodes + experience.memory)
        w = self.natural_gradient(samples, experience.discount)  # Eq 12, which makes w the gradient of Eq 22
        v = self._spread(samples, w, experience) if self.learns_variance else None
        return self.gradient_step(policy, w, samples, experience, self.step, v)  # h + alpha w, Algorithm 1

    def remembered(self, episodes: Episodes, discount: float) -> Episodes:
        """Return the newest episodes."""
        return episodes.take(slice(self.reuse))

    def _spread(self, samples: Samples, w: Array, experience: Experience) -> Array:
        """Return the natural gradient v of the standard deviation, shape (n,).

        It uses the part of the advantages that w does not explain. The Fisher information of its coordinates is 1.
        """
        newest = slice(experience.episodes.mask.sum())  # reused episodes explored with another standard deviation
        advantages = self.value_baseline.advantages(samples, experience.discount) - samples.compatible_advantages(w)
        return np.asarray(advantages[newest] @ samples.deviation_scores[newest] / len(advantages[newest]))
