"""``rkhs imitate``: fit a policy to what was shown, to evaluate it or to learn on from it."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from rkhs_ros.app.inline import spaces_of
from rkhs_ros.app.trust import add_trust_argument, reads_data
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.imitation import imitation_from
from rkhs_ros.policies.policy import Policy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.config import Environment, tree_of
from rkhs_ros.runs.episode_files import load_episodes

DISCOUNT = 0.99  # of a task that the file does not tell


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("episodes", type=Path, metavar="DIR|EPISODES", help="a run's folder, a file of episodes *.npz, or a recording")
    add("--env", metavar="ID", help="the environment that they are of, where the file does not tell")
    add_trust_argument(parser)
    add(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="KEY=VALUE",
        help="centres, ridge, inputs.*, kernel.*, as of train",
    )
    add("--out", type=Path, default=Path("imitated.npz"), metavar="FILE", help="the policy's file (%(default)s)")


@reads_data
def run(options: argparse.Namespace) -> int:
    """Fit the policy, save it, and say how far it is from what was shown."""
    file = options.episodes / "episodes.npz" if (options.episodes / "episodes.npz").is_file() else options.episodes
    episodes, told = load_episodes(file) if file.suffix == ".npz" else _recorded(file)
    imitation = imitation_from(tree_of(options.set))
    task = _task(episodes, told, options.env)
    spaces = spaces_of(Environment(task.environment, task.options)) if task.environment else _plain(episodes)
    for what, size in (("observations", spaces.observation_dim), ("actions", spaces.action_dim)):
        got = getattr(episodes, what).shape[2]
        require(got == size, f"{file}: {what}", f"{size} numbers, as {task.environment} has", got)
    policy = Policy(imitation.fit(episodes), task, spaces)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    policy.save(options.out)
    mean = policy.gaussian.mean
    off = " ".join(f"{sd:.3g}" for sd in np.sqrt(policy.gaussian.variance(np.zeros((1, mean.input_dim)))[0]))
    steps, centres = int(episodes.mask.sum()), len(mean.centres)
    print(f"Imitated {steps} steps of {len(episodes)} episodes by {centres} centres, to within {off} (rms action).")
    print(f"Policy: {options.out}")
    if not task.environment:
        print("It names no environment to be evaluated in: say --env ID.")
    return 0


def _recorded(file: Path) -> tuple[Episodes, Task | None]:
    """Return the episodes of a recording that count, and their task."""
    recording = read_recording(file)
    return recording.episodes(), recording.head.task if recording.head else None


def _task(episodes: Episodes, told: Task | None, environment: str | None) -> Task:
    if environment is not None:
        return Task(environment, {}, episodes.horizon, DISCOUNT)
    return told or Task("", {}, episodes.horizon, DISCOUNT)


def _plain(episodes: Episodes) -> Spaces:
    return Spaces.unbounded(episodes.observations.shape[2], episodes.actions.shape[2])
