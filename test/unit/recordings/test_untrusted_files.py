"""Foreign or damaged files are read within limits, and rejected in one line."""

from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from rkhs_ros.recordings.recorder import read_held
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.view.recorded import Recorded
from test.unit.recordings.recorded_runs import longer, recorded_run


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_run(tmp_path_factory.mktemp("whole") / "run", longer(1, episodes_per_iteration=1))


def readers(path: Path) -> None:
    """Read a recording like each of the commands; raise errors that give more than one line."""
    for read in (read_recording, partial(read_held, iterations=2, keeps_later=True), looked_at):
        with suppress(ValueError, OSError):
            read(path)


def looked_at(path: Path) -> None:
    source = Recorded(path)
    source.refresh()
    for iteration in source.iterations:
        source.load(iteration)


@pytest.mark.slow
def test_a_recording_with_a_changed_byte_is_read_or_rejected(whole: Path, tmp_path: Path) -> None:
    content, path = whole.read_bytes(), tmp_path / "changed.mcap"
    for place in range(0, len(content), 64):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        readers(path)
