"""eNAC: the episodic natural actor-critic of Peters and Schaal (2008), the paper's parametric baseline."""

from dataclasses import dataclass

from rkhs_ros.base.settings import setting
from rkhs_ros.learning.algorithms.actor_critic import ActorCritic, critic_setting
from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.function_spaces import Grid
from rkhs_ros.policies.gaussian import GaussianPolicy


@dataclass(frozen=True)
class ENAC(Grid, ActorCritic):
    r"""The natural actor-critic on a grid of centres, whose critic has one equation per episode.

    .. math:: \theta \leftarrow \theta + \alpha w, \qquad
        R(\xi) = \langle w, \sum_t \gamma^t \phi(s_t)\, u_t \rangle + V(s_0)
    """

    critic: str = critic_setting("trajectory")
    ridge: float = setting(
        0.1,
        "penalty on the critic's weights; with one equation per episode, relative to the mean diagonal of the Gram "
        "matrix",
        minimum=1e-12,
        maximum=1e6,
    )

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy after one step along the natural gradient."""
        samples = self.samples(policy, experience.episodes)  # phi, Eq 3
        w = self.natural_gradient(samples, experience.discount)  # of R(xi), see above
        return self.gradient_step(policy, w, samples, experience, self.step)  # theta + alpha w, section 2.2
