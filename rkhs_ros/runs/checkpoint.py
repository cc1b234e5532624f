"""Checkpoints: what a run goes on from after it was stopped, killed or lost its power."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from rkhs_ros import __version__
from rkhs_ros.base.files import open_regular, read_whole, sync_to_disk, write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.state import State
from rkhs_ros.policies.storage import packed, policy_arrays, policy_of, unpacked
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.provenance import provenance

SCHEMA = 4
ACCEPT = "--allow-provenance-change"  # the option of ``rkhs train``
SYNC_EVERY = 1.0  # seconds; waiting for the disk takes longer than many an iteration
KEPT = 2
FREE = ("iterations", "simulators", "timeout")  # settings that no iteration's result depends on
COUNTS = ("iterations", "explored", "evaluated")  # of a state
_digest = partial(blake2b, digest_size=16)
REMEDY = "Put the file back as it was, or train in another folder."
WHOLE = "expected a whole checkpoint to resume from"
MEMORY = [f.name for f in fields(Episodes)]


class OtherRunError(ValueError):
    """A checkpoint that is sound, but not of this run."""


class Checkpoints:
    """The checkpoints of a run, DIR/checkpoints/ITERATION.npz.

    Owns those files. Kept are the last two, so that there is one if the other is damaged, and the newest of which
    the disk has told that it has it, for a power cut may take the others.

    Args:
        folder: the run's folder DIR.
        config: the run.
        provenance_may_change: whether to go on with a run of other code, libraries or threads.
        clock: tells the seconds since some moment.

    Attributes:
        recorded: whether the run is recorded, which each checkpoint notes; `newest` reads it.
    """

    def __init__(
        self,
        folder: Path,
        config: Config,
        *,
        provenance_may_change: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder = folder / "checkpoints"
        self._curve = folder / "curve.csv"
        self._config = config
        self._clock = clock
        self._synced_at = clock()
        self._synced: Path | None = None
        self._last: list[Path] = []
        self.recorded = False
        self._provenance = provenance()
        self._heeded = config.settings if provenance_may_change else config.settings | self._provenance
        self._lines = _digest()
        self._digested = 0  # bytes of curve.csv

    def write(self, state: State) -> None:
        """Write the state after an iteration, whose line is in curve.csv by then.

        Raises:
            OSError: it cannot be written; those before it are as they were.
        """
        now = self._clock()
        due = now - self._synced_at >= SYNC_EVERY
        if due:
            sync_to_disk(self._curve)  # first, for without its line a checkpoint is of no use
        path = self._path(state.iterations)
        write_whole(path, self._content(state), sync=due)
        if due:
            self._synced, self._synced_at = path, now
        self._last = [*self._last, path][-KEPT:]
        for old in self._folder.glob("*.npz*"):  # what is left of a write cut short, *.npz.part, too
            if old not in (*self._last, self._synced):
                old.unlink()

    def newest(self, lines: int) -> State | None:
        """Return the state to go on from, of the newest checkpoint that is sound; those that are not go to stderr.

        It is from before the last iteration. The pictures show that one's episodes, which are not kept: it is made
        again, to the same bits.

        Args:
            lines: number of good lines of curve.csv; a checkpoint after more iterations is of no use.

        Returns:
            None where there is no such checkpoint.

        Raises:
            ValueError: a checkpoint of another schema, with other settings or provenance, or of another curve; or
                the curve lacks the lines that all sound ones were written after; or no sound one is left to resume
                from, but a damaged one.
            OSError: the disk failed.
        """
        beyond, damaged = list[tuple[Path, int]](), list[Path]()
        for path in sorted(self._folder.glob("*.npz"), reverse=True):
            state, digest = self._read(path) or (None, "")
            if not state:
                damaged.append(path)
            elif state.iterations > lines:
                beyond.append((path, state.iterations))
            else:
                self._check_curve(path, state.iterations, digest)
                if state.iterations < self._config.training.iterations:
                    for other, iterations in beyond:
                        _skip(other, f"curve.csv has the lines of {lines} iterations, not of {iterations}")
                    return state
        if beyond:
            (newest, iterations), *_ = beyond
            raise OtherRunError(
                f"{self._curve}: lines are missing; expected those of {iterations} iterations, which {newest.name} was "
                f"written after, got those of {lines}. {REMEDY}"
            )
        if damaged:
            raise OtherRunError(f"{damaged[0]}: {WHOLE}, got damaged ones only. {REMEDY}")
        return None

    def go_on_from(self, state: State) -> None:
        """Keep the checkpoint of a state, on the disk, until there are newer ones, and remove those after it.

        The lines of their iterations will be written anew, with other seconds than they were written after.

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

    def _content(self, state: State) -> bytes:
        run = {"settings": self._config.settings, "provenance": self._provenance, "curve": self._digest_of_curve()}
        about = {"schema": SCHEMA, "version": __version__, "recorded": self.recorded, **run}
        counts = {name: getattr(state, name) for name in COUNTS}
        memory = {f"memory_{name}": getattr(state.memory, name) for name in MEMORY}
        return packed({"about": np.array(json.dumps(about | counts).encode()), **policy_arrays(state.policy), **memory})

    def _read(self, path: Path) -> tuple[State, str] | None:
        """Return the state in a checkpoint and the digest of the curve up to it, None where it is damaged."""
        try:
            arrays = unpacked(read_whole(path))
            about = json.loads(arrays["about"].item())
            _check_same_run(path, about, self._heeded)
            memory = Episodes(*(arrays[f"memory_{name}"] for name in MEMORY))
            counts = {name: about[name] for name in COUNTS}
            good = all(type(count) is int and count >= 0 for count in counts.values())
            require(good, "counts", "whole numbers >= 0", counts)
            self.recorded |= about.get("recorded") is True
            return State(policy=policy_of(arrays), memory=memory, **counts), about["curve"]
        except OtherRunError:
            raise
        except Exception as error:  # a damaged archive raises almost anything
            _skip(path, f"damaged, {type(error).__name__}: {error}")
            return None

    def _digest_of_curve(self) -> str:
        """Return the digest of all lines, of which only the new ones are read."""
        with open_regular(self._curve) as file:
            file.seek(self._digested)
            self._lines.update(file.read())
            self._digested = file.tell()
        return self._lines.hexdigest()

    def _check_curve(self, path: Path, iterations: int, digest: str) -> None:
        lines = read_whole(self._curve).splitlines(keepends=True)[: iterations + 1]  # the header, too
        if _digest(b"".join(lines)).hexdigest() != digest:
            raise OtherRunError(
                f"{self._curve}: expected the {iterations} lines that {path.name} was written after, got others. "
                f"{REMEDY}"
            )


def _check_same_run(path: Path, about: dict[str, Any], heeded: dict[str, Any]) -> None:
    schema, version = about["schema"], about["version"]
    if schema != SCHEMA:
        raise OtherRunError(
            f"{path}: expected a checkpoint of schema {SCHEMA}, got schema {schema}; go on with rkhs_ros {version}"
        )
    began = about["settings"] | about["provenance"]
    given = json.loads(json.dumps(heeded))
    for name in [*given, *about["settings"]]:
        expected, got = (settings.get(name, "no such setting") for settings in (began, given))
        if expected != got and name not in FREE:
            remedy = f"; {ACCEPT} goes on regardless, and notes it" * (name in about["provenance"])
            raise OtherRunError(
                f"{path}: {name}: expected {expected}, with which the run began, got {got}; "
                f"begin another run for that{remedy}"
            )


def _skip(path: Path, reason: str) -> None:
    print(f"warning: {path}: passed over ({' '.join(reason.split())})", file=sys.stderr)
