"""Import and call user code by name: names from users are trusted, names from data files are not.

A module counts as installed if Python finds it without the working directory and the relative folders of PYTHONPATH: in
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
from types import FrameType, ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import hint, require, truncated

TRUSTED = "RKHS_TRUSTED_MODULES"  # for this process and its children: names separated by ":"; all modules if unset


class HangError(BaseException):
    """Raised inside a user's function that does not return; not an Exception, so that the function cannot catch it."""


@contextmanager
def isolated_from_user_code() -> Iterator[None]:
    """Restore the working directory and np.errstate after user code."""
    with chdir("."), np.errstate():
        yield


@contextmanager
def only_installed(*trusted: str) -> Iterator[None]:
    """Restrict imports to installed modules in this process and its children.

    Args:
        *trusted: names of modules that the user gave, which need not be installed.
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
    """Return whether a module may be imported without being installed."""
    trusted = os.environ.get(TRUSTED)
    return trusted is None or module in trusted.split(":")


def is_installed(module: str) -> bool:
    """Return whether a module's top-level package is installed, without importing it."""
    name = module.partition(".")[0]
    with _installed_only():  # not importlib's find_spec, which finds every module that has been imported already
        return name.isidentifier() and any(finder.find_spec(name, None) is not None for finder in sys.meta_path)


def user_module(module: str) -> ModuleType:
    """Import an installed module or, if it is trusted, one in the working directory.

    Raises:
        ValueError: the module cannot be imported.
    """
    trusted = is_trusted(module)
    if trusted and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    expected = f"expected an importable module '{truncated(module)}', installed"
    if not trusted and module.partition(".")[0] not in sys.modules and not is_installed(module):
        raise ValueError(f"{expected}, got none. A data file names it; to import it from this folder, add --trust")
    try:
        with isolated_from_user_code(), nullcontext() if trusted else _installed_only():
            return import_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # user code may raise anything
        where = " or in this folder" * trusted
        raise ValueError(f"{expected}{where}, got {type(error).__name__}: {truncated(error)}") from error


@contextmanager
def _installed_only() -> Iterator[None]:
    """Remove the working directory and the relative folders of PYTHONPATH from Python's path."""
    before = list(sys.path)
    given = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    relative = {os.path.realpath(path) for path in (os.curdir, *given) if not os.path.isabs(path)}
    sys.path[:] = [path for path in before if os.path.isabs(path) and os.path.realpath(path) not in relative]
    try:
        yield
    finally:
        sys.path[:] = before


def user_function(name: str, what: str) -> Callable[..., Any]:
    """Return the function with the name ``package.module:function``.

    Args:
        name: name in the form above.
        what: the setting that names it, for messages.

    Raises:
        ValueError: the function does not exist.
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
    """Call a user's function with copies of arrays.

    Args:
        function: the user's function.
        arrays: its arguments.
        seconds: time limit; 0 for none. The limit applies in the main thread only.

    Raises:
        RunError: the function exceeds the time limit or raises anything but an interrupt, including ``SystemExit``.
    """
    try:
        with np.errstate(), _no_longer_than(seconds):  # isolates the function from our np.errstate
            return function(*(array.copy() for array in arrays))
    except BaseException as error:  # user code may raise anything
        if isinstance(error, KeyboardInterrupt) and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            raise  # with another handler, Ctrl-C does not raise it: the function did
        if isinstance(error, HangError):
            raise RunError(f"did not return within {seconds:g} s") from error
        raise RunError(f"{type(error).__name__}: {truncated(error)}") from error


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
