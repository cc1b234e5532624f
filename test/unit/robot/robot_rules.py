"""Reward and end functions that tests name in settings."""

import numpy as np


def encoded(before: np.ndarray, action: np.ndarray, after: np.ndarray) -> float:
    """Return a reward that encodes all its arguments in its digits."""
    return float(1e4 * before[0] + 1e2 * action[0] + after[0])


def high(before: np.ndarray, action: np.ndarray, after: np.ndarray) -> bool:
    return bool(after[0] > 50)


def breaks(before: np.ndarray, action: np.ndarray, after: np.ndarray) -> bool:
    if after[0] > 2:
        raise ZeroDivisionError("by nothing")
    return False
