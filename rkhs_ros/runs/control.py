"""What those who look at a run may ask of it: to pause, to go on, to stop."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from rkhs_ros.base.files import open_regular, write_whole
from rkhs_ros.base.validation import pick

PAUSE, RESUME, STOP = WORDS = ("pause", "resume", "stop")
ASKED, TAKEN = "control", "control.taken"  # names of files: a word for the run, and the one that it looks at
PAUSING = "pausing"  # of a file that is there while the run pauses
POLL_INTERVAL_S = 0.1  # of a run that pauses
MOST_BYTES = 64  # of a word
Rest = Callable[[float], object]


def ask(folder: Path, word: str) -> None:
    """Ask something of the run in a folder, which it does after its iteration; the last word counts.

    Raises:
        ValueError: there is no such word.
        OSError: the folder cannot be written.
    """
    pick(word, dict.fromkeys(WORDS), "word")
    write_whole(folder / ASKED, word.encode(), sync=False)


def is_pausing(folder: Path) -> bool:
    """Return whether the run in a folder, if it is under way, waits to be resumed."""
    return (folder / PAUSING).exists()


class Control:
    """Does between two iterations what was asked of a run.

    Owns the files of the words, which no earlier run leaves behind. Whatever else somebody puts there is ignored.

    Args:
        folder: of the run.
        rest: waits for some seconds.
    """

    def __init__(self, folder: Path, rest: Rest = time.sleep) -> None:
        self._folder = folder
        self._rest = rest
        self.clear()

    def obey(self) -> None:
        """Do what was asked; wait here while the run pauses.

        Raises:
            KeyboardInterrupt: it was asked to stop.
        """
        word = self._take()
        if word == PAUSE:
            word = self._pause()
        if word == STOP:
            raise KeyboardInterrupt

    def clear(self) -> None:
        """Forget what was asked."""
        for name in (ASKED, TAKEN, PAUSING):
            with suppress(OSError):
                (self._folder / name).unlink(missing_ok=True)

    def _pause(self) -> str:
        """Wait for another word than to pause, and return it."""
        word: str | None = PAUSE
        with suppress(OSError):  # of a full disk: nobody sees that the run pauses, but it does
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
        """Return a word that was asked since; None for none, or for what is no word."""
        taken = self._folder / TAKEN
        try:
            (self._folder / ASKED).replace(taken)  # first, for while it is read another may be asked
            with open_regular(taken) as file:
                word = file.read(MOST_BYTES).decode(errors="replace")
            taken.unlink()
        except (OSError, ValueError):
            return None
        return word if word in WORDS else None
