"""Foreign or damaged files are read within limits, and rejected in one line."""

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from rkhs_ros.base.files import MOST_BYTES, open_regular, read_whole
from rkhs_ros.policies.policy import load
from rkhs_ros.recordings.container import Found, read_messages
from rkhs_ros.recordings.recording import read_held, read_recording
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.episode_files import load_episodes
from rkhs_ros.view.serving import source_of
from test.unit.conftest import Result, assert_refused
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
def test_reading_does_not_block_on_a_pipe_or_a_device(tmp_path: Path, name: str) -> None:
    for number, make in enumerate((os.mkfifo, lambda path: path.symlink_to("/dev/zero"))):
        path = tmp_path / str(number) / name
        path.parent.mkdir()
        make(path)
        with pytest.raises(
            ValueError, match=rf"{name}: expected .*regular file, got a pipe, a device or a socket"
        ) as no:
            READERS[name](path)
        assert "\n" not in str(no.value)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", READERS)
def test_a_file_larger_than_the_limit_is_rejected_unread(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with path.open("wb") as file:
        file.write(b"\x89MCAP0\r\n")
        file.truncate(100 * MOST_BYTES)  # a sparse file, which takes no space on the disk
    with pytest.raises(ValueError, match=rf"{name}: expected .* of at most "):
        READERS[name](path)


def test_a_folder_or_a_missing_file_raises_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError, match=str(tmp_path)):
        read_whole(tmp_path)
    with pytest.raises(FileNotFoundError, match="none"):
        open_regular(tmp_path / "none")


@pytest.mark.timeout(60)
def test_commands_reject_a_pipe_in_one_line(tmp_path: Path, rkhs: Callable[..., Result]) -> None:
    os.mkfifo("pipe.npz")
    for command in (("evaluate", "pipe.npz"), ("render", "pipe.npz"), ("imitate", "pipe.npz")):
        assert_refused(rkhs(*command), "pipe.npz")
    os.mkfifo("pipe.mcap")
    for command in (("replay", "pipe.mcap"), ("offline", "pipe.mcap"), ("export", "pipe.mcap", "--lerobot", "out")):
        assert_refused(rkhs(*command), "pipe.mcap: expected a regular file, got a pipe")


def bomb(path: Path, compression: CompressionType, chunks: int, size: int) -> None:
    """Write compressed chunks of zeros of a given size."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1, compression=compression)
        writer.start("ros2", "other")
        schema = writer.register_schema("rkhs_interfaces/msg/Episodes", "ros2msg", b"")
        channel = writer.register_channel("episodes", "cdr", schema)
        for _ in range(chunks):
            writer.add_message(channel, 0, bytes(size), 0)
        writer.finish()


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_with_excessive_expansion_is_skipped(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "bomb.mcap"
    bomb(path, compression, chunks=1, size=2**27)
    found = read_messages(path)
    assert found.messages == []
    assert "chunk: expected at most " in found.faults[0]


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_larger_than_declared_is_skipped(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "bomb.mcap"
    bomb(path, compression, chunks=1, size=1000)
    (message,) = read_messages(path).messages
    assert message.content == bytes(1000)
    content = path.read_bytes()
    zeros = bytes(2**26)
    packed = {"zstd": zstandard.compress(zeros), "lz4": lz4.frame.compress(zeros)}[compression.name.lower()]
    at = content.index(b"\x06", 8 + 9)  # record of the chunk
    end = at + 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    kind = compression.name.lower().encode()
    fields = content[at + 9 : at + 9 + 32 + len(kind)] + len(packed).to_bytes(8, "little") + packed
    path.write_bytes(content[: at + 1] + len(fields).to_bytes(8, "little") + fields + content[end:])
    found = read_messages(path)
    assert found.messages == []
    assert "chunk: expected 1125 bytes, got 1126" in found.faults[0]


@pytest.mark.nightly
def test_the_total_expansion_of_chunks_is_limited(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    bomb(path, CompressionType.ZSTD, chunks=100, size=2**26 - 100)  # 6.7 GB from 250 kB
    assert path.stat().st_size < 2**19
    command = [sys.executable, "-m", "rkhs_ros.app.cli", "replay", str(path)]
    ended = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_DATA, (GIGABYTE, GIGABYTE)),
    )
    assert_refused(Result(ended.returncode, ended.stdout, ended.stderr), "bomb.mcap: expected at most ")


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


def test_a_changed_byte_after_the_data_has_no_effect(whole: Path, tmp_path: Path) -> None:
    content, path = whole.read_bytes(), tmp_path / "changed.mcap"
    closing = content.rindex(b"rkhs_interfaces/msg/Policy")  # in the definitions that the index repeats
    end_of_data = content.rindex(b"\x0f" + (4).to_bytes(8, "little"))
    assert closing > end_of_data
    for place in range(closing, closing + 900, 7):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        source = source_of(path)
        source.refresh()
        assert source.load(1) is not None


@pytest.mark.slow
@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.nightly) for part in (1, 2, 3))])
def test_a_recording_with_a_changed_byte_is_read_or_rejected(whole: Path, tmp_path: Path, part: int) -> None:
    content, path = whole.read_bytes(), tmp_path / "changed.mcap"
    for place in range(part, len(content), 16):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        readers(path)


@pytest.mark.slow
@pytest.mark.nightly
def test_a_recording_without_checksums_is_read_or_rejected_in_one_line(whole: Path, tmp_path: Path) -> None:
    path, unguarded = tmp_path / "changed.mcap", tmp_path / "unguarded.mcap"
    found: Found = read_messages(whole)
    with unguarded.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start("ros2", "other")
        channels = {}
        for each in found.messages:
            if each.kind not in channels:
                schema = writer.register_schema(each.kind, "ros2msg", each.definition.encode())
                channels[each.kind] = writer.register_channel(each.topic, "cdr", schema)
            writer.add_message(channels[each.kind], each.time, each.content, each.published)
        writer.finish()
    assert len(read_recording(unguarded).updates) == 1
    content = unguarded.read_bytes()
    for place in range(0, len(content), 5):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        readers(path)
