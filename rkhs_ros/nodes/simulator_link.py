"""A simulator as the learner sees it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rclpy.node import Node

from rkhs_interfaces.msg import BatchProgress
from rkhs_interfaces.msg import Episodes as EpisodesMessage
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import require, shown
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.messages import episodes_of
from rkhs_ros.learning.replay import check_actions
from rkhs_ros.nodes.messages import LOCKSTEP_QOS, start_request
from rkhs_ros.nodes.names import fresh_number
from rkhs_ros.nodes.peers import REFUSAL_STANDS_S, Peers
from rkhs_ros.nodes.spin import SIGNAL_CHECK_S, PeerError
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.messages import spaces_of
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import MOST_ROWS, Environment


class SimulatorLink:
    """One simulator as the learner sees it.

    Owns the task it simulates, the batch that it was asked for and the policy that acts in it, the furthest step of the
    batch that was seen, how often it was begun without coming further, and the episodes that it sent. Only those in
    which the policy acted are taken.

    Args:
        node: the learner node.
        peers: how it calls others.
        namespace: the simulator's.
        rows: of the batches to come.
        refuse: is told why episodes are refused.
    """

    def __init__(self, node: Node, peers: Peers, namespace: str, rows: int, refuse: Callable[[str], None]) -> None:
        self.namespace = namespace
        self.name = f"{namespace}simulator"
        self.task: DescribeTask.Response = DescribeTask.Response()
        self.spaces = Spaces.unbounded(1, 1)  # until it is connected
        self.batch: Batch | None = None
        self.episodes: Episodes | None = None
        self.request = StartEpisodes.Request()
        self.step = 0
        self.attempts = 0
        self.refusal = ""  # why episodes of the batch were refused; empty while none were
        self._policy: GaussianPolicy | None = None
        self._peers = peers
        self._rows = rows
        self._refuse = refuse
        self._start = node.create_client(StartEpisodes, f"{namespace}start_episodes")
        self._describe = node.create_client(DescribeTask, f"{namespace}describe_task")
        node.create_subscription(EpisodesMessage, f"{namespace}episodes", self._hear, LOCKSTEP_QOS)

    def wait(self) -> None:
        """Wait until the simulator is there."""
        self._peers.wait_for_service(self._describe, self.name)

    def connect(self, expected: Environment | None) -> Environment:
        """Learn the simulator's task, once it is connected to the policy node and to this one.

        What is wrong must stand: a second simulator of this name may answer that is about to end.

        Args:
            expected: the environment that it must have; any where None.

        Raises:
            PeerError: it has another environment.
            ValueError: what it describes is no task.
        """
        deadline = time.monotonic() + REFUSAL_STANDS_S
        while True:
            self.task = self._peers.call_until_connected(self.describe, self.name)
            try:
                return self._accept(expected)
            except (PeerError, ValueError):
                if time.monotonic() > deadline:
                    raise
            self._peers.spin(lambda: False, SIGNAL_CHECK_S)

    def _accept(self, expected: Environment | None) -> Environment:
        environment = _environment_of(self.task)
        if expected is not None and _named(environment) != _named(expected):
            got = shown(_named(environment))
            raise PeerError(f"the {self.name} node: expected one of {_named(expected)}, got one of {got}")
        self.spaces = spaces_of(self.task)
        require(self.task.room >= 1, f"{self.name}: room", "at least 1 row", self.task.room)
        return expected or environment

    def describe(self) -> DescribeTask.Response:
        """Ask the simulator what it simulates and how far it is."""
        with self._place_named():
            return self._peers.call(self._describe, DescribeTask.Request(rows=self._rows), self.name)

    def mark_idle(self) -> None:
        """Mark the simulator idle."""
        self.batch, self.episodes = None, None
        self.step = self.attempts = 0

    def begin(self, batch: Batch, policy: GaussianPolicy | None, version: int, clock: int) -> None:
        """Have the simulator begin a batch, in which the policy of that version acts.

        Raises:
            ValueError: it refuses.
        """
        self.batch, self.episodes, self.refusal = batch, None, ""
        self.attempts += 1
        self._policy = policy
        self.request = start_request(fresh_number(), version, batch, self.task, clock)
        with self._place_named():
            self._peers.call_until_accepted(self._ask, self.name)

    def ask_again(self) -> bool:
        """Have what the simulator published last repeated; return whether it knows the batch as it was asked for."""
        with self._place_named():
            return bool(self._ask().accepted)

    def _ask(self) -> StartEpisodes.Response:
        return self._peers.call(self._start, self.request, self.name)

    @property
    def busy(self) -> bool:
        """Whether episodes are still to come."""
        return self.batch is not None and self.episodes is None

    def lost(self, task: DescribeTask.Response) -> bool:
        """Return whether the batch is lost: the simulator died since, or somebody else had it begin another."""
        return bool(task.batch != self.request.batch)

    def advanced(self, batch: int, step: int) -> bool:
        """Return whether the batch of that number came further than ever, to that step, counted from 1."""
        further = batch == self.request.batch and step > self.step
        if further:
            self.step, self.attempts = step, 1
        return further

    def check(self, task: DescribeTask.Response, answered: BatchProgress) -> None:
        """Raise RunError where the environment failed in the batch, or the policy, as simulator and policy node say."""
        if task.failure and not self.lost(task):
            raise RunError(task.failure)
        if answered.failure and answered.batch == self.request.batch:
            raise RunError(f"{self.task.environment}: {answered.failure}")

    @property
    def place(self) -> str:
        """Where the environment was seen last."""
        return f"{self.task.environment} was in {f'step {self.step}' if self.step else 'its reset'}"

    @contextmanager
    def _place_named(self) -> Iterator[None]:
        """Say where the environment was when the simulator fell silent, as it may be what hangs."""
        try:
            yield
        except PeerError as error:
            raise PeerError(f"{error}; {self.place}" if self.batch else str(error)) from error

    def _hear(self, message: EpisodesMessage) -> None:
        expected = (self.request.batch, self.request.policy_version)
        if not self.busy or (message.batch, message.policy_version) != expected:
            return  # late, or of another learner
        try:
            self.episodes = self._checked(message)
        except ValueError as error:
            self.refusal = str(error)
            self._refuse(f"episodes: {self.name}: {error}")

    def _checked(self, message: EpisodesMessage) -> Episodes | None:
        if self.batch is None or self._policy is None:
            return None
        episodes = episodes_of(message, self.batch, self.spaces)
        check_actions(episodes, self._policy, self.batch)
        return episodes


def _environment_of(task: DescribeTask.Response) -> Environment:
    """Return the environment that a simulator describes.

    Raises:
        ValueError: the options are no JSON object.
    """
    try:
        options = json.loads(task.options)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"options: expected a JSON object, got {shown(task.options)}") from error
    return Environment(task.environment, options, min(task.rows_at_once, MOST_ROWS))


def _named(environment: Environment) -> str:
    return f"{environment.id} with options {json.dumps(dict(environment.options), sort_keys=True)}"
