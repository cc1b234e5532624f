"""Index of runs by their settings and provenance, so that changing either creates a new run."""

from hashlib import blake2b
from pathlib import Path

from rkhs_ros.base.yaml_text import dumped
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.provenance import provenance


def indexed_folder(folder: Path, config: Config) -> Path:
    """Return the folder of a run within the folder of its study, named by a hash of settings and provenance.

    Args:
        folder: folder of the study.
        config: configuration of the run.
    """
    key = dumped(config.parameters()) + dumped(provenance())
    return folder / "runs" / blake2b(key.encode(), digest_size=12).hexdigest()
