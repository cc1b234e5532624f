"""The table of algorithms by name."""

from rkhs_ros.learning.algorithms.ac import AC
from rkhs_ros.learning.algorithms.algorithm import Algorithm
from rkhs_ros.learning.algorithms.enac import ENAC
from rkhs_ros.learning.algorithms.power import PoWER
from rkhs_ros.learning.algorithms.rkhs_ac import RKHSAC
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.algorithms.rkhs_npg import RKHSNPG
from rkhs_ros.learning.algorithms.rkhs_power import RKHSPoWER

ALGORITHMS: dict[str, type[Algorithm]] = {
    "rkhs_ac": RKHSAC,
    "rkhs_npg": RKHSNPG,
    "rkhs_nac": RKHSNAC,
    "rkhs_power": RKHSPoWER,
    "ac": AC,
    "enac": ENAC,
    "power": PoWER,
}
