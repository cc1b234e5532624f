"""The life of a node's process: start, spin and exit."""

from __future__ import annotations

import errno
import gc
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from hashlib import blake2b
from typing import TYPE_CHECKING, TypeVar

import rclpy
from rclpy._rclpy_pybind11 import RCLError  # type: ignore[import-not-found]  # rclpy does not export it
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from rkhs_ros.base.endings import INTERRUPTED, RESUMABLE, RunError, SilentError, Stop, StoppedError, print_error
from rkhs_ros.base.processes import one_thread, search_here
from rkhs_ros.base.validation import truncated
from rkhs_ros.nodes.core.parameters import check_arguments
from rkhs_ros.nodes.core.transport import by_udp

if TYPE_CHECKING:
    from rkhs_ros.nodes.core.diagnostics import Diagnostics

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
IGNORED = (signal.SIGUSR1, signal.SIGUSR2, signal.SIGTSTP)  # SIGTSTP would suspend a node that others wait for
SIGNAL_CHECK_S = 0.1  # between checks for a signal
MOST_ENDING_S = 10  # for a node to exit; the middleware sometimes waits for ever, and nothing else would end it
RETRY_S = 0.001  # before retrying a failed callback while a node brings its robot to rest


class PeerError(RunError):
    """A node does not fit this run, or runs twice; the message names it."""


class ReportingNode(Node):
    """A node that reports its status, and has periodic work between messages."""

    diagnostics: Diagnostics

    def __init__(self, name: str, *, context: Context | None = None, namespace: str | None = None) -> None:
        super().__init__(
            name, context=context, namespace=namespace, automatically_declare_parameters_from_overrides=True
        )
        self.resources = ExitStack()  # closed with the node
        self._claim = self.resources.enter_context(socket.socket(socket.AF_UNIX))

    def claim_name(self) -> None:
        """Refuse to run if another process of this machine runs a node of this name in this domain.

        The graph shows another node only after some time. A socket in the abstract namespace of Linux, of which there
        is one per name, is taken at once; the kernel frees it when the process ends in whatever way.
        """
        name = f"{self.context.get_domain_id()}{self.get_fully_qualified_name()}"
        try:
            self._claim.bind(f"\0rkhs_ros/{blake2b(name.encode(), digest_size=16).hexdigest()}")  # names are limited
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                return  # another system than Linux
            expected = f"expected one {self.get_name()} node, got another one that is already running"
            raise PeerError(f"{expected}; set ROS_DOMAIN_ID to separate runs") from error

    def destroy_node(self) -> None:
        """Release the name and other resources, and destroy the node."""
        self.resources.close()
        super().destroy_node()

    def open(self) -> None:
        """Declare the parameters and open topics and services; raise ValueError for unknown or invalid ones."""
        raise NotImplementedError

    def heartbeat(self) -> float:
        """Do the periodic work that is due, such as the status report; return the seconds until more may be due."""
        return self.diagnostics.heartbeat()

    def may_end(self) -> bool:
        """Prepare for the exit of the process; return whether the node is ready to exit."""
        return True


AnyNode = TypeVar("AnyNode", bound=ReportingNode)


def serve(node: ReportingNode, stop: Stop) -> None:
    """Handle the messages of a node until `stop` is set or an error ends it.

    In any case, the node first brings its robot to rest. Periodic work is done between messages rather than by timers
    of the executor: on a busy machine, 1 % of a gate's ticks were more than 3.5 ms late, with timers 16 ms.
    """
    executor = EventsExecutor(context=node.context)
    executor.add_node(node)
    with node.diagnostics.errors_reported():
        try:
            while not (stop.is_set() and node.may_end()):
                executor.spin_once(timeout_sec=min(SIGNAL_CHECK_S, node.heartbeat()))
        except BaseException:
            _bring_to_rest(node, executor)
            raise


def _bring_to_rest(node: ReportingNode, executor: EventsExecutor) -> None:
    """Continue until the node may exit, although something failed and may fail again."""
    deadline = time.monotonic() + MOST_ENDING_S
    while not _tried(node.may_end) and time.monotonic() < deadline:
        _tried(node.heartbeat)
        _tried(partial(executor.spin_once, timeout_sec=RETRY_S))


def _tried(do: Callable[[], object]) -> object:
    """Call a function and return its result; None if it fails."""
    try:
        return do()
    except BaseException:  # including SystemExit: nothing may end a process that still moves a robot
        time.sleep(RETRY_S)  # so that a function that keeps failing does not occupy the processor
        return None


def run(make_node: Callable[[str], AnyNode], name: str, work: Callable[[AnyNode, Stop], None]) -> None:
    """Run a node's process: make the node, run its work, and exit cleanly.

    Bad input prints one line and exits with 2. A failed environment or a full disk prints one line and exits with 1. A
    silent node prints one line and exits with 75: the run can be resumed. A signal or a stop request ends a run with
    the exit code of an interrupt, and a serving node with 0.
    A signal only sets the event that is passed to the work, because ROS's own handlers would invalidate the context of
    a callback that is about to publish. SIGHUP is ignored under nohup.
    """
    stop = Stop()
    _handle_signals(stop)
    code = 0
    try:
        _begin(name)
        node = make_node(name)
        try:
            with one_thread():
                open_node(node)
                gc.collect()
                gc.freeze()  # so that the collector does not traverse imported modules between messages
                work(node, stop)
        finally:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(MOST_ENDING_S)
            node.destroy_node()
    except (StoppedError, KeyboardInterrupt):
        code = INTERRUPTED
    except SilentError as error:
        print_error(error)
        code = RESUMABLE
    except (ValueError, OSError, RunError) as error:
        code = print_error(error)
    finally:
        rclpy.try_shutdown()
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)  # Python would restore handlers that kill it during its exit
    sys.exit(code)


def _handle_signals(stop: Stop) -> None:
    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores it
            signal.signal(number, lambda number, frame: stop.set())
    for number in IGNORED:
        signal.signal(number, signal.SIG_IGN)


def _begin(name: str) -> None:
    """Initialise ROS: on this machine, by UDP, unless the environment says otherwise."""
    check_arguments(name, sys.argv[1:])
    if not sys.flags.safe_path:  # the node was started by hand; others search where their parent does
        search_here()
    os.environ.update(by_udp(os.environ))
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise ValueError(f"arguments: expected valid ROS arguments, but ROS reports: {truncated(error)}") from error


def open_node(node: ReportingNode) -> None:
    """Open a node's topics and services; raise PeerError if its name is taken, and ValueError for bad parameters."""
    node.claim_name()
    with names_reported(node):
        node.open()


@contextmanager
def names_reported(node: Node) -> Iterator[None]:
    """Raise ValueError for a topic or a service that ROS rejects."""
    try:
        yield
    except NameValidationException as error:  # of a topic or a service in the settings; ROS marks the place
        raise ValueError(" ".join(str(error).rstrip(" ^\n").split())) from error
    except RCLError as error:  # for example two topics of one name with different types
        raise ValueError(f"{node.get_name()}: cannot open its topics and services: {truncated(error)}") from error
