"""Control of a run by its viewers: pause, resume and stop."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from rkhs_ros.base.files import open_regular, write_whole
from rkhs_ros.base.validation import pick

PAUSE, RESUME, STOP = WORDS = ("pause", "resume", "stop")
ASKED, TAKEN = "control", "control.taken"  # files with a new command, and with the command that the run reads
PAUSING = "pausing"  # file that exists while the run pauses
POLL_INTERVAL_S = 0.1  # during a pause
MOST_BYTES = 64  # of a command
Rest = Callable[[float], object]


def ask(folder: Path, word: str) -> None:
    """Send a command to the run in a folder, which executes the last command after its current iteration.

    Raises:
        ValueError: the command is unknown.
        OSError: the folder cannot be written.
    """
    pick(word, dict.fromkeys(WORDS), "command")
    write_whole(folder / ASKED, word.encode(), sync=False)


def is_pausing(folder: Path) -> bool:
    """Return whether the run in a folder, if it is active, pauses."""
    return (folder / PAUSING).exists()


class Control:
    """Executes commands of viewers between two iterations of a run.

    Owns the command files, and deletes those of an earlier run. Unknown content of these files is ignored.

    Args:
        folder: folder of the run.
        rest: function that waits for a number of seconds.
    """

    def __init__(self, folder: Path, rest: Rest = time.sleep) -> None:
        self._folder = folder
        self._rest = rest
        self.clear()

    def obey(self) -> None:
        """Execute the last command; return after the end of a pause.

        Raises:
            KeyboardInterrupt: the command is to stop.
        """
        word = self._take()
        if word == PAUSE:
            word = self._pause()
        if word == STOP:
            raise KeyboardInterrupt

    def clear(self) -> None:
        """Discard all commands."""
        for name in (ASKED, TAKEN, PAUSING):
            with suppress(OSError):
                (self._folder / name).unlink(missing_ok=True)

    def _pause(self) -> str:
        """Wait for a command other than pause, and return it."""
        word: str | None = PAUSE
        with suppress(OSError):  # on a full disk, the run pauses without showing it
            (self._folder / PAUSING).touch()
        try:
            while word in (None, PAUSE):
                self._rest(POLL_INTERVAL_S)
                word = self._take()
            return str(word)
        finally:
            with suppress(OSError):
                (self._folder / PAUSING).unlink(missing_ok=True)

    def _take(self) -> str | None:
        """Return a new command; None if there is none or it is unknown."""
        taken = self._folder / TAKEN
        try:
            (self._folder / ASKED).replace(taken)  # first, since a new command may arrive while this one is read
            with open_regular(taken) as file:
                word = file.read(MOST_BYTES).decode(errors="replace")
            taken.unlink()
        except (OSError, ValueError):
            return None
        return word if word in WORDS else None
