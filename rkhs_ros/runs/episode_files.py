"""Files of episodes: plain arrays in npz format, without pickle."""

import json
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np

from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import REAL_KINDS, finite_array, require, truncated
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.storage import Arrays, Task, packed, unpacked

NAMES = tuple(f.name for f in fields(Episodes))


def save_episodes(path: Path, episodes: Episodes, task: Task) -> None:
    """Write episodes and their task; replace an existing file atomically."""
    about = {"task": np.array(json.dumps(asdict(task), sort_keys=True))}
    write_whole(path, packed({**about, **{name: getattr(episodes, name) for name in NAMES}}))


def load_episodes(path: Path) -> tuple[Episodes, Task | None]:
    """Read episodes and their task, None if unknown, from a file, which other programs may have written.

    Args:
        path: an npz file with ``observations`` of shape (N, H, d) and ``actions`` (N, H, n). Optional arrays are
            ``mask`` (N, H), by default True, ``rewards`` (N, H), by default 0, ``final_observations`` (N, d),
            ``terminated`` (N,) and ``task``.

    Raises:
        ValueError: the file is truncated, has another format, or contains invalid episodes.
    """
    try:
        arrays = unpacked(path.read_bytes())
        task = Task(**json.loads(str(arrays["task"]))) if "task" in arrays else None
        return _episodes(arrays), task
    except FileNotFoundError:
        raise
    except Exception as error:  # a damaged archive raises almost anything
        got = f"an unreadable file ({truncated(error)})"
        raise ValueError(f"{path}: expected a file of episodes (npz), got {got}") from error


def _episodes(arrays: Arrays) -> Episodes:
    for name in ("observations", "actions"):
        require(name in arrays, "arrays", f"an array {name}", ", ".join(sorted(arrays)) or "none")
        shape = arrays[name].shape
        good = len(shape) == 3 and shape[2] > 0
        require(good, name, "three dimensions: episodes, steps, components, of which there is one or more", shape)
    shape = arrays["observations"].shape[:2]
    whole = Episodes.without_ends(
        observations=finite_array(arrays["observations"], arrays["observations"].shape, "observations"),
        actions=finite_array(arrays["actions"], arrays["actions"].shape, "actions"),
        rewards=finite_array(arrays.get("rewards", np.zeros(shape)), shape, "rewards"),
        mask=_flags(arrays.get("mask", np.ones(shape, dtype=bool)), shape, "mask"),
    )
    good = bool((whole.mask[:, 1:] <= whole.mask[:, :-1]).all())
    require(good, "mask", "the first steps of each episode, without gaps", whole.mask)
    count, width = shape[0], arrays["observations"].shape[2]
    final = finite_array(
        arrays.get("final_observations", whole.final_observations), (count, width), "final_observations"
    )
    terminated = _flags(arrays.get("terminated", whole.terminated), (count,), "terminated")
    return replace(whole, final_observations=final, terminated=terminated)


def _flags(values: np.ndarray, shape: tuple[int, ...], what: str) -> np.ndarray:
    """Return Boolean values, which may be stored as 0 and 1."""
    require(values.shape == shape, what, f"the shape {shape}", values.shape)
    good = values.dtype.kind in REAL_KINDS and bool(np.isin(values, (0, 1)).all())
    require(good, what, "Boolean values", values)
    return values.astype(bool)
