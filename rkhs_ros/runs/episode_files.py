"""Episodes in files: plain arrays in npz, no pickle."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from rkhs_ros.base.files import write_whole
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.storage import Task, packed, unpacked

SCHEMA = 1


def save_episodes(path: Path, episodes: Episodes, task: Task) -> None:
    """Write episodes and the task they are of; an existing file is replaced whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    about = {"schema": np.array(SCHEMA), "task": np.array(json.dumps(asdict(task), sort_keys=True))}
    write_whole(path, packed({**about, **{f.name: getattr(episodes, f.name) for f in fields(episodes)}}))


def load_episodes(path: Path) -> tuple[Episodes, Task]:
    """Read episodes and the task they are of.

    Raises:
        ValueError: the file is cut short, of another kind, or holds what are no episodes.
        FileNotFoundError: there is no such file.
    """
    try:
        arrays = unpacked(path.read_bytes())
        return Episodes(*(arrays[f.name] for f in fields(Episodes))), Task(**json.loads(str(arrays["task"])))
    except FileNotFoundError:
        raise
    except Exception as error:  # a damaged archive raises almost anything
        reason = " ".join(str(error).split())
        raise ValueError(
            f"{path}: expected a file of episodes (npz), got one that cannot be read ({reason})"
        ) from error
