"""Modules and functions that users name: imported from what is installed, or from the folder that we are in."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager
from importlib import import_module
from types import FrameType, ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import hint, require, shown


class HangError(BaseException):
    """A user's function does not return; no error, so that its own ``except Exception`` lets it pass."""


@contextmanager
def surroundings_kept() -> Iterator[None]:
    """Put back, after somebody's code, the folder that we are in, and of what numpy raises errors."""
    with chdir("."), np.errstate():
        yield


def user_module(module: str) -> ModuleType:
    """Import a module that is installed, or in the folder that the process was started in.

    Raises:
        ValueError: it cannot be imported.
    """
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        with surroundings_kept():
            return import_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # the module is somebody's code
        expected = f"expected a module '{shown(module)}' to import, installed or in this folder"
        raise ValueError(f"{expected}, got {type(error).__name__}: {shown(error)}") from error


def user_function(name: str, what: str) -> Callable[..., Any]:
    """Return the function that ``package.module:function`` names.

    Args:
        name: as above.
        what: it is for, for messages.

    Raises:
        ValueError: there is no such function.
    """
    module, _, function = name.partition(":")
    require(bool(module and function), what, "MODULE:FUNCTION", name)
    try:
        found = user_module(module)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error
    if not callable(getattr(found, function, None)):
        callables = {each: None for each, value in vars(found).items() if callable(value)}
        raise ValueError(f"{what}: no function '{shown(function)}' in {module}, {hint(function, callables)}")
    return getattr(found, function)  # type: ignore[no-any-return]


def user_answer(function: Callable[..., Any], *arrays: NDArray[np.float64], seconds: float = 0.0) -> Any:
    """Return what a user's function makes of arrays, of which it is given copies.

    Args:
        function: the user's.
        arrays: its arguments.
        seconds: after which it is taken to hang; 0 to wait for it however long. Heeded in the main thread only.

    Raises:
        RunError: it hangs, or raises anything but an interrupt, as by ``sys.exit``; the message says what.
    """
    try:
        with np.errstate(), _no_longer_than(seconds):  # that it sets what numpy raises shall not matter to us
            return function(*(array.copy() for array in arrays))
    except BaseException as error:  # it is somebody's code
        if isinstance(error, KeyboardInterrupt) and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            raise  # elsewhere no Ctrl-C raises it
        if isinstance(error, HangError):
            raise RunError(f"did not return within {seconds:g} s") from error
        raise RunError(f"{type(error).__name__}: {shown(error)}") from error


@contextmanager
def _no_longer_than(seconds: float) -> Iterator[None]:
    """Raise HangError within after so many seconds; 0 for never. An alarm set before goes on afterwards."""
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
