"""``rkhs imitate``: fit a policy to demonstrations, to evaluate it or to start training from it."""

import argparse
from pathlib import Path

import numpy as np

from rkhs_ros.app.inline import spaces_of
from rkhs_ros.app.named import named
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.imitation import imitation_from
from rkhs_ros.policies.policy import Policy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.config import Environment, tree_of
from rkhs_ros.runs.episode_files import load_episodes
from rkhs_ros.runs.report import is_started

DISCOUNT = 0.99  # if the file contains no task


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("episodes", type=Path, metavar="DIR|EPISODES", help="a run's folder, episodes *.npz, or a recording")
    add(
        "--env",
        type=named,
        metavar="ID",
        help="the environment of the episodes, if the file does not name it, or its module is in the current folder",
    )
    add(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="KEY=VALUE",
        help="centres, ridge, action_repeat, and inputs.* and kernel.* as for train",
    )
    add(
        "--out",
        type=Path,
        default=Path("imitated.npz"),
        metavar="FILE",
        help="policy file to write (default: %(default)s)",
    )


def run(options: argparse.Namespace) -> int:
    """Fit the policy, save it, and print its distance from the demonstrations."""
    file = options.episodes
    episodes, recorded_task, repeat = (*load_episodes(file), 1) if file.suffix == ".npz" else _recorded(file)
    imitation = imitation_from(tree_of([f"action_repeat={repeat}", *options.set]))
    task = _task(episodes, recorded_task, options.env)
    spaces = spaces_of(Environment(task.environment, task.options)) if task.environment else _plain(episodes)
    for what, size in (("observations", spaces.observation_dim), ("actions", spaces.action_dim)):
        got = getattr(episodes, what).shape[2]
        require(got == size, f"{file}: {what}", f"{size} numbers for {task.environment}", got)
    policy = Policy(imitation.fit(episodes, spaces), task, spaces)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    policy.save(options.out)
    mean = policy.gaussian.mean
    rms = " ".join(f"{sd:.3g}" for sd in np.sqrt(policy.gaussian.variance(np.zeros((1, mean.input_dim)))[0]))
    steps, centres = episodes.count, len(mean.centres)
    print(f"Fitted {centres} centres to {len(episodes)} episodes with {steps} steps; rms error of the action: {rms}.")
    print(f"Policy: {options.out}")
    if not task.environment:
        print("The policy file names no environment; pass --env ID to evaluate the policy.")
    return 0


def _recorded(path: Path) -> tuple[Episodes, Task | None, int]:
    """Return the completed episodes of a recording, or the last ones of a run in a folder.

    Returns:
        The episodes, their task, and the action repeat of the newest policy, or 1.
    """
    recording = read_recording(path)
    episodes = recording.last_episodes() if is_started(path) else recording.episodes()
    return episodes, recording.head.task if recording.head else None, recording.action_repeat or 1


def _task(episodes: Episodes, recorded: Task | None, environment: str | None) -> Task:
    if recorded is not None and environment in (None, recorded.environment):
        return recorded
    return Task(environment or "", {}, episodes.horizon, DISCOUNT)


def _plain(episodes: Episodes) -> Spaces:
    return Spaces.unbounded(episodes.observations.shape[2], episodes.actions.shape[2])
