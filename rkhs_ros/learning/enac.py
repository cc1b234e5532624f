"""eNAC: the episodic natural actor-critic of Peters and Schaal (2008), the paper's parametric rival."""

from __future__ import annotations

from dataclasses import dataclass

from rkhs_ros.base.settings import setting
from rkhs_ros.learning.critics import CRITICS
from rkhs_ros.learning.rkhs_nac import NaturalActorCritic
from rkhs_ros.learning.spaces import OnGrid


@dataclass(frozen=True)
class ENAC(OnGrid, NaturalActorCritic):
    r"""The natural actor-critic on a grid: :math:`\theta \leftarrow \theta + \alpha w`.

    One equation for each episode:
    :math:`R(\xi) = \langle w, \sum_t \gamma^t \phi(s_t) u_t \rangle + V(s_0)`.
    """

    critic: str = setting(
        "trajectory", "equations of the critic: of each step or of each episode", choices=tuple(CRITICS)
    )
    ridge: float = setting(
        0.1, "penalty on the critic's weights, of an episode's relative to the Gram", minimum=1e-12, maximum=1e6
    )
