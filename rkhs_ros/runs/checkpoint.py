"""Checkpoints, from which a run resumes after it was stopped, killed or lost power."""

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rkhs_ros import __version__
from rkhs_ros.base.files import read_whole, sync_to_disk, write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.state import State
from rkhs_ros.policies.storage import packed, policy_arrays, policy_of, unpacked
from rkhs_ros.recordings.recording import FILE
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import KINDS, Row

SCHEMA = 8
SYNC_EVERY = 1.0  # seconds; waiting for the disk takes longer than many iterations
STORED = 2  # newest checkpoints that are not deleted
FREE = ("iterations", "timeout")  # settings that do not affect the result of an iteration
COUNTS = ("iterations", "explored", "evaluated", "steps")  # of a state
REMEDY = "Restore the file, or train in another folder."
WHOLE = "expected an intact checkpoint to resume from"
ROW = np.dtype(list(KINDS.items()))


class OtherRunError(ValueError):
    """Raised for an intact checkpoint that belongs to another run."""


class Checkpoint(NamedTuple):
    """The progress of a run after an iteration.

    Attributes:
        state: the state of the run; read from a file, its memory is empty, since the recording contains the episodes.
        rows: the rows of its learning curve.
    """

    state: State
    rows: list[Row]


class Checkpoints:
    """Checkpoints of a run, DIR/checkpoints/ITERATION.npz.

    Owns these files. The last two checkpoints stay, in case one is damaged. The newest checkpoint that was synced to
    the disk stays as well, since a power cut may destroy the others.

    Args:
        folder: the folder DIR of the run.
        config: configuration of the run.
        clock: monotonic clock in seconds.
    """

    def __init__(self, folder: Path, config: Config, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder = folder / "checkpoints"
        self._recording = folder / FILE
        self._config = config
        self._clock = clock
        self._synced_at = clock()
        self._synced: Path | None = None
        self._last: list[Path] = []

    def write(self, state: State, rows: Sequence[Row]) -> None:
        """Write the state after an iteration, with the rows of the learning curve so far.

        Raises:
            OSError: the checkpoint cannot be written; earlier checkpoints are unchanged.
        """
        now = self._clock()
        due = now - self._synced_at >= SYNC_EVERY
        if due:
            sync_to_disk(self._recording)  # first, since a checkpoint without the recorded episodes is useless
        path = self._path(state.iterations)
        write_whole(path, self._content(state, rows), sync=due)
        if due:
            self._synced, self._synced_at = path, now
        self._last = [*self._last, path][-STORED:]
        for old in self._folder.glob("*.npz*"):  # includes *.npz.part of an interrupted write
            if old not in (*self._last, self._synced):
                old.unlink()

    def newest(self) -> Checkpoint | None:
        """Return the newest intact checkpoint from before the last iteration; print a warning for each damaged one.

        A finished run repeats its last iteration, with a bit-identical result, and returns it to the caller.

        Returns:
            The checkpoint, or None if there is none.

        Raises:
            ValueError: a checkpoint has another schema, other settings, or more iterations than the run;
                or all checkpoints are damaged.
            OSError: the disk failed.
        """
        total = self._config.training.iterations
        damaged, final = list[Path](), list[Path]()
        for path in sorted(self._folder.glob("*.npz"), reverse=True):
            found = self._read(path)
            done = found.state.iterations if found else 0
            require(done <= total, "iterations", f"at least {done}, the number of finished iterations", total)
            if found and done < total:
                return found
            (final if found else damaged).append(path)
        if damaged and final:
            raise OtherRunError(
                f"{damaged[0]}: expected an intact checkpoint from before the last iteration, got a damaged one and "
                f"{final[0].name} after it. Resume with more iterations, or restore the file."
            )
        if damaged:
            raise OtherRunError(f"{damaged[0]}: {WHOLE}, got damaged ones only. {REMEDY}")
        return None

    def last(self) -> Checkpoint:
        """Return the newest intact checkpoint; print a warning for each damaged one.

        Raises:
            ValueError: there is no intact checkpoint, or it has another schema or other settings.
            OSError: the disk failed.
        """
        for path in sorted(self._folder.glob("*.npz"), reverse=True):
            if found := self._read(path):
                return found
        raise ValueError(f"{self._folder}: expected an intact checkpoint, got none")

    def resume_from(self, state: State) -> None:
        """Sync the checkpoint of a state to the disk, and delete newer ones.

        The run repeats the iterations of the deleted checkpoints.

        Raises:
            OSError: the disk failed.
        """
        path = self._path(state.iterations)
        for other in self._folder.glob("*.npz"):
            if other.name > path.name:
                other.unlink()
        sync_to_disk(path)
        sync_to_disk(self._folder)
        self._synced, self._last = path, [path]

    def _path(self, iterations: int) -> Path:
        return self._folder / f"{iterations:07}.npz"

    def _content(self, state: State, rows: Sequence[Row]) -> bytes:
        about = {"schema": SCHEMA, "version": __version__, "settings": self._config.settings}
        counts = {name: getattr(state, name) for name in COUNTS}
        about |= counts | {"earlier": len(state.earlier)}
        earlier = {
            f"earlier_{i}_{n}": a for i, each in enumerate(state.earlier) for n, a in policy_arrays(each).items()
        }
        progress = {"about": np.array(json.dumps(about).encode()), "rows": np.array(list(rows), dtype=ROW)}
        return packed({**progress, **policy_arrays(state.policy), **earlier})

    def _read(self, path: Path) -> Checkpoint | None:
        """Return the content of a checkpoint; None if it is damaged."""
        try:
            arrays = unpacked(read_whole(path))
            about = json.loads(arrays["about"].item())
            _check_same_run(path, about, self._config.settings)
            counts = {name: about[name] for name in COUNTS}
            good = all(type(count) is int and count >= 0 for count in counts.values())
            require(good, "counts", "whole numbers >= 0", counts)
            rows = [Row(*row) for row in arrays["rows"].astype(ROW).tolist()]
            require(len(rows) == counts["iterations"], "rows", f"{counts['iterations']}, one per iteration", len(rows))
            earlier = tuple(policy_of(_named(f"earlier_{i}_", arrays)) for i in range(about["earlier"]))
            policy, none = policy_of(arrays), Episodes.none(1, 1, 1)
            return Checkpoint(State(policy=policy, memory=none, earlier=earlier, **counts), rows)
        except OtherRunError:
            raise
        except Exception as error:  # a damaged archive raises almost anything
            _skip(path, f"damaged, {type(error).__name__}: {error}")
            return None


def _check_same_run(path: Path, about: dict[str, Any], compared: dict[str, Any]) -> None:
    schema, version = about["schema"], about["version"]
    if schema != SCHEMA:
        raise OtherRunError(
            f"{path}: expected a checkpoint of schema {SCHEMA}, got schema {schema}. Resume with rkhs_ros {version}"
        )
    began = about["settings"]
    given = json.loads(json.dumps(compared))
    for name in [*given, *began]:
        expected, got = (settings.get(name, "no such setting") for settings in (began, given))
        if expected != got and name not in FREE:
            raise OtherRunError(
                f"{path}: {name}: expected {expected} as at the start of the run, got {got}. Start another run"
            )


def _skip(path: Path, reason: str) -> None:
    print(f"warning: {path}: skipped ({' '.join(reason.split())})", file=sys.stderr)


def _named(prefix: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arrays whose names begin with a prefix, without it."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
