"""AC: the actor-critic with a compatible critic (Konda and Tsitsiklis, 1999), a parametric rival (Eq 5)."""

from __future__ import annotations

from dataclasses import dataclass

from rkhs_ros.learning.rkhs_ac import PlainActorCritic
from rkhs_ros.learning.spaces import OnGrid


@dataclass(frozen=True)
class AC(OnGrid, PlainActorCritic):
    r"""The plain actor-critic on a grid: :math:`\theta + \frac{\alpha}{N} \sum A(s, a)\, \phi(s)\, u` (Eq 5)."""
