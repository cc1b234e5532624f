"""Read the results of a run, for comparison."""

from pathlib import Path

import numpy as np


def curve(folder: Path) -> list[str]:
    file = folder / "curve.csv"
    return [line.rpartition(",")[0] for line in file.read_text().splitlines()] if file.exists() else []


def arrays(folder: Path) -> dict[str, np.ndarray]:
    with np.load(folder / "policy.npz") as file:
        return dict(file)


def assert_same_bits(folder: Path, undisturbed: Path) -> None:
    """Assert that curve and policy of two runs are bit-identical."""
    assert curve(folder) == curve(undisturbed)
    ours, theirs = arrays(folder), arrays(undisturbed)
    assert list(ours) == list(theirs)
    assert all(np.array_equal(ours[name], theirs[name]) for name in theirs)
