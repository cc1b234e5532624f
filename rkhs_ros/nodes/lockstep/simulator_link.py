"""A simulator, or a robot, as the learner sees it."""

from __future__ import annotations

import json
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
PROBE_S = 0.2  # for a simulator that fell silent to answer, each time that others begin
MAX_DISCARDS = 10  # of a robot's episodes, one after another, after which it is given up
SIGNS_OF_LIFE = 4  # within the time after which a robot takes the learner for dead


class FinishedBatch(NamedTuple):
    """A batch that ended, and how on a robot."""

    batch: Batch
    episodes: Episodes
    executions: list[Execution]


class SimulatorLink:
    """One simulator, or robot, as the learner sees it.

    Owns the task it simulates, the batch that it was asked for and the policy that acts in it, the furthest step of the
    batch that was seen, how often it was begun without coming further, how quick it was, and the episodes that it sent.
    Only those in which the policy acted are taken. Episodes of a robot may be discarded, even after they finished; and
    while they are waited for it is given signs of life.

    Args:
        node: the learner node.
        peers: how it calls others.
        namespace: the simulator's.
        rows: of the batches to come.
        refuse: is told why episodes are refused.
        kind: name of the node, without its namespace, until it tells itself what it is.
    """

    def __init__(
        self,
        node: Node,
        peers: Peers,
        namespace: str,
        rows: int,
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
        self.is_gone = False  # it fell silent, and others make its episodes
        self.attempts = 0
        self.timing = EpisodeTiming()
        self._begun_at = 0.0  # monotonic time, seconds
        self.executions: list[Execution] = []
        self.refusal = ""  # why episodes of the batch were refused; empty while none were
        self.discarded: FinishedBatch | None = None  # what was discarded and is to begin again
        self.discards = 0  # of the batch, one after another
        self.vetoed: list[FinishedBatch] = []  # finished, and discarded since
        self._policy: GaussianPolicy | None = None
        self._finished: dict[int, Batch] = {}  # under the policy in service, by the numbers that they were asked by
        self._told = ""  # what a person was last told that the robot waits for
        self._life_at = 0.0  # monotonic time of the next sign of life, seconds
        self._node = node
        self._peers = peers
        self._rows = rows
        self._refuse = refuse
        self._start = node.create_client(StartEpisodes, f"{namespace}start_episodes")
        self._describe = node.create_client(DescribeTask, f"{namespace}describe_task")
        self._life = node.create_publisher(Empty, f"{namespace}learner_alive", LOCKSTEP_QOS)
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
            got = truncated(_named(environment))
            raise PeerError(f"the {self.name} node: expected one of {_named(expected)}, got one of {got}")
        self.spaces = spaces_of(self.task)
        self.name = f"{self.namespace}{ROBOT if self.is_robot else SIMULATOR}"
        require(self.task.capacity >= 1, f"{self.name}: capacity", "at least 1 row", self.task.capacity)
        return expected or environment

    def describe(self) -> DescribeTask.Response:
        """Ask the simulator what it simulates and how far it is."""
        with self._place_named():
            return self._peers.call(self._describe, DescribeTask.Request(num_envs=self._rows), self.name)

    @property
    def is_robot(self) -> bool:
        """Whether it is a robot, whose steps the wall clock ends."""
        return bool(self.task.period > 0)

    def answers(self) -> bool:
        """Return whether the simulator, of the same task as before, answers at once."""
        if not self._describe.service_is_ready():
            return False
        future = self._describe.call_async(DescribeTask.Request(num_envs=self._rows))
        if not self._peers.spin(future.done, PROBE_S):
            self._describe.remove_pending_request(future)
            return False
        task = future.result()
        return bool((task.environment, task.options) == (self.task.environment, self.task.options))

    def mark_idle(self) -> None:
        """Mark the simulator idle."""
        self.batch, self.episodes, self.discarded = None, None, None
        self.step = self.attempts = self.discards = 0

    def forget_finished(self) -> None:
        """Forget the episodes that were finished: what is learnt from cannot be discarded."""
        self._finished.clear()
        self.vetoed.clear()

    def heartbeat(self) -> float:
        """Give a robot that episodes are expected of a sign of life when it is due; return the seconds until it is."""
        if not (self.is_robot and self.busy):
            return SIGNAL_CHECK_S
        now, period = time.monotonic(), self.task.learner_timeout / SIGNS_OF_LIFE
        if now >= self._life_at:
            self._life.publish(Empty())
            self._life_at = now + period
        return min(self._life_at - now, SIGNAL_CHECK_S)

    def report_waiting(self, text: str) -> None:
        """Tell the person what a robot waits for them to do, once."""
        if text and text != self._told:
            self._node.get_logger().warning(f"the {self.name} node is waiting: {text}")
        self._told = text

    def begin(
        self, batch: Batch, policy: GaussianPolicy | None, version: int, clock: int, seeds: Sequence[int] = ()
    ) -> None:
        """Have the simulator begin a batch, in which the policy of that version acts.

        A robot gives episodes that it finished before again, unless they were refused here.

        Args:
            batch: the episodes.
            policy: that acts, by which the episodes are checked; None where they are not.
            version: of the policy.
            clock: steps counted so far.
            seeds: of the environment, in place of those of the batch.

        Raises:
            ValueError: it refuses.
        """
        anew = bool(self.refusal)
        self.batch, self.episodes, self.refusal, self.discarded = batch, None, "", None
        self._begun_at = time.monotonic()
        self.attempts += 1
        if self.is_robot:
            self.step = 0  # what it did was done by the wall clock: there is no coming further in the same again
        self._policy = policy
        self.request = start_request(fresh_number(), version, batch, self.task, clock, anew=anew)
        self.request.environment_seeds = seeds
        with self._place_named():
            self._peers.call_until_accepted(self._ask, self.name)
        self._begun_at = time.monotonic()  # it may have been started again first

    def ask_again(self) -> bool:
        """Have what the simulator published last repeated; return whether it knows the batch as it was asked for."""
        with self._place_named():
            return bool(self._ask().accepted)

    def _ask(self) -> StartEpisodes.Response:
        return self._peers.call(self._start, self.request, self.name)

    @property
    def busy(self) -> bool:
        """Whether episodes are still to come."""
        return self.batch is not None and self.episodes is None and not self.is_gone

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
        """Take the episodes of the batch under way, finished or discarded."""
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
        """Take note that finished episodes are discarded after all; what is finished may be told twice."""
        executions = self._executions(message, batch)
        if any(execution.discard_reason for execution in executions):
            self.vetoed.append(FinishedBatch(batch, episodes_of(message, batch, self.spaces), executions))
            del self._finished[message.batch]

    def _executions(self, message: EpisodesMessage, batch: Batch) -> list[Execution]:
        expected = batch.num_envs if self.is_robot else 0  # nothing befalls a simulation
        require(
            len(message.executions) == expected, "episodes' executions", f"{expected} of them", len(message.executions)
        )
        return executions_of(message)


def _environment_of(task: DescribeTask.Response) -> Environment:
    """Return the environment that a simulator describes.

    Raises:
        ValueError: the options are no JSON object.
    """
    try:
        options = json.loads(task.options)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"options: expected a JSON object, got {truncated(task.options)}") from error
    return Environment(task.environment, options, min(task.num_envs, MOST_ENVS))


def _named(environment: Environment) -> str:
    return f"{environment.id} with options {json.dumps(dict(environment.options), sort_keys=True)}"
