"""Default settings for an untuned task, which adapt to its spaces and to the observed data."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Integral
from typing import Any

from rkhs_ros.learning.training_settings import AUTO, Training

LONG_STEPS = {"rule": "kl", "divergence": 0.05}
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
    "power": {"variance": "constant"},  # a learnt one needs a kernel without negative values
}


HORIZON_PER_TIME_CONSTANT = 4.0  # a long episode is optimised for a quarter of its length


def settings_for(
    algorithm: str = "rkhs_nac", model: str = "gaussian_process", horizon: object = Training.horizon
) -> dict[str, Any]:
    """Return the default settings of the learner for an untuned task.

    No setting has the unit of an observation, an action or a reward. The time constant of the discount is 100 steps, or
    a quarter of a horizon of more than 400 steps.

    Args:
        algorithm: name of the algorithm.
        model: form of the model; training without a model has other defaults.
        horizon: maximum number of steps per episode. An invalid value, which `Training` rejects later, is replaced by
            the default.
    """
    steps = int(horizon) if isinstance(horizon, Integral) and int(horizon) > 0 else Training.horizon
    is_model_based = model != "none"
    form, batches, few = ("rbf", MODEL_BASED, {}) if is_model_based else ("rbf + linear", WITHOUT_MODEL, FEW_SAMPLES)
    return {
        **batches,
        "horizon": steps,
        "discount": max(Training.discount, 1.0 - HORIZON_PER_TIME_CONSTANT / steps),
        "action_repeat": AUTO,
        "exploration_sd": "range",
        "kernel": {"form": form, "bandwidth": "dimension"},
        "model": {"form": model},
        "algorithm": {"name": algorithm, **ALGORITHMS.get(algorithm, {}), **few.get(algorithm, {})},
    }
