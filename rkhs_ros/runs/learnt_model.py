"""The dynamics model of a finished run, fitted again to the episodes in its folder."""

from pathlib import Path

from rkhs_ros.policies.storage import read_policy
from rkhs_ros.recordings.recording import FILE, read_recording
from rkhs_ros.rollouts.model_env import LearntModel
from rkhs_ros.runs.checkpoint import Checkpoints
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.recorded import with_memory
from rkhs_ros.runs.report import CONFIGURATION, last_policy


def load_model(folder: str | Path) -> LearntModel:
    """Return the dynamics model of a run.

    It is fitted to all real episodes of the run, which are in its recording. With the same code and libraries, it is
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
    training, found = config.training, Checkpoints(folder, config).last()
    episodes = read_recording(folder).by_numbers()
    return LearntModel.of(training, with_memory(found, training, spaces, episodes, f"{folder / FILE}"), spaces)
