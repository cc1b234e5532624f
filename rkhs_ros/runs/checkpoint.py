"""Checkpoints, from which a run resumes after it was stopped, killed or lost power."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping
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

SCHEMA = 6
ACCEPT = "--allow-provenance-change"  # option of ``rkhs train``
SYNC_EVERY = 1.0  # seconds; waiting for the disk takes longer than many iterations
STORED = 2  # newest checkpoints that are not deleted
FREE = ("iterations", "timeout")  # settings that do not affect the result of an iteration
COUNTS = ("iterations", "explored", "evaluated", "steps")  # of a state
_digest = partial(blake2b, digest_size=16)
REMEDY = "Restore the file, or train in another folder."
WHOLE = "expected an intact checkpoint to resume from"
MEMORY = [f.name for f in fields(Episodes)]


class OtherRunError(ValueError):
    """Raised for an intact checkpoint that belongs to another run."""


class Checkpoints:
    """Checkpoints of a run, DIR/checkpoints/ITERATION.npz.

    Owns these files. The last two checkpoints stay, in case one is damaged. The newest checkpoint that was synced to
    the disk stays as well, since a power cut may destroy the others.

    Args:
        folder: the folder DIR of the run.
        config: configuration of the run.
        provenance_may_change: whether to resume a run of other code or libraries.
        clock: monotonic clock in seconds.

    Attributes:
        recorded: whether the run is recorded; stored in each checkpoint, and read by `newest`.
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
        self._compared = config.settings if provenance_may_change else config.settings | self._provenance
        self._lines = _digest()
        self._digested = 0  # bytes of curve.csv

    def write(self, state: State) -> None:
        """Write the state after an iteration, whose line must already be in curve.csv.

        Raises:
            OSError: the checkpoint cannot be written; earlier checkpoints are unchanged.
        """
        now = self._clock()
        due = now - self._synced_at >= SYNC_EVERY
        if due:
            sync_to_disk(self._curve)  # first, since a checkpoint without its line is useless
        path = self._path(state.iterations)
        write_whole(path, self._content(state), sync=due)
        if due:
            self._synced, self._synced_at = path, now
        self._last = [*self._last, path][-STORED:]
        for old in self._folder.glob("*.npz*"):  # includes *.npz.part of an interrupted write
            if old not in (*self._last, self._synced):
                old.unlink()

    def newest(self, lines: int) -> State | None:
        """Return the state of the newest intact checkpoint; print a warning for each damaged one.

        The state is from before the last iteration. Plots show the episodes of the last iteration, which are not
        stored, so that the run repeats this iteration with a bit-identical result.

        Args:
            lines: number of valid lines of curve.csv; a checkpoint of more iterations is skipped.

        Returns:
            The state, or None if there is no such checkpoint.

        Raises:
            ValueError: a checkpoint has another schema, other settings or provenance, or belongs to another curve; or
                the curve lacks lines of all intact checkpoints; or all checkpoints are damaged.
            OSError: the disk failed.
        """
        beyond, damaged, final = list[tuple[Path, int]](), list[Path](), list[Path]()
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
                        _skip(other, f"expected {iterations} lines in curve.csv, got {lines}")
                    return state
                final.append(path)
        if beyond:
            (newest, iterations), *_ = beyond
            raise OtherRunError(
                f"{self._curve}: expected the lines of the {iterations} iterations before {newest.name}, "
                f"got {lines} lines. {REMEDY}"
            )
        if damaged and final:
            raise OtherRunError(
                f"{damaged[0]}: expected an intact checkpoint from before the last iteration, got a damaged one and "
                f"{final[0].name} after it. Resume with more iterations, or restore the file."
            )
        if damaged:
            raise OtherRunError(f"{damaged[0]}: {WHOLE}, got damaged ones only. {REMEDY}")
        return None

    def last(self) -> State:
        """Return the state after the last iteration, from the newest intact checkpoint; warn for each damaged one.

        Raises:
            ValueError: there is no intact checkpoint, or it has another schema or other settings.
            OSError: the disk failed.
        """
        for path in sorted(self._folder.glob("*.npz"), reverse=True):
            if found := self._read(path):
                return found[0]
        raise ValueError(f"{self._folder}: expected an intact checkpoint, got none")

    def resume_from(self, state: State) -> None:
        """Sync the checkpoint of a state to the disk, and delete newer ones.

        The run repeats the iterations of the deleted checkpoints, and their lines get other values of seconds.

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
        about |= counts | {"earlier": len(state.earlier)}
        earlier = {
            f"earlier_{i}_{n}": a for i, each in enumerate(state.earlier) for n, a in policy_arrays(each).items()
        }
        return packed(
            {"about": np.array(json.dumps(about).encode()), **policy_arrays(state.policy), **earlier, **memory}
        )

    def _read(self, path: Path) -> tuple[State, str] | None:
        """Return the state in a checkpoint and the digest of the curve up to it; None if it is damaged."""
        try:
            arrays = unpacked(read_whole(path))
            about = json.loads(arrays["about"].item())
            _check_same_run(path, about, self._compared)
            memory = Episodes(*(arrays[f"memory_{name}"] for name in MEMORY))
            counts = {name: about[name] for name in COUNTS}
            good = all(type(count) is int and count >= 0 for count in counts.values())
            require(good, "counts", "whole numbers >= 0", counts)
            self.recorded |= about.get("recorded") is True
            earlier = tuple(policy_of(_named(f"earlier_{i}_", arrays)) for i in range(about["earlier"]))
            return State(policy=policy_of(arrays), memory=memory, earlier=earlier, **counts), about["curve"]
        except OtherRunError:
            raise
        except Exception as error:  # a damaged archive raises almost anything
            _skip(path, f"damaged, {type(error).__name__}: {error}")
            return None

    def _digest_of_curve(self) -> str:
        """Return the digest of all lines; read only the new ones."""
        with open_regular(self._curve) as file:
            file.seek(self._digested)
            self._lines.update(file.read())
            self._digested = file.tell()
        return self._lines.hexdigest()

    def _check_curve(self, path: Path, iterations: int, digest: str) -> None:
        lines = read_whole(self._curve).splitlines(keepends=True)[: iterations + 1]  # with the header
        if _digest(b"".join(lines)).hexdigest() != digest:
            raise OtherRunError(
                f"{self._curve}: expected the {iterations} lines before {path.name}, got other lines. {REMEDY}"
            )


def _check_same_run(path: Path, about: dict[str, Any], compared: dict[str, Any]) -> None:
    schema, version = about["schema"], about["version"]
    if schema != SCHEMA:
        raise OtherRunError(
            f"{path}: expected a checkpoint of schema {SCHEMA}, got schema {schema}. Resume with rkhs_ros {version}"
        )
    began = about["settings"] | about["provenance"]
    given = json.loads(json.dumps(compared))
    for name in [*given, *about["settings"]]:
        expected, got = (settings.get(name, "no such setting") for settings in (began, given))
        if expected != got and name not in FREE:
            remedy = f", or resume regardless with {ACCEPT}" * (name in about["provenance"])
            raise OtherRunError(
                f"{path}: {name}: expected {expected} as at the start of the run, got {got}. Start another run{remedy}"
            )


def _skip(path: Path, reason: str) -> None:
    print(f"warning: {path}: skipped ({' '.join(reason.split())})", file=sys.stderr)


def _named(prefix: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arrays whose names begin with a prefix, without it."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
