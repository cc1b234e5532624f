"""What steps of the practice robots earn: functions that a robot's configuration names."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def upright(before: NDArray[np.float64], executed: NDArray[np.float64], after: NDArray[np.float64]) -> float:
    r"""Return :math:`\exp(-\theta^2 / 2)` of the pendulum's angle before a step, as the paper has it."""
    return float(np.exp(-0.5 * before[0] ** 2))
