"""Settings for a task that nobody tuned: they follow from its spaces, and from what is seen of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

LONG_STEPS = {"rule": "kl", "divergence": 0.05, "cap": 1e300, "annealing": 0.05}  # no cap: it would have units
ALGORITHMS: Mapping[str, Mapping[str, Any]] = {
    "rkhs_nac": {"centres": 80, "value_ridge": 0.001, "trace": 0.95, "step": LONG_STEPS},
    "rkhs_npg": {"centres": 80, "step": LONG_STEPS},
    "rkhs_ac": {"centres": 80, "step": LONG_STEPS},
    "rkhs_power": {"centres": 80, "value_ridge": 0.001, "ridge_unit": "variance", "variance": "constant"},
}
SETTINGS: Mapping[str, Any] = {
    "iterations": 20,
    "episodes_per_iteration": 1,
    "exploration_sd": "range",
    "kernel": {"form": "rbf", "bandwidth": "dimension"},
    "practice": {"form": "model"},
}


def settings_for(algorithm: str = "rkhs_nac") -> dict[str, Any]:
    """Return the settings of the learner for a task that nobody tuned, with an algorithm of that name.

    No number among them has the unit of an observation, an action or a reward.
    """
    return {**SETTINGS, "algorithm": {"name": algorithm, **ALGORITHMS.get(algorithm, {})}}
