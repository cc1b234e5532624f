"""Whatever ends a gate, the robot is at rest afterwards, although it keeps the newest command for ever."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from std_msgs.msg import String

from test.ros.conftest import PATIENCE, Process
from test.ros.gate_bench import written
from test.ros.hardware import AT_REST, IN_MOTION, TURNING, Hardware, tree_of

AT_REST_SPEED = 0.02
SIGNALS = {name: getattr(signal, name) for name in ("SIGTERM", "SIGHUP")}
# Ending, moment and kind of commands are independent of each other: the tests of the pure gate combine them.
TRIALS = (
    ("SIGTERM", TURNING, "effort"),
    ("SIGHUP", AT_REST, "position"),
    ("exception", IN_MOTION, "effort"),
    ("second gate", IN_MOTION, "position"),
)


class Trial:
    """A gate, its robot, and the ways in which it may end."""

    def __init__(self, start: Callable[..., Process], domain: int, folder: Path, kind: str) -> None:
        self._start, self._file = start, written(folder, tree_of(kind))
        self.hardware = Hardware(domain, kind)
        self.gate = self.begin("failing_gate")
        self.ended_at = 0.0
        self._faults = self.hardware.node.create_publisher(String, "fail", 1)

    def begin(self, name: str, *more: str) -> Process:
        return self._start(name, "--ros-args", "--params-file", self._file, *more)

    def end(self, how: str, moment: str) -> None:
        """Have the gate end at a moment, and wait for it; one that goes on is told to end after some time."""
        self.hardware.arm()
        self.until(lambda: self._faults.get_subscription_count() > 0)
        done: list[float] = []
        self.hardware.at(moment, lambda: (self._cause(how), done.append(time.monotonic())))
        self.until(lambda: bool(done))
        if how == "second gate":
            self._go_on()
        self.until(lambda: self.gate.popen.poll() is not None)
        self.ended_at = time.monotonic()

    def fail(self, fault: str) -> None:
        self._faults.publish(String(data=fault))

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, "nothing came in time"
            time.sleep(0.005)

    def close(self) -> None:
        self.hardware.close()

    def _cause(self, how: str) -> None:
        if how in SIGNALS:
            os.kill(self.gate.popen.pid, SIGNALS[how])
        elif how == "exception":
            self.fail("callback")
        else:
            self.second = self.begin("gate")

    def _go_on(self) -> None:
        """See that a second gate exits and leaves this one alone, and end this one."""
        code, _, err = self.second.finish()
        assert code == 1
        assert "error: expected one gate node, got another one that is already running" in err
        assert self.hardware.state in ("holding", "moving")
        assert self.gate.popen.poll() is None
        self.gate.popen.terminate()


@pytest.fixture
def trial(start: Callable[..., Process], domain: int, tmp_path: Path) -> Iterator[Callable[[str], Trial]]:
    trials: list[Trial] = []

    def begin(kind: str) -> Trial:
        trials.append(Trial(start, domain, tmp_path, kind))
        return trials[-1]

    yield begin
    for each in trials:
        each.close()


def assert_left_at_rest(hardware: Hardware, ended_at: float) -> None:
    """No motion a second after the end, and none that grew faster since."""
    deadline = time.monotonic() + PATIENCE
    while hardware.track[-1][0] < ended_at + 1.1:  # its thread may be late on a busy machine
        assert time.monotonic() < deadline, "the robot no longer moves on in time"
        time.sleep(0.005)
    speeds, later = hardware.speed_after(ended_at), hardware.speed_after(ended_at + 1.0)
    print(f"{hardware.kind}: {speeds[0]:.4f} at the end, then at most {max(speeds):.4f}, 1 s after {max(later):.4f}")
    assert max(speeds) <= speeds[0] + 0.01, f"{speeds[0]:.3f} rose to {max(speeds):.3f}"
    assert max(later) <= AT_REST_SPEED
    assert hardware.kind == "position" or hardware.command == 0.0


@pytest.mark.parametrize(("how", "moment", "kind"), TRIALS)
def test_a_gate_that_exits_leaves_the_hardware_at_rest(
    trial: Callable[[str], Trial], how: str, moment: str, kind: str
) -> None:
    here = trial(kind)
    here.end(how, moment)
    assert_left_at_rest(here.hardware, here.ended_at)


@pytest.mark.parametrize("fault", ["check", "executor", pytest.param("exits", marks=pytest.mark.nightly)])
def test_the_gate_brakes_despite_repeated_failures(trial: Callable[[str], Trial], fault: str) -> None:
    here = trial("velocity")
    here.hardware.arm()
    here.hardware.at(IN_MOTION, lambda: here.fail(fault))
    here.until(lambda: here.gate.popen.poll() is not None)
    assert_left_at_rest(here.hardware, time.monotonic())
    assert here.gate.finish()[0] != 0


def test_the_gate_ignores_user_signals_and_exits_on_keyboard_signals(trial: Callable[[str], Trial]) -> None:
    here = trial("velocity")
    here.hardware.arm()
    here.hardware.at(IN_MOTION, lambda: None)
    here.until(lambda: here.hardware.state == "moving")
    for number in (signal.SIGUSR1, signal.SIGUSR2, signal.SIGTSTP):
        here.gate.popen.send_signal(number)
        time.sleep(0.3)
        assert here.gate.popen.poll() is None
    assert here.hardware.state == "moving"
    here.gate.popen.send_signal(signal.SIGQUIT)
    assert here.gate.finish()[0] == 0
    assert_left_at_rest(here.hardware, time.monotonic())
