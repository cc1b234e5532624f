"""How a node's process begins, spins and ends."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable
from threading import Event
from typing import TYPE_CHECKING, TypeVar

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from rkhs_ros.base.endings import RunError, say
from rkhs_ros.base.streams import messages_may_be_lost
from rkhs_ros.nodes.transport import check_domain

if TYPE_CHECKING:
    from rkhs_ros.nodes.diagnostics import Diagnostics

SIGNAL_CHECK_S = 0.1  # between looks at whether a signal came
AnyNode = TypeVar("AnyNode", bound=Node)


class PeerError(RunError):
    """A node that does not answer in time or is there twice; the message names it."""


class StoppedError(BaseException):
    """The process was told to end; as an interrupt it is no error, so `except Exception` lets it pass."""


class ReportingNode(Node):
    """A node that reports how it fares, and has work of its own between messages.

    Attributes:
        diagnostics: its reports.
    """

    diagnostics: Diagnostics

    def heartbeat(self) -> float:
        """Do the periodic work that is due, the report first of all; return the seconds until more may be due."""
        raise NotImplementedError


def serve(node: ReportingNode, stop: Event) -> None:
    """Handle a node's messages until told to end."""
    executor = EventsExecutor()
    executor.add_node(node)
    with node.diagnostics.errors_reported():
        while not stop.is_set():
            executor.spin_once(timeout_sec=min(node.heartbeat(), SIGNAL_CHECK_S))


def run(make_node: Callable[[], AnyNode], work: Callable[[AnyNode, Event], None]) -> None:
    """Run a node's process: make it, let it work, and end cleanly.

    Bad input ends with one line and exit code 2, a silent peer, a failed environment or a full disk with one line and
    exit code 1, a signal with exit code 0. A signal only sets the event that the work is given: ROS's own handlers
    would pull the context from under a callback that is about to publish.
    """
    with messages_may_be_lost():
        sys.exit(_code_of(make_node, work))


def _code_of(make_node: Callable[[], AnyNode], work: Callable[[AnyNode, Event], None]) -> int:
    stop = Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: stop.set())
    code = 0
    try:
        check_domain(os.environ)
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = make_node()
        gc.collect()
        gc.freeze()  # what was imported need not be searched for garbage between messages
        try:
            work(node, stop)
        finally:
            node.destroy_node()
    except StoppedError:
        pass
    except (ValueError, OSError, RunError) as error:
        code = say(error)
    finally:
        rclpy.try_shutdown()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)  # Python would put back what kills it while it ends
    return code
