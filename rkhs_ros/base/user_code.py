"""Import and call user code by name."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager
from importlib import import_module
from types import FrameType, ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.endings import ENDING, RunError, StoppedError
from rkhs_ros.base.processes import searches_here
from rkhs_ros.base.validation import hint, prefixed, require, truncated

ADD_TO_PATH = "add the folder to PYTHONPATH"  # to import a module from it


class HangError(BaseException):
    """Raised inside a user's function that does not return; not an Exception, so that the function cannot catch it."""


@contextmanager
def isolated_from_user_code() -> Iterator[None]:
    """Restore the working directory and np.errstate after user code."""
    with chdir("."), np.errstate():
        yield


def user_module(module: str, remedy: str) -> ModuleType:
    """Import a module.

    The remedy says how to import a module from the current folder.
    """
    try:
        with isolated_from_user_code():
            return import_module(module)
    except BaseException as error:  # user code may raise anything
        if is_interrupt(error):
            raise
        hidden = isinstance(error, ModuleNotFoundError) and not searches_here()
        got = f"{type(error).__name__}: {truncated(error)}" + f". If it is in this folder, {remedy}" * hidden
        raise ValueError(f"expected an importable module '{truncated(module)}', got {got}") from error


def user_function(name: str, what: str) -> Callable[..., Any]:
    """Return the function with the name ``package.module:function``.

    ``what`` is the setting that names it, for messages.
    """
    module, _, function = name.partition(":")
    require(bool(module and function), what, "MODULE:FUNCTION", name)
    with prefixed(what):
        found = user_module(module, ADD_TO_PATH)
    if not callable(getattr(found, function, None)):
        callables = {each: None for each, value in vars(found).items() if callable(value)}
        raise ValueError(f"{what}: no function '{truncated(function)}' in {module}, {hint(function, callables)}")
    return getattr(found, function)  # type: ignore[no-any-return]


def call_user_function(function: Callable[..., Any], *arrays: NDArray[np.float64], seconds: float = 0.0) -> Any:
    """Call a user's function with copies of arrays.

    The time limit in seconds, 0 for none, applies in the main thread only.

    Raises:
        RunError: the function exceeds the time limit or raises anything but an interrupt, including ``SystemExit``.
    """
    try:
        with np.errstate(), _no_longer_than(seconds):  # isolates the function from our np.errstate
            return function(*(array.copy() for array in arrays))
    except BaseException as error:  # user code may raise anything
        if is_interrupt(error):
            raise
        if isinstance(error, HangError):
            raise RunError(f"did not return within {seconds:g} s") from error
        raise RunError(f"{type(error).__name__}: {truncated(error)}") from error


def is_interrupt(error: BaseException) -> bool:
    """Return whether a signal, not user code, raised an error: with other handlers, none raises KeyboardInterrupt.

    A shell ignores Ctrl-C for its background processes, which SIGTERM still interrupts.
    """
    raises = signal.default_int_handler in map(signal.getsignal, ENDING)
    return (isinstance(error, KeyboardInterrupt) and raises) or isinstance(error, StoppedError)


@contextmanager
def _no_longer_than(seconds: float) -> Iterator[None]:
    """Raise HangError in this block after so many seconds, 0 for never; restore an earlier alarm afterwards."""
    if not seconds or threading.current_thread() is not threading.main_thread():
        yield
        return

    def hangs(number: int, frame: FrameType | None) -> None:
        raise HangError

    handler, begin = signal.signal(signal.SIGALRM, hangs), time.monotonic()
    left, interval = signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, handler)
        if left:
            signal.setitimer(signal.ITIMER_REAL, max(left - (time.monotonic() - begin), 1e-6), interval)
