"""``rkhs replay``: recompute every update of a recording and check that the results are bit-identical."""

import argparse
from dataclasses import replace
from pathlib import Path

from rkhs_ros.base.endings import FAILED
from rkhs_ros.recordings.recording import Recording, read_recording
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.progress import progress_bar
from rkhs_ros.runs.provenance import provenance_lines
from rkhs_ros.runs.recorded import training_of
from rkhs_ros.runs.replay import DifferenceError, replay


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "recording", type=Path, metavar="RECORDING", help="a recording, or the folder of a recorded run"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(options: argparse.Namespace) -> int:
    """Print that all updates are bit-identical, or the first update that is not."""
    recording = read_recording(options.recording)
    head, total = recording.head, len(recording.updates)
    if head is None:
        got = "one with a damaged header" if recording.lost else "a bag, which contains no policies"
        raise ValueError(f"{options.recording}: expected the recording of a run, got {got}")
    done = 0
    try:
        with progress_bar(replace(training_of(head), iterations=max(total, 1)), quiet=options.quiet) as show:
            for iteration in replay(recording):
                done = iteration.number
                show(iteration)
    except DifferenceError as error:
        print(f"{error}; the first {done} of {total} updates are bit-identical{_other_versions(recording)}")
        return FAILED
    finished = _finished(options.recording)
    if finished > total:
        print(f"the first {total} of {finished} updates are bit-identical; the recording lacks the others")
        return FAILED
    print(f"all {total} updates are bit-identical")
    return 0


def _finished(recording: Path) -> int:
    """Return the number of finished iterations in the folder of a run; 0 for a file, or without a curve."""
    curve = recording / "curve.csv"
    return len(Curve(curve).rows()) if curve.is_file() else 0


def _other_versions(recording: Recording) -> str:
    """Return the versions in the recording that differ from the current ones; empty if none differ."""
    others = sorted({version for head in recording.heads for version in head.versions} - set(provenance_lines()))
    return f" (recorded with {', '.join(others)})" if others else ""
