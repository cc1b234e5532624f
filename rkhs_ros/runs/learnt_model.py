"""The dynamics model of a finished run, fitted again to the episodes in its folder."""

from pathlib import Path

from rkhs_ros.learning.state import State
from rkhs_ros.recordings.recording import FILE, read_recording
from rkhs_ros.rollouts.model_env import LearntModel
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.recorded import memory_of
from rkhs_ros.runs.report import CONFIGURATION, old_folder


def load_model(folder: str | Path) -> LearntModel:
    """Return the dynamics model of a run.

    It is fitted to all real episodes of the run, which are in its recording. With the same code and libraries, it is
    bit-identical to the model of the run's last iteration.

    Args:
        folder: folder of a run with model-based training.

    Raises:
        ValueError: the folder is not that of a run with a finished iteration, the run has no model, or a file is
            damaged.
        OSError: a file cannot be read.
        RunError: a prior function failed.
    """
    folder = old_folder(Path(folder))
    training, recording = load_config(folder / CONFIGURATION).training, read_recording(folder)
    updates, head, what = recording.updates, recording.head, f"{folder / FILE}"
    if head is None or not updates:
        raise ValueError(f"{what}: expected at least one finished iteration, got none")
    policy, ends = recording.policies[updates[-1].policy_version], [update.episodes for update in updates]
    memory = memory_of(ends, training, policy, head.spaces, recording.by_numbers(), what)
    state = State(len(updates), policy, memory, ends[-1], updates[-1].evaluation_episodes, updates[-1].steps)
    return LearntModel.of(training, state, head.spaces)
