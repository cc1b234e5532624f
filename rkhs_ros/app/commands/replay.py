"""``rkhs replay``: make every update of a recording again, and compare the bits."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from rkhs_ros.app.trust import add_trust_argument, reads_data
from rkhs_ros.base.endings import FAILED
from rkhs_ros.base.threads import use_one_thread
from rkhs_ros.recordings.recording import Recording, read_recording
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
    add_trust_argument(parser)


@reads_data
def run(options: argparse.Namespace) -> int:
    """Say that all updates have the recorded bits, or which is the first that has not."""
    recording = read_recording(options.recording)
    head, total = recording.head, len(recording.updates)
    if head is None:
        got = "a damaged one, whose head cannot be read" if recording.lost else "a bag, which holds no policies"
        raise ValueError(f"{options.recording}: expected the recording of a run, got {got}")
    use_one_thread()
    done = 0
    try:
        with progress_bar(replace(training_of(head), iterations=max(total, 1)), quiet=options.quiet) as show:
            for iteration in replay(recording):
                done = iteration.number
                show(iteration)
    except DifferenceError as error:
        print(f"{error}; {done} of {total} updates before it equal to the bit{_other_versions(recording)}")
        return FAILED
    print(f"all {total} updates equal to the bit")
    return 0


def _other_versions(recording: Recording) -> str:
    """Return with which other versions a recording was made; nothing where they are those of now."""
    others = sorted({version for head in recording.heads for version in head.versions} - set(provenance_lines()))
    return f" (recorded with {', '.join(others)})" if others else ""
