"""MCAP files of messages, in which each message is written atomically, even if the process is killed."""

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import IO, NamedTuple, cast

from mcap.records import Channel, Chunk, DataEnd, Header, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from rkhs_ros import __version__
from rkhs_ros.base.endings import deferred_signals
from rkhs_ros.base.files import named, sync_to_disk
from rkhs_ros.base.validation import require

LIBRARY = "rkhs_ros"  # library field of our files
ONE_MESSAGE = 1  # chunk size in bytes at which each message has its own chunk with a checksum


class Stored(NamedTuple):
    """A stored message."""

    topic: str
    kind: str  # name of its type, such as ``rkhs_interfaces/msg/Policy``
    definition: str  # of the type
    content: bytes  # serialised
    time: int  # of the recording, in nanoseconds since 1970
    published: int  # time of the publication, in nanoseconds since 1970


class MessageFile:
    """MCAP file that grows message by message.

    Owns the file. A new file is written beside an existing one, and replaces it once it holds the initial messages.

    Args:
        path: the file.
        held: initial messages.
        sync: sync each message to the disk. Otherwise a power cut may lose messages; a killed process never does.

    Raises:
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, held: Iterable[Stored] = (), *, sync: bool = False) -> None:
        self.path = path
        self._sync = False  # the initial messages are synced together
        self._channels: dict[tuple[str, str, str], int] = {}
        self._number = 0
        aside = path.with_name(path.name + ".part")
        with named(path):
            self._file = aside.open("wb", buffering=0)
        self._outgoing = _Outgoing()
        stream = cast("IO[bytes]", self._outgoing)
        self._writer = Writer(stream, chunk_size=ONE_MESSAGE, compression=CompressionType.NONE)
        self._writer.start("ros2", f"{LIBRARY} {__version__}")
        for message in held:
            self.write(message)
        self._send()
        sync_to_disk(aside)
        aside.replace(path)
        sync_to_disk(path.parent)
        self._sync = sync

    def write(self, message: Stored) -> None:
        """Write a message; when this returns, readers see it and a kill cannot lose it.

        Raises:
            OSError: the message cannot be written; the file is unchanged.
        """
        with deferred_signals():
            self._number += 1
            channel = self._channel(message)
            self._writer.add_message(channel, message.time, message.content, message.published, self._number)
            self._send()

    def close(self) -> None:
        """Write the index, which other readers use. The index is optional for our reader.

        Raises:
            OSError: the index cannot be written.
        """
        with self._file:
            if not self._outgoing.content:  # otherwise the disk was full
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._send()
                os.fsync(self._file.fileno())

    def _send(self) -> None:
        """Write all pending bytes to the file, or none."""
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
        key = message.topic, message.kind, message.definition  # earlier messages of a resumed run may have an older one
        if key not in self._channels:
            schema = self._writer.register_schema(message.kind, "ros2msg", message.definition.encode())
            self._channels[key] = self._writer.register_channel(message.topic, "cdr", schema)
        return self._channels[key]


class _Outgoing:
    """Buffer between the MCAP writer and the file: the pending bytes and the number of bytes before them."""

    def __init__(self) -> None:
        self.content = b""
        self.sent = 0

    def write(self, content: bytes) -> int:
        """Append bytes."""
        self.content += content
        return len(content)

    def tell(self) -> int:
        """Return the position of the next bytes in the file."""
        return self.sent + len(self.content)


class Found(NamedTuple):
    """Messages found in a file that may be damaged."""

    messages: list[Stored]  # intact, in order
    faults: list[str]  # descriptions of the skipped parts, one line each


class MessageReader:
    """Reader of an MCAP file that may be damaged, and may still grow.

    Owns the position after the last complete record, and the schemas and channels so far.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._position = len(MCAP0_MAGIC)
        self._ended = False  # whether the data are complete
        self._number = 0  # of the last message, which increases by 1 in our files
        self._numbered = False
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def news(self) -> Found:
        """Return the messages since the last call; skip messages with a wrong checksum and an incomplete end.

        Raises:
            ValueError: the file is not an MCAP file.
            OSError: the file cannot be read.
        """
        found, before = Found([], []), self._number
        with self._path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            magic = file.read(len(MCAP0_MAGIC))
            require(magic == MCAP0_MAGIC, f"{self._path}", "an MCAP file", f"one that begins with {magic!r}")
            file.seek(self._position)
            records = StreamReader(file, skip_magic=True, emit_chunks=True, record_size_limit=size).records
            with suppress(Exception):  # an incomplete or damaged record raises almost anything
                for record in records:
                    begin, self._position = self._position, file.tell()
                    try:
                        found.messages.extend(self._messages(record))
                    except Exception as error:
                        what = " ".join(f"{type(error).__name__}: {error}".split())
                        found.faults.append(f"{self._position - begin} bytes at {begin} skipped: damaged ({what})")
        missing = self._number - before - len(found.messages)
        if self._numbered and missing > 0:
            found.faults.append(f"{missing} messages are missing")
        if not self._ended and size > self._position:
            rest = f"{size - self._position} bytes at the end skipped"
            found.faults.append(f"incomplete after {len(found.messages)} messages: {rest}")
        return found

    def _messages(self, record: McapRecord) -> list[Stored]:
        """Return the messages in a record; most records contain none. A damaged record raises almost anything."""
        if isinstance(record, Header):
            self._numbered = record.library.startswith(LIBRARY)
        self._ended = self._ended or isinstance(record, DataEnd)
        if isinstance(record, Chunk):
            parts = breakup_chunk(record, validate_crc=True)
        else:
            parts = [] if self._ended else [record]  # the index at the end repeats definitions, without a checksum
        found = []
        for part in parts:
            if isinstance(part, Schema):
                self._schemas[part.id] = part
            elif isinstance(part, Channel):
                self._channels[part.id] = part
            elif isinstance(part, Message):
                channel = self._channels[part.channel_id]
                schema = self._schemas[channel.schema_id]
                self._number = part.sequence
                kind, times = (schema.name, schema.data.decode()), (part.log_time, part.publish_time)
                found.append(Stored(channel.topic, *kind, part.data, *times))
        return found
