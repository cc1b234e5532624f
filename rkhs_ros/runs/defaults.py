"""Default settings that depend on the length of an episode, and those of training without a model."""

from collections.abc import Mapping
from numbers import Integral
from typing import Any

from rkhs_ros.learning.training_settings import Training

HORIZON_PER_TIME_CONSTANT = 4.0  # a long episode is optimised for a quarter of its length
# An update from a few real episodes alone has more noise and less data to fit in the same time on a robot.
WITHOUT_MODEL: Mapping[str, Any] = {
    "iterations": 60,
    "episodes_per_iteration": 5,
    "kernel": {"form": "rbf + linear"},
    "model": {"form": "none"},
}
FEW_SAMPLES: Mapping[str, Any] = {
    "ridge": 0.03,
    "reuse": 5,
    "variance": "learnt",
    "step": {"rule": "kl", "divergence": 0.08, "annealing": 0.1},
}


def settings_for(
    algorithm: str = "rkhs_nac", model: str = "gaussian_process", horizon: object = Training.horizon
) -> dict[str, Any]:
    """Return the settings for an untuned task that are not the defaults of `Training`.

    No setting has the unit of an observation, an action or a reward. The time constant of the discount is 100 steps, or
    a quarter of a horizon of more than 400 steps.

    Args:
        algorithm: name of the algorithm.
        model: form of the model.
        horizon: maximum number of steps per episode. An invalid value, which `Training` rejects later, is replaced by
            the default.
    """
    steps = int(horizon) if isinstance(horizon, Integral) and int(horizon) > 0 else Training.horizon
    few = FEW_SAMPLES if model == "none" and algorithm == "rkhs_nac" else {}
    return {
        "horizon": steps,
        "discount": max(Training.discount, 1.0 - HORIZON_PER_TIME_CONSTANT / steps),
        "algorithm": {"name": algorithm, **few},
        **(WITHOUT_MODEL if model == "none" else {"model": {"form": model}}),
    }
