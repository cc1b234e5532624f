"""Processes: their modules, end, output and linear algebra."""

import ctypes
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from runpy import run_module
from threading import Lock, Thread
from typing import Any, TextIO

PR_SET_PDEATHSIG = 1  # of prctl(2)
COPYING_S = 1.0  # for the last output to reach the terminal
_libc = ctypes.CDLL(None)


def terminate_with_parent(parent: int) -> None:
    """Make the kernel terminate this process when its parent dies, however it dies."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # the parent is already dead
        os.kill(os.getpid(), signal.SIGTERM)


def search_here() -> None:
    """Search for modules in the working directory, after all other places."""
    if not searches_here():
        sys.path.append(os.getcwd())


def searches_here() -> bool:
    """Return whether this process searches for modules in the working directory."""
    return os.getcwd() in sys.path


def python(module: str) -> list[str]:
    """Return the command that runs a module in another process, which searches for modules where this one does."""
    return [sys.executable, "-P", "-m", *([__name__] if searches_here() else []), module]


@contextmanager
def lossy_output() -> Iterator[None]:
    """Let threads write the output of this process, so that a terminal that nobody reads never blocks the process.

    Output that such a terminal does not take is lost.
    """
    if os.isatty(2):
        os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")  # ROS's log is no longer connected to the terminal
    with ExitStack() as stack:
        for stream in filter(None, (sys.stdout, sys.stderr)):  # None is one that was closed before the start
            stack.enter_context(_copied(stream))
        yield


@contextmanager
def _copied(stream: TextIO) -> Iterator[None]:
    number, (source, pipe) = stream.fileno(), os.pipe()
    sink = os.dup(number)
    os.set_blocking(pipe, False)
    os.dup2(pipe, number)
    os.close(pipe)
    copying = Thread(target=_copy, args=(source, sink), daemon=True)
    copying.start()
    try:
        yield
    finally:
        with suppress(BlockingIOError):
            stream.flush()
        os.dup2(sink, number)  # closes the pipe, so that the thread ends
        copying.join(COPYING_S)


def _copy(source: int, sink: int) -> None:
    with suppress(OSError):  # a closed terminal
        while content := os.read(source, 4096):
            while content:
                content = content[os.write(sink, content) :]


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit linear algebra to one thread within the context, overriding the environment.

    At the sizes used here more threads are slower, and they change the order of sums and thus the last bits. The limit
    is one of the process: the first of simultaneous contexts sets it, and the last one removes it.
    """
    with _LIMIT:
        yield


class _Limit:
    """The limit of the linear algebra in this process. Owns the number of contexts that need it."""

    def __init__(self) -> None:
        self._lock, self._users, self._undo = Lock(), 0, ExitStack()

    def __enter__(self) -> None:
        with self._lock:
            if not self._users:
                self._undo.enter_context(_linear_algebra().limit(limits=1))
            self._users += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._users -= 1
            if not self._users:
                self._undo.close()


_LIMIT = _Limit()


@cache
def _linear_algebra() -> Any:
    """Return the loaded linear-algebra libraries; cached, because the search covers the whole process."""
    import scipy.linalg  # numpy and scipy load all the linear algebra in use  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


if __name__ == "__main__":
    search_here()
    run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
