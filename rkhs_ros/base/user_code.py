"""Modules and functions that users name: imported from what is installed, or from the folder that we are in."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import hint, require, shown


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


def user_answer(function: Callable[..., Any], *arrays: NDArray[np.float64]) -> Any:
    """Return what a user's function makes of arrays, of which it is given copies.

    Raises:
        RunError: it raises anything but an interrupt, as by ``sys.exit``; the message says what.
    """
    try:
        with np.errstate():  # that it sets what numpy raises shall not matter to us
            return function(*(array.copy() for array in arrays))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # it is somebody's code
        raise RunError(f"{type(error).__name__}: {shown(error)}") from error
