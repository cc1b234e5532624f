"""The algorithms by name."""

from __future__ import annotations

from rkhs_ros.learning.algorithm import Algorithm
from rkhs_ros.learning.rkhs_nac import RKHSNAC
from rkhs_ros.learning.rkhs_power import RKHSPoWER

ALGORITHMS: dict[str, type[Algorithm]] = {"rkhs_nac": RKHSNAC, "rkhs_power": RKHSPoWER}
