"""Foreign or damaged files are read within limits, and rejected in one line."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from rkhs_ros.base.files import MOST_BYTES
from rkhs_ros.policies.policy import load
from rkhs_ros.recordings.recorder import read_held
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.episode_files import load_episodes
from rkhs_ros.view.serving import source_of
from test.unit.recordings.recorded_runs import longer, recorded_run

GIGABYTE = 2**30
READERS: dict[str, Callable[[Path], object]] = {
    "policy.npz": load,
    "episodes.npz": load_episodes,
    "config.yaml": load_config,
    "curve.csv": lambda path: Curve(path).rows(),
    "recording.mcap": read_recording,
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_run(tmp_path_factory.mktemp("whole") / "run", longer(1, episodes_per_iteration=1))


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", READERS)
def test_a_file_larger_than_the_limit_is_rejected_unread(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with path.open("wb") as file:
        file.write(b"\x89MCAP0\r\n")
        file.truncate(100 * MOST_BYTES)  # a sparse file, which takes no space on the disk
    with pytest.raises(ValueError, match=rf"{name}: expected .* of at most "):
        READERS[name](path)


def readers(path: Path) -> None:
    """Read a recording like each of the commands; raise errors that give more than one line."""
    for read in (read_recording, partial(read_held, iterations=2, keeps_later=True), looked_at):
        with suppress(ValueError, OSError):
            read(path)


def looked_at(path: Path) -> None:
    source = source_of(path)
    source.refresh()
    for iteration in source.iterations:
        source.load(iteration)


@pytest.mark.slow
def test_a_recording_with_a_changed_byte_is_read_or_rejected(whole: Path, tmp_path: Path) -> None:
    content, path = whole.read_bytes(), tmp_path / "changed.mcap"
    for place in range(0, len(content), 64):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        readers(path)
