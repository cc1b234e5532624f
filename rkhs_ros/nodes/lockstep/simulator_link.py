"""The learner's client of a simulator or a robot."""

import json
import re
import time
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from rclpy.node import Node
from std_msgs.msg import Empty

from rkhs_interfaces.msg import Episodes as EpisodesMessage
from rkhs_interfaces.srv import DescribeTask, StartEpisodes
from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import require, truncated
from rkhs_ros.learning.episodes import Episodes, Execution
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS
from rkhs_ros.nodes.core.peers import Peers, fresh_number
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S, PeerError
from rkhs_ros.policies.messages import spaces_of
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.messages import episodes_of, executions_of
from rkhs_ros.runs.config import MOST_ENVS, Environment

SIMULATOR, ROBOT = "simulator", "robot"
HEARTBEATS = 4  # per learner timeout of a robot


class FinishedBatch(NamedTuple):
    """A batch that has ended; `executions` is empty for a simulator."""

    batch: Batch
    episodes: Episodes
    executions: list[Execution]


class SimulatorLink:
    """The learner's client of a simulator or a robot.

    Owns the task, the requested batch, and the received episodes. A robot's episodes may be discarded, even after
    completion; the link sends heartbeats while the learner waits for them.
    """

    def __init__(self, node: Node, peers: Peers, namespace: str, num_envs: int, kind: str = SIMULATOR) -> None:
        self.name = f"{namespace}{kind}"
        self.task: DescribeTask.Response = DescribeTask.Response()
        self.spaces = Spaces.unbounded(1, 1)  # until it is connected
        self.request = StartEpisodes.Request()
        self.batch: Batch | None = None
        self.finished: FinishedBatch | None = None  # of the requested batch; of a robot, discarded ones too
        self.ended: list[FinishedBatch] = []  # to be recorded
        self.vetoed: list[Batch] = []  # completed, and discarded since
        self.failure: RunError | None = None  # of the requested batch
        self._is_vetoable = False  # whether the requested batch has ended, but may still be vetoed
        self._completed: dict[int, Batch] = {}  # batches that may still be vetoed, by the numbers of their requests
        self._logged = ""  # what the robot last waited for
        self._alive_at = 0.0  # monotonic time of the next heartbeat, seconds
        self._namespace = namespace
        self._node = node
        self._peers = peers
        self._num_envs = num_envs
        # Before the clients: a node that can answer a client has discovered what was created before it.
        node.create_subscription(EpisodesMessage, f"{namespace}episodes", self._hear, LOCKSTEP_QOS)
        self._alive = node.create_publisher(Empty, f"{namespace}learner_alive", LOCKSTEP_QOS)
        self._start = node.create_client(StartEpisodes, f"{namespace}start_episodes")
        self._describe = node.create_client(DescribeTask, f"{namespace}describe_task")

    def connect(self, expected: Environment | None) -> Environment:
        """Wait for the simulator, and get its task; any environment is accepted if None is expected."""
        self._peers.wait_for_service(self._describe, self.name)
        self.task = self._ask_for_task()
        options = json.loads(self.task.options)
        environment = Environment(self.task.environment, options, min(self.task.num_envs, MOST_ENVS))
        if expected is not None and _named(environment) != _named(expected):
            got = truncated(_named(environment))
            raise PeerError(f"the {self.name} node: expected the environment {_named(expected)}, got {got}")
        self.spaces = spaces_of(self.task)
        self.name = f"{self._namespace}{ROBOT if self.is_robot else SIMULATOR}"
        require(self.task.capacity >= 1, f"{self.name}: capacity", "at least 1 environment", self.task.capacity)
        return expected or environment

    @property
    def is_robot(self) -> bool:
        """Whether it is a robot, whose steps are timed by the wall clock."""
        return bool(self.task.period > 0)

    def begin(self, batch: Batch, version: int, *, seeds: Sequence[int] = (), timeout: float = 0.0) -> None:
        """Start a batch with the policy of that version; the simulator waits ``timeout`` seconds for each action."""
        self.batch, self.finished, self.failure, self._is_vetoable = batch, None, None, False
        self.request = StartEpisodes.Request(
            batch=fresh_number(),
            policy_version=version,
            environment=self.task.environment,
            options=self.task.options,
            environment_seeds=seeds,
            timeout=timeout,
            **vars(batch),
        )
        self._peers.call_until_accepted(partial(self._peers.call, self._start, self.request, self.name), self.name)

    def release(self) -> None:
        """Forget the completed episodes: once the learner has used them, they cannot be vetoed."""
        self.batch = None
        self._completed.clear()
        self.ended.clear()
        self.vetoed.clear()

    def check(self) -> None:
        """Check that the node still answers, and log what the operator of a robot has to do."""
        text = self._ask_for_task().waiting
        kind = re.sub(r"[0-9.]+", "", text)  # numbers such as the rate of a sensor may change
        if text and kind != self._logged:
            self._node.get_logger().warning(f"the {self.name} node is waiting: {text}")
        self._logged = kind

    def heartbeat(self) -> float:
        """Send a due heartbeat to a robot that runs episodes; return the seconds until the next one."""
        if not (self.is_robot and self.batch is not None and self.finished is None):
            return SIGNAL_CHECK_S
        now, period = time.monotonic(), self.task.learner_timeout / HEARTBEATS
        if now >= self._alive_at:
            self._alive.publish(Empty())
            self._alive_at = now + period
        return min(self._alive_at - now, SIGNAL_CHECK_S)

    def _ask_for_task(self) -> DescribeTask.Response:
        request = DescribeTask.Request(num_envs=self._num_envs)
        return self._peers.call(self._describe, request, self.name, repeatable=True)

    def _hear(self, message: EpisodesMessage) -> None:
        try:
            if message.batch == self.request.batch and self.batch is not None and self.finished is None:
                self._take(message, self.batch)
            elif message.batch in self._completed:
                batch = self._completed.pop(message.batch)
                self.ended.append(self._finished_of(message, batch))
                self.vetoed.append(batch)
        except ValueError as error:
            self.failure = PeerError(f"the {self.name} node sent invalid episodes: {error}")

    def _take(self, message: EpisodesMessage, batch: Batch) -> None:
        """Store the episodes of the requested batch, completed or discarded."""
        if message.failure:
            self.failure = RunError(truncated(message.failure))
            return
        finished = self._finished_of(message, batch)
        is_discarded = bool(discard_reason(finished))
        if is_discarded or not self._is_vetoable:  # otherwise it was recorded when it could still be vetoed
            self.ended.append(finished)
        self._is_vetoable = bool(message.vetoable)
        if not self._is_vetoable:
            self.finished = finished
            if not is_discarded:
                self._completed[message.batch] = batch

    def _finished_of(self, message: EpisodesMessage, batch: Batch) -> FinishedBatch:
        expected = batch.num_envs if self.is_robot else 0
        require(len(message.executions) == expected, "executions", f"{expected} of them", len(message.executions))
        return FinishedBatch(batch, episodes_of(message, batch, self.spaces), executions_of(message))


def discard_reason(finished: FinishedBatch) -> str:
    """Return why a batch of a robot is discarded; empty if it is not."""
    return next((each.discard_reason for each in finished.executions if each.discard_reason), "")


def _named(environment: Environment) -> str:
    return f"{environment.id} with options {json.dumps(dict(environment.options), sort_keys=True)}"
