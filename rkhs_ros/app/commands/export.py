"""``rkhs export``: export policies, pages of runs and recorded episodes to other formats."""

import argparse
from pathlib import Path

from rkhs_ros.app.commands.view import require_viser
from rkhs_ros.app.named import add_environment_argument
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.policies.onnx_check import TOLERANCE, export_onnx
from rkhs_ros.policies.policy import load
from rkhs_ros.recordings.lerobot import export
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.report import last_policy

PAGE = ".html"
FORMATS = (".onnx", PAGE)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("source", type=Path, metavar="DIR|FILE", help="a run's folder, a policy file, or a recording")
    about = "file for the policy, an ONNX graph (.onnx), or for a page of the run (.html)"
    add("file", type=Path, metavar="FILE", nargs="?", help=about)
    add("--lerobot", type=Path, metavar="DIR", help="new folder for the recorded episodes, as a LeRobotDataset v3.0")
    add(
        "--fps",
        type=float,
        metavar="N",
        help="steps per second, a whole number (default: from the time stamps of a robot)",
    )
    add("--task", metavar="TEXT", help="description of the task (default: id of the environment)")
    add_environment_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Write the policy, the page or the completed episodes."""
    given = [name for name in ("file", "lerobot") if getattr(options, name)]
    require(len(given) == 1, "export", "a file to write or --lerobot DIR", " and ".join(given) or "neither")
    if options.lerobot:
        return _export_episodes(options)
    file = options.file
    require(file.suffix in FORMATS, f"{file}", f"a file that ends in {' or '.join(FORMATS)}", file.suffix or "none")
    return (_export_page if file.suffix == PAGE else _export_policy)(options.source, file)


def _export_page(source: Path, file: Path) -> int:
    """Write the page of a run."""
    require_viser()
    from rkhs_ros.view.html_page import html_page
    from rkhs_ros.view.serving import source_of

    write_whole(file, html_page(source_of(source)).encode())
    print(f"Exported the page of the run: {file}")
    return 0


def _export_policy(source: Path, file: Path) -> int:
    """Write a policy as an ONNX graph and print the result of its check."""
    check = export_onnx(load(last_policy(source) if source.is_dir() else source), file)
    print(f"Exported the policy: {file}")
    print(
        f"Checked on {check.observations} random observations: relative error {check.error:.1g} "
        f"(limit {TOLERANCE:g}), {1e6 * check.seconds:.0f} µs per call (median, one thread)"
    )
    return 0


def _export_episodes(options: argparse.Namespace) -> int:
    """Write the completed episodes and print their number."""
    fps = None if options.fps is None else _whole_fps(options.fps)
    recording = read_recording(options.source)
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
