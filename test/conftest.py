"""Register the project's tasks, and make all tests independent of how they were started."""

import os
import signal
from collections.abc import Iterator

import pytest

import sim_nodes.envs  # noqa: F401
from rkhs_ros.base.processes import one_thread

# Background jobs of a shell ignore SIGINT, and those of nohup ignore SIGHUP. Child processes inherit this, and tests
# end child processes by signals. Python itself ignores SIGPIPE and SIGXFSZ, and subprocess restores both.
for number in signal.valid_signals() - {signal.SIGINT, signal.SIGPIPE, signal.SIGXFSZ}:
    if signal.getsignal(number) == signal.SIG_IGN:
        signal.signal(number, signal.SIG_DFL)
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.pthread_sigmask(signal.SIG_SETMASK, ())
for name in ("COLUMNS", "LINES", "FORCE_COLOR", "NO_COLOR"):  # change the texts that commands print
    os.environ.pop(name, None)


@pytest.fixture(autouse=True, scope="session")
def linear_algebra_on_one_thread() -> Iterator[None]:
    """Let tests compare the last bits with those of other processes."""
    with one_thread():
        yield
