"""``rkhs export``: export recorded episodes to other formats."""

from __future__ import annotations

import argparse
from pathlib import Path

from rkhs_ros.app.trust import reads_data
from rkhs_ros.base.validation import require
from rkhs_ros.recordings.lerobot import export
from rkhs_ros.recordings.recording import read_recording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("recording", type=Path, metavar="RECORDING", help="a recording, or the folder of a recorded run")
    add("--lerobot", type=Path, metavar="DIR", required=True, help="new folder for the LeRobotDataset v3.0")
    add(
        "--fps",
        type=float,
        metavar="N",
        help="steps per second, a whole number (default: from the time stamps of a robot)",
    )
    add("--task", metavar="TEXT", help="description of the task (default: id of the environment)")


@reads_data
def run(options: argparse.Namespace) -> int:
    """Write the completed episodes and print their number."""
    fps = None if options.fps is None else _whole_fps(options.fps)
    recording = read_recording(options.recording)
    task = options.task or (recording.head.task.environment if recording.head else "")
    require(bool(task), "--task", "a description of the task, which a bag does not contain", "none")
    spaces = recording.head.spaces if recording.head else None
    count, rate = export(recording.finished, task, options.lerobot, fps, spaces)
    print(f"Exported {count} episodes at {rate} steps per second: {options.lerobot}")
    return 0


def _whole_fps(fps: float) -> int:
    """Return the steps per second as an integer.

    Raises:
        ValueError: it is not a positive whole number.
    """
    require(fps >= 1 and fps.is_integer(), "--fps", "a positive whole number, which LeRobot requires", f"{fps:g}")
    return int(fps)
