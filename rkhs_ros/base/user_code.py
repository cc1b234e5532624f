"""Modules and functions that are named: by users, or by data files of others, whose names are not trusted.

A module is installed if Python finds it without the folder that we are in and the relative folders of PYTHONPATH: in
site-packages, in a built workspace, in a package installed in development mode, or in an absolute folder of PYTHONPATH.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, nullcontext
from importlib import import_module
from importlib.util import find_spec
from types import FrameType, ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import hint, require, truncated

TRUSTED = "RKHS_TRUSTED_MODULES"  # of this process and those that it starts: names with ":" between; all if unset


class HangError(BaseException):
    """A user's function does not return; no error, so that its own ``except Exception`` lets it pass."""


@contextmanager
def isolated_from_user_code() -> Iterator[None]:
    """Put back, after somebody's code, the folder that we are in, and of what numpy raises errors."""
    with chdir("."), np.errstate():
        yield


@contextmanager
def only_installed(*trusted: str) -> Iterator[None]:
    """Import meanwhile none but modules that are installed, in this process and in those that it starts.

    Args:
        *trusted: names of modules that a person named, which may be elsewhere.
    """
    before = os.environ.get(TRUSTED)
    os.environ[TRUSTED] = ":".join(trusted)
    try:
        yield
    finally:
        if before is None:
            del os.environ[TRUSTED]
        else:
            os.environ[TRUSTED] = before


def is_trusted(module: str) -> bool:
    """Return whether a module may be imported from wherever it is."""
    trusted = os.environ.get(TRUSTED)
    return trusted is None or module in trusted.split(":")


def is_installed(module: str) -> bool:
    """Return whether a module, or the package that it is in, is installed; it is not imported."""
    with _installed_only():
        try:
            return find_spec(module.partition(".")[0]) is not None
        except ValueError:  # of a module without a specification, as __main__
            return False


def user_module(module: str) -> ModuleType:
    """Import a module that is installed, or, if it is trusted, in the folder that the process was started in.

    Raises:
        ValueError: it cannot be imported.
    """
    trusted = is_trusted(module)
    if trusted and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    expected = f"expected a module '{truncated(module)}' to import, installed"
    if not trusted and module.partition(".")[0] not in sys.modules and not is_installed(module):
        raise ValueError(f"{expected}, got none; a data file names it: from elsewhere it is imported with --trust")
    try:
        with isolated_from_user_code(), nullcontext() if trusted else _installed_only():
            return import_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # the module is somebody's code
        where = " or in this folder" * trusted
        raise ValueError(f"{expected}{where}, got {type(error).__name__}: {truncated(error)}") from error


@contextmanager
def _installed_only() -> Iterator[None]:
    """Leave out of Python's path the folder that we are in, and the relative ones of PYTHONPATH."""
    before = list(sys.path)
    given = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    relative = {os.path.realpath(path) for path in (os.curdir, *given) if not os.path.isabs(path)}
    sys.path[:] = [path for path in before if os.path.isabs(path) and os.path.realpath(path) not in relative]
    try:
        yield
    finally:
        sys.path[:] = before


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
        raise ValueError(f"{what}: no function '{truncated(function)}' in {module}, {hint(function, callables)}")
    return getattr(found, function)  # type: ignore[no-any-return]


def call_user_function(function: Callable[..., Any], *arrays: NDArray[np.float64], seconds: float = 0.0) -> Any:
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
        raise RunError(f"{type(error).__name__}: {truncated(error)}") from error


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
