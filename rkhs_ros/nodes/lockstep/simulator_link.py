"""The learner's client of a simulator or a robot."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from rclpy.node import Node
from std_msgs.msg import Empty

from rkhs_interfaces.msg import BatchProgress
from rkhs_interfaces.msg import Episodes as EpisodesMessage
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import require, truncated
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.execution import Execution
from rkhs_ros.learning.messages import episodes_of, executions_of
from rkhs_ros.learning.replay import check_actions
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, start_request
from rkhs_ros.nodes.core.names import fresh_number
from rkhs_ros.nodes.core.peers import REFUSAL_STANDS_S, Peers
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S, PeerError
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.messages import spaces_of
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.batch_sharing import EpisodeTiming
from rkhs_ros.runs.config import MOST_ENVS, Environment

SIMULATOR, ROBOT = "simulator", "robot"
PROBE_S = 0.2  # for a silent simulator to answer, whenever the others start a batch
MAX_DISCARDS = 10  # of one episode of a robot in a row, after which the run ends
HEARTBEATS = 4  # per learner timeout of a robot


class FinishedBatch(NamedTuple):
    """A batch that has ended; `executions` is empty for simulators."""

    batch: Batch
    episodes: Episodes
    executions: list[Execution]


class SimulatorLink:
    """The learner's client of one simulator or robot.

    Owns the task, the requested batch and its policy, the furthest observed step of the batch, the number of starts
    without progress, the timing, and the received episodes. Accepts only episodes in which the policy acted. A robot's
    episodes may be discarded, even after completion; the link sends heartbeats while the learner waits for them.

    Args:
        node: the learner node.
        peers: the learner's calls to other nodes.
        namespace: of the simulator.
        num_envs: environments in the coming batches.
        refuse: callback for the reason of refused episodes.
        kind: assumed kind of node, `SIMULATOR` or `ROBOT`, until the node describes itself.
    """

    def __init__(
        self,
        node: Node,
        peers: Peers,
        namespace: str,
        num_envs: int,
        refuse: Callable[[str], None],
        kind: str = SIMULATOR,
    ) -> None:
        self.namespace = namespace
        self.name = f"{namespace}{kind}"
        self.task: DescribeTask.Response = DescribeTask.Response()
        self.spaces = Spaces.unbounded(1, 1)  # until it is connected
        self.batch: Batch | None = None
        self.episodes: Episodes | None = None
        self.request = StartEpisodes.Request()
        self.step = 0
        self.is_gone = False  # silent; other simulators run its episodes
        self.attempts = 0
        self.timing = EpisodeTiming()
        self._begun_at = 0.0  # monotonic time, seconds
        self.executions: list[Execution] = []
        self.refusal = ""  # why episodes of the batch were refused; empty if none were
        self.discarded: FinishedBatch | None = None  # discarded, and not restarted yet
        self.discards = 0  # of the batch, in a row
        self.vetoed: list[FinishedBatch] = []  # completed, and discarded since
        self._policy: GaussianPolicy | None = None
        self._finished: dict[int, Batch] = {}  # batches under the policy in service, by the numbers of their requests
        self._logged = ""  # what the robot last waited for
        self._alive_at = 0.0  # monotonic time of the next heartbeat, seconds
        self._node = node
        self._peers = peers
        self._num_envs = num_envs
        self._refuse = refuse
        self._start = node.create_client(StartEpisodes, f"{namespace}start_episodes")
        self._describe = node.create_client(DescribeTask, f"{namespace}describe_task")
        self._alive = node.create_publisher(Empty, f"{namespace}learner_alive", LOCKSTEP_QOS)
        node.create_subscription(EpisodesMessage, f"{namespace}episodes", self._hear, LOCKSTEP_QOS)

    def wait(self) -> None:
        """Wait until the simulator node offers its service.

        Raises:
            PeerError: the node does not offer it in time.
        """
        self._peers.wait_for_service(self._describe, self.name)

    def connect(self, expected: Environment | None) -> Environment:
        """Get the simulator's task, once the simulator is connected to the policy node and to the learner.

        An error counts only if it persists: a second simulator of this name may answer before it exits.

        Args:
            expected: the required environment; None for any.

        Raises:
            PeerError: the simulator has another environment.
            ValueError: the description is not a valid task.
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
            got = truncated(_named(environment))
            raise PeerError(f"the {self.name} node: expected the environment {_named(expected)}, got {got}")
        self.spaces = spaces_of(self.task)
        self.name = f"{self.namespace}{ROBOT if self.is_robot else SIMULATOR}"
        require(self.task.capacity >= 1, f"{self.name}: capacity", "at least 1 environment", self.task.capacity)
        return expected or environment

    def describe(self) -> DescribeTask.Response:
        """Request the simulator's task and progress."""
        with self._naming_place():
            return self._peers.call(self._describe, DescribeTask.Request(num_envs=self._num_envs), self.name)

    @property
    def is_robot(self) -> bool:
        """Whether it is a robot, whose steps are timed by the wall clock."""
        return bool(self.task.period > 0)

    def answers(self) -> bool:
        """Return whether the simulator answers at once, with the same task as before."""
        if not self._describe.service_is_ready():
            return False
        future = self._describe.call_async(DescribeTask.Request(num_envs=self._num_envs))
        if not self._peers.spin(future.done, PROBE_S):
            self._describe.remove_pending_request(future)
            return False
        task = future.result()
        return bool((task.environment, task.options) == (self.task.environment, self.task.options))

    def mark_idle(self) -> None:
        """Mark the simulator idle."""
        self.batch, self.episodes, self.discarded = None, None, None
        self.step = self.attempts = self.discards = 0

    def clear_finished(self) -> None:
        """Clear the completed episodes: once the learner has used them, they cannot be discarded."""
        self._finished.clear()
        self.vetoed.clear()

    def heartbeat(self) -> float:
        """Send a due heartbeat to a robot that runs episodes; return the seconds until the next one."""
        if not (self.is_robot and self.busy):
            return SIGNAL_CHECK_S
        now, period = time.monotonic(), self.task.learner_timeout / HEARTBEATS
        if now >= self._alive_at:
            self._alive.publish(Empty())
            self._alive_at = now + period
        return min(self._alive_at - now, SIGNAL_CHECK_S)

    def report_waiting(self, text: str) -> None:
        """Log what the operator of a robot has to do, once; numbers such as the rate of a sensor may change."""
        kind = re.sub(r"[0-9.]+", "", text)
        if text and kind != self._logged:
            self._node.get_logger().warning(f"the {self.name} node is waiting: {text}")
        self._logged = kind

    def begin(
        self, batch: Batch, policy: GaussianPolicy | None, version: int, clock: int, seeds: Sequence[int] = ()
    ) -> None:
        """Start a batch in the simulator with the policy of that version.

        A robot returns episodes that it has completed before, unless the learner refused them.

        Args:
            batch: the episodes.
            policy: the acting policy, for checking the episodes; None for no check.
            version: of the policy.
            clock: steps counted so far.
            seeds: of the environments, instead of those of the batch.

        Raises:
            ValueError: the simulator refuses the batch.
        """
        anew = bool(self.refusal)
        self.batch, self.episodes, self.refusal, self.discarded = batch, None, "", None
        self._begun_at = time.monotonic()
        self.attempts += 1
        if self.is_robot:
            self.step = 0  # steps of a robot cannot be repeated, so its progress starts again
        self._policy = policy
        self.request = start_request(fresh_number(), version, batch, self.task, clock, anew=anew)
        self.request.environment_seeds = seeds
        with self._naming_place():
            self._peers.call_until_accepted(self._ask, self.name)
        self._begun_at = time.monotonic()  # not counting the restart of a dead simulator

    def ask_again(self) -> bool:
        """Request that the simulator repeats its last message; return whether it still has the batch."""
        with self._naming_place():
            return bool(self._ask().accepted)

    def _ask(self) -> StartEpisodes.Response:
        return self._peers.call(self._start, self.request, self.name)

    @property
    def busy(self) -> bool:
        """Whether the learner expects episodes."""
        return self.batch is not None and self.episodes is None and not self.is_gone

    def lost(self, task: DescribeTask.Response) -> bool:
        """Return whether the batch is lost: the simulator was restarted, or another client started another batch."""
        return bool(task.batch != self.request.batch)

    def advanced(self, batch: int, step: int) -> bool:
        """Record progress; return whether the batch of that number has reached a new step, counted from 1."""
        further = batch == self.request.batch and step > self.step
        if further:
            self.step, self.attempts = step, 1
        return further

    def check(self, task: DescribeTask.Response, answered: BatchProgress) -> None:
        """Raise RunError if the simulator or the policy node reports a failure in the batch."""
        if task.failure and not self.lost(task):
            raise RunError(task.failure)
        if answered.failure and answered.batch == self.request.batch:
            raise RunError(f"{self.task.environment}: {answered.failure}")

    @property
    def place(self) -> str:
        """The last observed step of the environment, as text."""
        return f"{self.task.environment} was in {f'step {self.step}' if self.step else 'its reset'}"

    @contextmanager
    def _naming_place(self) -> Iterator[None]:
        """Add the last observed step to the message of a PeerError, because the environment may have hung in it."""
        try:
            yield
        except PeerError as error:
            raise type(error)(f"{error}; {self.place}" if self.batch else str(error)) from error

    def _hear(self, message: EpisodesMessage) -> None:
        try:
            if message.batch in self._finished:
                self._hear_veto(message, self._finished[message.batch])
            elif self.busy and (message.batch, message.policy_version) == self._expected:
                self._take(message)
        except ValueError as error:
            self.refusal = str(error)
            self._refuse(f"episodes: {self.name}: {error}")

    @property
    def _expected(self) -> tuple[int, int]:
        return self.request.batch, self.request.policy_version

    def _take(self, message: EpisodesMessage) -> None:
        """Store the episodes of the current batch, completed or discarded."""
        if self.batch is None or self.discarded:
            return
        episodes = episodes_of(message, self.batch, self.spaces)
        executions = self._executions(message, self.batch)
        if any(execution.discard_reason for execution in executions):
            self.discarded = FinishedBatch(self.batch, episodes, executions)
            return
        if self._policy is not None:
            check_actions(episodes, self._policy, self.batch)
        self.episodes, self.executions = episodes, executions
        self.timing.took(time.monotonic() - self._begun_at, self.batch.num_envs)
        self._finished[message.batch] = self.batch

    def _hear_veto(self, message: EpisodesMessage, batch: Batch) -> None:
        """Record that completed episodes are discarded; ignore repeated messages of completed ones."""
        executions = self._executions(message, batch)
        if any(execution.discard_reason for execution in executions):
            self.vetoed.append(FinishedBatch(batch, episodes_of(message, batch, self.spaces), executions))
            del self._finished[message.batch]

    def _executions(self, message: EpisodesMessage, batch: Batch) -> list[Execution]:
        expected = batch.num_envs if self.is_robot else 0
        require(len(message.executions) == expected, "executions", f"{expected} of them", len(message.executions))
        return executions_of(message)


def _environment_of(task: DescribeTask.Response) -> Environment:
    """Return the environment that a simulator describes.

    Raises:
        ValueError: the options are not a JSON object.
    """
    try:
        options = json.loads(task.options)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"options: expected a JSON object, got {truncated(task.options)}") from error
    return Environment(task.environment, options, min(task.num_envs, MOST_ENVS))


def _named(environment: Environment) -> str:
    return f"{environment.id} with options {json.dumps(dict(environment.options), sort_keys=True)}"
