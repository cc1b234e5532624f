"""Tests of the benchmarks, which are not part of the product, run before a release."""

from importlib.util import find_spec
from pathlib import Path

import pytest

# The package cmaes, a rival of ours, has no rosdep key.
collect_ignore_glob = [] if find_spec("cmaes") else ["*"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.nightly)
