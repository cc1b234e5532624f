"""The checkpoint of a run, from which it resumes after it was stopped, killed or lost power."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rkhs_ros.base.files import read_whole, sync_to_disk, write_whole
from rkhs_ros.base.validation import require, truncated
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Row
from rkhs_ros.learning.state import State
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.storage import Arrays, packed, policy_arrays, policy_of, unpacked
from rkhs_ros.recordings.recording import FILE as RECORDING
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import KINDS

FILE = "checkpoint.npz"
WRITE_EVERY = 1.0  # seconds; waiting for the disk takes longer than many iterations
FREE = ("iterations", "timeout")  # settings that do not affect the result of an iteration
COUNTS = ("iterations", "explored", "evaluated", "steps")  # of a state
REMEDY = "Restore the file, or train in another folder"
ROW = np.dtype(list(KINDS.items()))
NO_MEMORY = Episodes.none(1, 1, 1)


class Checkpoint(NamedTuple):
    """The progress of a run after an iteration, or before the first one.

    Attributes:
        state: the state of the run; read from a file, its memory is empty, since the recording contains the episodes.
        rows: the rows of its learning curve.
        best_policy: its best policy; None before the first evaluation.
        given: its initial policy, if one was given.
    """

    state: State
    rows: Sequence[Row] = ()
    best_policy: GaussianPolicy | None = None
    given: GaussianPolicy | None = None


class Checkpoints:
    """Writer of the checkpoint of a run.

    Owns the file DIR/checkpoint.npz, which is replaced at most once a second, and at the end. It is on the disk before
    it replaces its predecessor, and so are the recorded episodes that it needs.

    Args:
        folder: the folder DIR of the run.
        config: configuration of the run.
        clock: monotonic clock in seconds.
    """

    def __init__(self, folder: Path, config: Config, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder = folder
        self._config = config
        self._clock = clock
        self._due = float("-inf")
        self._newest: Checkpoint | None = None

    def add(self, checkpoint: Checkpoint) -> None:
        """Write a checkpoint, at once or with a later one.

        Raises:
            OSError: the checkpoint cannot be written; the earlier one is unchanged.
        """
        self._newest = checkpoint
        if self._clock() >= self._due:
            self.close()

    def close(self) -> None:
        """Write the newest checkpoint, unless it is written.

        Raises:
            OSError: the checkpoint cannot be written; the earlier one is unchanged.
        """
        if self._newest is not None:
            sync_to_disk(self._folder / RECORDING)
            write_checkpoint(self._folder, self._config, self._newest)
            self._newest = None  # after the file is written, which may be interrupted
            self._due = self._clock() + WRITE_EVERY


def write_checkpoint(folder: Path, config: Config, checkpoint: Checkpoint) -> None:
    """Write the checkpoint of a run.

    Raises:
        OSError: the checkpoint cannot be written; the earlier one is unchanged.
    """
    state, named = checkpoint.state, {"best_": checkpoint.best_policy, "given_": checkpoint.given}
    counts = {name: getattr(state, name) for name in COUNTS}
    about = {"settings": config.settings, "earlier": len(state.earlier), **counts}
    policies = {f"earlier_{number}_": policy for number, policy in enumerate(state.earlier)}
    policies |= {prefix: policy for prefix, policy in named.items() if policy}
    arrays = {f"{prefix}{name}": a for prefix, each in policies.items() for name, a in policy_arrays(each).items()}
    progress = {"about": np.array(json.dumps(about).encode()), "rows": np.array(list(checkpoint.rows), dtype=ROW)}
    write_whole(folder / FILE, packed({**progress, **policy_arrays(state.policy), **arrays}))


def start_from(folder: Path, config: Config, policy: GaussianPolicy | None) -> None:
    """Prepare the folder of a run that has not started: with an initial policy, or None for the default.

    Raises:
        OSError: the folder cannot be written.
    """
    if policy is None:
        (folder / FILE).unlink(missing_ok=True)  # left by a run that was killed before it started
    else:
        write_checkpoint(folder, config, Checkpoint(State(0, policy, NO_MEMORY, 0, 0, 0), given=policy))


def read_checkpoint(folder: Path, config: Config) -> Checkpoint | None:
    """Return the checkpoint of a run; None if there is none.

    A finished run has the checkpoint before its last iteration, which a resume repeats with a bit-identical result.

    Raises:
        ValueError: the file is damaged, or of a run with other settings or more iterations.
        OSError: the file cannot be read.
    """
    path = folder / FILE
    if not path.exists():
        return None
    try:
        arrays = unpacked(read_whole(path))
        about = json.loads(arrays["about"].item())
        found = _checkpoint(about, arrays)
    except Exception as error:  # a damaged archive raises almost anything
        if isinstance(error, OSError):
            raise
        got = truncated(f"{type(error).__name__}: {error}")
        raise ValueError(f"{path}: expected an intact checkpoint, got a damaged one ({got}). {REMEDY}") from error
    _check_same_run(folder, about["settings"], config.settings)
    total, least = config.training.iterations, found.state.iterations + 1
    require(total >= least, "iterations", f"at least {least}, more than the finished ones", total)
    return found


def initial_policy(folder: Path) -> str:
    """Return a digest of the policy that a run was given to begin with; empty if none was given, or it is lost."""
    digest = blake2b(digest_size=12)
    with suppress(Exception):  # a damaged archive raises almost anything
        arrays = _named("given_", unpacked(read_whole(folder / FILE)))
        for name in sorted(arrays):
            digest.update(arrays[name].tobytes())
        return digest.hexdigest() if arrays else ""
    return ""


def _checkpoint(about: Mapping[str, Any], arrays: Arrays) -> Checkpoint:
    counts = {name: about[name] for name in COUNTS}
    rows = [Row(*row) for row in arrays["rows"].astype(ROW).tolist()]
    require(len(rows) == counts["iterations"], "rows", f"{counts['iterations']}, one per iteration", len(rows))
    earlier = tuple(policy_of(_named(f"earlier_{number}_", arrays)) for number in range(about["earlier"]))
    state = State(policy=policy_of(arrays), memory=NO_MEMORY, earlier=earlier, **counts)
    best, given = (_named(prefix, arrays) for prefix in ("best_", "given_"))
    return Checkpoint(state, rows, policy_of(best) if best else None, policy_of(given) if given else None)


def _check_same_run(folder: Path, began: Mapping[str, Any], settings: Mapping[str, Any]) -> None:
    given = json.loads(json.dumps(settings))
    for name in [*given, *began]:
        expected, got = (each.get(name, "no such setting") for each in (began, given))
        if expected != got and name not in FREE:
            raise ValueError(
                f"{folder}: {name}: expected {expected} as at the start of the run, got {got}. Start another run"
            )


def _named(prefix: str, arrays: Arrays) -> Arrays:
    """Return the arrays whose names begin with a prefix, without it."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
