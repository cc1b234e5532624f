"""Execution logs of episodes on a robot."""

from dataclasses import replace

import numpy as np
import pytest

from rkhs_ros.learning.execution import Execution

TWO_STEPS = Execution(np.arange(3), np.zeros((2, 1)), np.zeros(2, dtype=np.uint32))


@pytest.mark.parametrize("count", [2, 4])
def test_there_is_one_more_stamp_than_steps(count: int) -> None:
    message = f"execution's stamps: expected 3, one more than steps, got {count}"
    with pytest.raises(ValueError, match=message):
        replace(TWO_STEPS, stamps=np.arange(count))


@pytest.mark.parametrize("count", [1])
def test_there_is_one_executed_command_per_step(count: int) -> None:
    with pytest.raises(ValueError, match=f"executed commands: expected 2, one per step, got {count}"):
        replace(TWO_STEPS, executed=np.zeros((count, 1)))
