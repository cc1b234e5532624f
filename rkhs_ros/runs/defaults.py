"""Default settings for an untuned task, which adapt to its spaces and to the observed data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rkhs_ros.learning.training_settings import AUTO

LONG_STEPS = {"rule": "kl", "divergence": 0.05, "annealing": 0.05}
ALGORITHMS: Mapping[str, Mapping[str, Any]] = {
    "rkhs_nac": {"centres": 80, "value_ridge": 0.001, "trace": 0.95, "step": LONG_STEPS},
    "rkhs_npg": {"centres": 80, "step": LONG_STEPS},
    "rkhs_ac": {"centres": 80, "step": LONG_STEPS},
    "rkhs_power": {"centres": 80, "value_ridge": 0.001, "ridge_unit": "variance", "variance": "constant"},
}
MODEL_BASED: Mapping[str, Any] = {"iterations": 20, "episodes_per_iteration": 1}
WITHOUT_MODEL: Mapping[str, Any] = {"iterations": 60, "episodes_per_iteration": 5}
# An update from a few real episodes alone has more noise and less data to fit in the same time on a robot.
FEW_SAMPLES: Mapping[str, Mapping[str, Any]] = {
    "rkhs_nac": {
        "ridge": 0.03,
        "reuse": 5,
        "variance": "learnt",
        "step": {"rule": "kl", "divergence": 0.08, "annealing": 0.1},
    },
}


def settings_for(algorithm: str = "rkhs_nac", model: str = "gaussian_process") -> dict[str, Any]:
    """Return the default settings of the learner for an untuned task.

    No setting has the unit of an observation, an action or a reward.

    Args:
        algorithm: name of the algorithm.
        model: form of the model; training without a model has other defaults.
    """
    is_model_based = model != "none"
    form, batches, few = ("rbf", MODEL_BASED, {}) if is_model_based else ("rbf + linear", WITHOUT_MODEL, FEW_SAMPLES)
    return {
        **batches,
        "action_repeat": AUTO,
        "exploration_sd": "range",
        "kernel": {"form": form, "bandwidth": "dimension"},
        "model": {"form": "gaussian_process", "discovery": "all"} if is_model_based else {"form": "none"},
        "algorithm": {"name": algorithm, **ALGORITHMS.get(algorithm, {}), **few.get(algorithm, {})},
    }
