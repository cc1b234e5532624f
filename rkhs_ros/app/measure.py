"""Library functions for results: evaluate policies, load the model of a run."""

from pathlib import Path

from rkhs_ros.app.inline import load_acting
from rkhs_ros.base.processes import one_thread
from rkhs_ros.base.validation import require
from rkhs_ros.policies.policy import Policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.recording import FILE, read_recording
from rkhs_ros.rollouts.environments import Source
from rkhs_ros.rollouts.evaluation import Evaluation
from rkhs_ros.rollouts.model_env import LearntModel
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.recorded import state_of
from rkhs_ros.runs.report import CONFIGURATION, old_folder


def evaluate(
    policy: Policy | str | Path,
    env: Source | None = None,
    *,
    episodes: int = 100,
    seed: int = 0,
    discount: float | None = None,
) -> Evaluation:
    """Measure the returns of a policy in evaluation episodes, without exploration.

    Args:
        policy: a policy, its file, or the folder of a run, which stands for its last policy.
        env: as for `train`; None creates the environment that the policy names.
        episodes: number of episodes.
        seed: seed of all randomness.
        discount: discount factor of the return; None for that of the policy's task.

    Raises:
        ValueError: an argument is invalid, the folder contains no policy, or the policy does not fit the environment.
        RunError: the environment failed.
        OSError: the file cannot be read.
    """
    require(type(episodes) is int and episodes >= 1, "episodes", "a whole number >= 1", episodes)
    require(type(seed) is int and 0 <= seed < 2**63, "seed", "a whole number in [0, 2^63)", seed)
    require(discount is None or 0.0 <= discount <= 1.0, "discount", "a number in [0, 1]", discount)
    with one_thread(), load_acting(policy, env) as (gaussian, task, runner):
        collected = runner.collect(gaussian, Batch(seed, 0, episodes, task.horizon, explore=False))
        environment = runner.simulation.environment
    return Evaluation.of(collected, environment, seed, task.discount if discount is None else discount)


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
    what = f"{folder / FILE}"
    require(bool(recording.updates), what, "at least one finished iteration", "none")
    spaces = recording.head.spaces
    state = state_of(recording, training, spaces, what)
    return LearntModel.of(training, state, spaces)
