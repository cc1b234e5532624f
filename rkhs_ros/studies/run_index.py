"""Runs filed by all that they follow from, so that other settings or other code make other runs."""

from __future__ import annotations

from hashlib import blake2b
from pathlib import Path

from rkhs_ros.base.yaml_text import dumped
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.provenance import provenance


def indexed_folder(folder: Path, config: Config, *packages: str) -> Path:
    """Return the folder of a run within that of its study, named by a hash of its settings and surroundings.

    Args:
        folder: of the study.
        config: the run.
        packages: names of those that the task is in.
    """
    key = dumped(config.parameters()) + dumped(provenance(*packages))
    return folder / "runs" / blake2b(key.encode(), digest_size=12).hexdigest()
