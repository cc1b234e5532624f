"""Reader of a growing recording: positions of the messages, and each message on demand."""

from collections.abc import Iterator
from io import SEEK_SET
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import McapRecord
from mcap.writer import MCAP0_MAGIC

from rkhs_ros.recordings.container import Scan, Stored, records
from rkhs_ros.recordings.definitions import PACKAGE, decoded


class Place(NamedTuple):
    """Position of a message.

    Attributes:
        offset: offset of its record in the file, in bytes.
        kind: name of its type within our package.
        time: time of the recording in nanoseconds since 1970.
    """

    offset: int
    kind: str
    time: int


class Following:
    """Reader of a recording that may grow; holds at most one message in memory.

    Owns the position in the file. Skips damaged records.

    Args:
        path: an MCAP file, which may not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._begin(0)

    def news(self) -> tuple[bool, list[tuple[Place, Any]]]:
        """Return whether the file was replaced, and our messages since the last call."""
        try:
            about = self.path.stat()
        except OSError:
            return False, []
        is_other = about.st_ino != self._inode or about.st_size < self._offset
        if is_other:
            self._begin(about.st_ino)
        return is_other, list(self._read(about.st_size))

    def message(self, place: Place) -> Any:
        """Return the message at a place.

        Raises:
            ValueError: the message no longer exists.
        """
        with self.path.open("rb") as file:
            file.seek(place.offset, SEEK_SET)
            for _, record in records(file, self.path.stat().st_size):
                for stored, message in self._scanned(record):
                    if stored.kind == PACKAGE + place.kind and stored.time == place.time:
                        return message
                break
        raise ValueError(f"{self.path}: expected a message of type {place.kind} at {place.offset}, got another")

    def _begin(self, inode: int) -> None:
        self._inode = inode
        self._offset = len(MCAP0_MAGIC)
        self._scan = Scan()

    def _read(self, size: int) -> Iterator[tuple[Place, Any]]:
        with self.path.open("rb") as file:
            file.seek(self._offset)
            for begin, record in records(file, size):
                for stored, message in self._scanned(record):
                    yield Place(begin, stored.kind.removeprefix(PACKAGE), stored.time), message
                self._offset = file.tell()

    def _scanned(self, record: McapRecord) -> list[tuple[Stored, Any]]:
        """Return pairs of a stored and a deserialised message, for our messages in a record; none if it is damaged."""
        try:
            ours = [each for each in self._scan.messages(record) if each.kind.startswith(PACKAGE)]
            return [(each, decoded(each.content, each.kind, each.definition)) for each in ours]
        except Exception:  # a damaged record raises almost anything
            return []
