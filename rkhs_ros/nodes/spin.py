"""How a node's process begins, spins and ends."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable
from typing import TypeVar

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node

BAD_INPUT = 2  # exit code
FAILED = 1
AnyNode = TypeVar("AnyNode", bound=Node)


class PeerError(RuntimeError):
    """A node that does not answer in time or is there twice; the message names it."""


def forever(node: Node) -> None:
    """Handle a node's messages until it is told to shut down."""
    executor = EventsExecutor()
    executor.add_node(node)
    while rclpy.ok():  # without a timeout this executor would not see signals
        executor.spin_once(timeout_sec=3600.0)


def run(make_node: Callable[[], AnyNode], work: Callable[[AnyNode], None] = forever) -> None:
    """Run a node's process: make it, let it work, and end cleanly.

    Bad input ends with one line and exit code 2, a silent peer or a full disk with one line and exit code 1, a
    signal with exit code 0.
    """
    rclpy.init()
    code = 0
    try:
        node = make_node()
        gc.collect()
        gc.freeze()  # what was imported need not be searched for garbage between messages
        try:
            work(node)
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            node.destroy_node()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except ValueError as error:
        code = _say(error, BAD_INPUT)
    except (PeerError, OSError) as error:
        code = _say(error, FAILED)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        rclpy.try_shutdown()
    sys.exit(code)


def _say(error: Exception, code: int) -> int:
    print(f"error: {error}", file=sys.stderr, flush=True)
    return code
