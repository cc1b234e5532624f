"""``rkhs export``: recorded episodes in other formats."""

from __future__ import annotations

import argparse
from pathlib import Path

from rkhs_ros.base.validation import require
from rkhs_ros.recordings.lerobot import export
from rkhs_ros.recordings.recording import read_recording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("recording", type=Path, metavar="RECORDING", help="a recording, or the folder of a recorded run")
    add("--lerobot", type=Path, metavar="DIR", required=True, help="a new folder for a LeRobotDataset v3.0")
    add("--fps", type=float, metavar="N", help="steps in a second (what a robot's stamps say)")
    add("--task", metavar="TEXT", help="what the episodes are of (the environment)")


def run(options: argparse.Namespace) -> int:
    """Write the episodes that count, and say how many they are."""
    require(options.fps is None or options.fps > 0, "--fps", "a number above 0", options.fps)
    recording = read_recording(options.recording)
    task = options.task or (recording.head.task.environment if recording.head else "")
    require(bool(task), "--task", "what the episodes of a bag are of", "none")
    count = export(
        recording.finished, task, options.lerobot, options.fps, recording.head.spaces if recording.head else None
    )
    print(f"Exported {count} episodes: {options.lerobot}")
    return 0
