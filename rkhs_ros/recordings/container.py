"""MCAP files of messages: each message on its own is whole or not there, whatever ends the writing."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple, cast

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from rkhs_ros import __version__
from rkhs_ros.base.files import (
    MOST_BYTES,
    named,
    open_regular,
    require_expansion,
    require_replaceable,
    sync_to_disk,
)
from rkhs_ros.base.validation import require

LIBRARY = "rkhs_ros"  # that wrote a file
HEADER_BYTES = 9  # of a record: what it is, and its length
END_BYTES = 4  # of the record that ends the data, a checksum
ONE_MESSAGE = 1  # bytes after which a chunk ends: each message has its own, with a checksum


class Stored(NamedTuple):
    """A message as it is stored.

    Attributes:
        topic: its topic.
        kind: name of its type, as ``rkhs_interfaces/msg/Policy``.
        definition: of the type.
        content: its bytes.
        time: when it was recorded, in nanoseconds since 1970.
        published: when it was made, alike.
    """

    topic: str
    kind: str
    definition: str
    content: bytes
    time: int
    published: int


class MessageFile:
    """An MCAP file that grows message by message.

    Owns the file: it is written anew beside an old one, whose place it takes once it holds the same.

    Args:
        path: the file.
        held: messages to begin with.
        sync: wait until the disk has each message; else a power cut may lose some, which a killed process does not.
        chunk_bytes: messages that share a checksum, and are lost together where the process is killed.

    Raises:
        OSError: it cannot be written.
        ValueError: there is something else than a file in its place.
    """

    def __init__(
        self, path: Path, held: Iterable[Stored] = (), *, sync: bool = False, chunk_bytes: int = ONE_MESSAGE
    ) -> None:
        require_replaceable(path)
        self.path = path
        self._sync = False  # of all that is held at once
        self._channels: dict[tuple[str, str], int] = {}
        self._number = 0
        aside = path.with_name(path.name + ".part")
        with named(path):
            self._file = aside.open("wb", buffering=0)
        self._outgoing = _Outgoing()
        stream = cast("IO[bytes]", self._outgoing)
        self._writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType.NONE)
        self._writer.start("ros2", f"{LIBRARY} {__version__}")
        for message in held:
            self.write(message)
        self._send()
        sync_to_disk(aside)
        aside.replace(path)
        sync_to_disk(path.parent)
        self._sync = sync

    def write(self, message: Stored) -> None:
        """Write a message, which is there for others, and after a kill, when this returns.

        Raises:
            OSError: it cannot be written; the file holds what it did before.
        """
        self._number += 1
        self._writer.add_message(self._channel(message), message.time, message.content, message.published, self._number)
        self._send()

    def close(self) -> None:
        """Write the index, for others to find their way; a file without one is as good to us.

        Raises:
            OSError: it cannot be written.
        """
        with self._file:
            if not self._outgoing.content:  # else the disk was full
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._send()

    def _send(self) -> None:
        """Hand all that was made to the file, or nothing."""
        content = self._outgoing.content
        with named(self.path):
            try:
                done = 0
                while done < len(content):
                    done += self._file.write(memoryview(content)[done:])
                if self._sync:
                    os.fsync(self._file.fileno())
            except OSError:
                with suppress(OSError):
                    self._file.seek(self._outgoing.sent)
                    self._file.truncate()  # a full disk may have taken a part
                raise
        self._outgoing.sent += len(content)
        self._outgoing.content = b""

    def _channel(self, message: Stored) -> int:
        key = message.topic, message.kind
        if key not in self._channels:
            schema = self._writer.register_schema(message.kind, "ros2msg", message.definition.encode())
            self._channels[key] = self._writer.register_channel(message.topic, "cdr", schema)
        return self._channels[key]


class _Outgoing:
    """What the writer of MCAP made and the file has not got yet.

    Owns these bytes, and how many went before them.
    """

    def __init__(self) -> None:
        self.content = b""
        self.sent = 0

    def write(self, content: bytes) -> int:
        """Add some bytes."""
        self.content += content
        return len(content)

    def tell(self) -> int:
        """Return where in the file the next bytes go."""
        return self.sent + len(self.content)


@dataclass
class Found:
    """What is read of a file that may be damaged.

    Attributes:
        messages: those that are whole, in order.
        faults: what was passed over, a line each.
        lost: bytes of the file that were passed over, or left out at its end.
    """

    messages: list[Stored] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    lost: int = 0


def read_messages(path: Path) -> Found:
    """Return the messages of an MCAP file, up to where it was cut; those whose checksum is wrong are left out.

    Raises:
        ValueError: it is no MCAP file, or too large, as its compressed parts may be.
        OSError: it cannot be read.
    """
    found, scan, unpacked = Found(), Scan(), 0
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        require(size <= MOST_BYTES, f"{path}", f"a recording of at most {MOST_BYTES} bytes", size)
        magic = file.read(len(MCAP0_MAGIC))
        require(magic == MCAP0_MAGIC, f"{path}", "an MCAP file", f"one that begins with {magic!r}")
        at, ended = file.tell(), False
        for code, content in records(file, size):
            try:
                messages = scan.messages(code, content)
                found.messages += messages
                unpacked += sum(len(message.content) for message in messages)
            except Exception as error:  # a damaged record raises almost anything
                what = " ".join(f"{type(error).__name__}: {error}".split())
                found.lost += len(content)
                found.faults.append(f"{len(content)} bytes at {at} passed over: damaged ({what})")
            ended, at = is_end(code, content), file.tell()
            require_expansion(unpacked, size, f"{path}")
    if scan.missing:
        found.faults.append(f"{scan.missing} messages are missing")
    if not ended:
        found.lost += size - at
        rest = (
            f"{size - at} bytes at the end are left out"
            if size > at
            else "nothing of it is lost, but it was not closed"
        )
        found.faults.append(f"cut after {len(found.messages)} messages: {rest}")
    return found


def records(file: IO[bytes], size: int) -> Iterator[tuple[int, bytes]]:
    """Yield the opcode and content of each whole record, up to the end of the data or where the file was cut.

    Raises:
        ValueError: a record is too large for the memory.
    """
    while file.tell() + HEADER_BYTES <= size:
        begin = file.tell()
        header = file.read(HEADER_BYTES)
        length = int.from_bytes(header[1:], "little")
        if length > size - file.tell():
            file.seek(begin)
            return
        require(length <= MOST_BYTES, f"{file.name}", f"records of at most {MOST_BYTES} bytes", length)
        yield header[0], (content := file.read(length))
        if is_end(header[0], content):
            return


def is_end(code: int, content: bytes) -> bool:
    """Return whether a record ends the data; one of another size is an index whose opcode is damaged."""
    return code == Opcode.DATA_END and len(content) == END_BYTES


def _unpacked(chunk: Chunk) -> Chunk:
    """Return a chunk without compression.

    Raises:
        ValueError: it would grow beyond all measure, or to another size than it says.
    """
    if not chunk.compression:
        return chunk
    require_expansion(chunk.uncompressed_size, len(chunk.data), "chunk")
    most = chunk.uncompressed_size + 1  # one more, to see whether it ends there
    if chunk.compression == "zstd":
        from zstandard import ZstdDecompressor  # here and below, since ours are not compressed

        data = ZstdDecompressor().stream_reader(chunk.data).read(most)
    else:
        require(chunk.compression == "lz4", "chunk", "compression by zstd or lz4", chunk.compression)
        from lz4.frame import LZ4FrameDecompressor

        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=most)
    require(len(data) == chunk.uncompressed_size, "chunk", f"{chunk.uncompressed_size} bytes", len(data))
    return replace(chunk, compression="", data=data)


class Scan:
    """The messages of records that come one after the other.

    Owns the types and channels seen so far, and counts the messages that must be missing.
    """

    def __init__(self) -> None:
        self.missing = 0
        self._number = 0
        self._numbered = False
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def messages(self, code: int, content: bytes) -> list[Stored]:
        """Return the messages in a record, of which there are none in most."""
        stream = ReadDataStream(BytesIO(content))
        if code == Opcode.HEADER:
            self._numbered = Header.read(stream).library.startswith(LIBRARY)
        if code == Opcode.CHUNK:
            return [
                message
                for record in breakup_chunk(_unpacked(Chunk.read(stream)), validate_crc=True)
                for message in self._taken(record)
            ]
        if code == Opcode.SCHEMA:
            return self._taken(Schema.read(stream))
        if code == Opcode.CHANNEL:
            return self._taken(Channel.read(stream))
        return self._taken(Message.read(stream, len(content))) if code == Opcode.MESSAGE else []

    def _taken(self, record: McapRecord) -> list[Stored]:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record
        elif isinstance(record, Message):
            channel = self._channels[record.channel_id]
            schema = self._schemas[channel.schema_id]
            self._count(record.sequence)
            times = record.log_time, record.publish_time
            return [Stored(channel.topic, schema.name, schema.data.decode(), record.data, *times)]
        return []

    def _count(self, number: int) -> None:
        """Note the number of a message, which in our files grows by 1 with each."""
        if self._numbered:
            self.missing += max(number - self._number - 1, 0)
            self._number = number
