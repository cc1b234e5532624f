"""The dynamics model of a finished run, fitted again to the episodes in its folder."""

from __future__ import annotations

from pathlib import Path

from rkhs_ros.policies.storage import read_policy
from rkhs_ros.rollouts.model_env import LearntModel
from rkhs_ros.runs.checkpoint import Checkpoints
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.report import CONFIGURATION, last_policy


def load_model(folder: str | Path) -> LearntModel:
    """Return the dynamics model of a run.

    It is fitted to the real episodes in the run's last checkpoint. With the same code and libraries, it is
    bit-identical to the model of the run's last iteration.

    Args:
        folder: folder of a finished run with model-based training.

    Raises:
        ValueError: the folder is not that of a finished run, the run has no model, or a file is damaged.
        OSError: a file cannot be read.
        RunError: a prior function failed.
    """
    folder = Path(folder)
    policy = last_policy(folder)
    config, spaces = load_config(folder / CONFIGURATION), read_policy(policy).spaces
    if spaces is None:
        raise ValueError(f"{policy}: expected a policy with the spaces of its task, got one without")
    return LearntModel.of(config.training, Checkpoints(folder, config, provenance_may_change=True).last(), spaces)
