"""Reading both clocks at once, even on a busy machine."""

import numpy as np
import pytest

from rkhs_ros.nodes.core import messages

EPOCH_S = 1_700_000_000.0


class BusyMachine:
    """Clocks of a machine that holds the process up before some of the readings."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.now = 0.0
        self._rng = rng

    def monotonic(self) -> float:
        self.now += 1e-6 + (self._rng.random() < 0.2) * self._rng.uniform(0.0, 0.1)
        return self.now

    def time_ns(self) -> int:
        return round(1e9 * (EPOCH_S + self.monotonic()))


def test_times_by_both_clocks_agree_despite_preemption(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    monkeypatch.setattr(messages, "time", BusyMachine(rng))
    for _ in range(1000):
        seconds, nanoseconds = messages.now_by_both_clocks()
        assert nanoseconds / 1e9 - EPOCH_S == pytest.approx(seconds, abs=1e-3)
