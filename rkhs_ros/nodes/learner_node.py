"""The learner node: collects episodes over topics, updates the policy and pushes it to the policy node."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import reduce
from itertools import zip_longest
from operator import add
from pathlib import Path
from threading import Event
from typing import Any

from rclpy.experimental import EventsExecutor
from rclpy.node import Node

from rkhs_interfaces.msg import Episodes as EpisodesMessage
from rkhs_interfaces.srv import DescribeTask, SetPolicy, StartEpisodes
from rkhs_ros.experiments.config import Config, Environment, training_from
from rkhs_ros.experiments.launcher import namespaces
from rkhs_ros.experiments.run import run_training
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.nodes.messages import LOCKSTEP_QOS, episodes_of, set_policy_request, start_request
from rkhs_ros.nodes.parameters import declare, declared, given
from rkhs_ros.nodes.spin import LOOK_UP, PeerError, StoppedError, run
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.settings import entries

ASK_AGAIN = 2.0  # seconds after which a request is sent anew


class SimulatorLink:
    """What the learner knows of one simulator.

    Owns the batch that it was asked for and the episodes that it sent.

    Args:
        node: the learner node.
        namespace: the simulator's.
    """

    def __init__(self, node: LearnerNode, namespace: str) -> None:
        self.name = f"{namespace}simulator"
        self.namespace = namespace
        self.batch: Batch | None = None
        self.heard: Episodes | None = None
        self.step = 0
        self._node = node
        self.start = node.create_client(StartEpisodes, f"{namespace}start_episodes")
        self.describe = node.create_client(DescribeTask, f"{namespace}describe_task")
        node.create_subscription(EpisodesMessage, f"{namespace}episodes", self._hear, LOCKSTEP_QOS)

    def expect(self, batch: Batch | None) -> None:
        """Wait for the episodes of a batch from now on."""
        self.batch, self.heard, self.step = batch, None, 0

    @property
    def busy(self) -> bool:
        """Whether episodes are still to come."""
        return self.batch is not None and self.heard is None

    def _hear(self, message: EpisodesMessage) -> None:
        node = self._node
        if self.batch is None or (message.batch, message.policy_version) != (node.identity, node.version):
            return  # late, or of another learner
        try:
            self.heard = episodes_of(message, self.batch, node.observation_dim, node.action_dim)
        except ValueError as error:
            node.get_logger().warning(f"ignored episodes: {error}")


class LearnerNode(Node):
    """Runs the training loop over topics; a `Runner` to that loop.

    Owns the settings of the run. Does not own the environment, the policy in service or the steps of a batch: it
    hears whole episodes, so that a step costs one message each way between simulator and policy node.
    """

    def __init__(self) -> None:
        """Declare the parameters and open topics and services.

        Raises:
            ValueError: an unknown parameter or a value that does not fit.
        """
        super().__init__("learner", automatically_declare_parameters_from_overrides=True)
        tree = given(self)
        self.output = declared(self, tree, "output", "", "folder for the results; empty for results/NAME/TIME")
        self.quiet = declared(self, tree, "quiet", False, "no progress bar")
        self.training = training_from(tree)
        declare(self, entries(self.training))
        self.told = Event()  # to end
        self._executor = EventsExecutor()
        self._executor.add_node(self)
        self.identity = time.time_ns()  # names a batch for the peers; no result depends on it
        self.version = 0
        self._served: GaussianPolicy | None = None
        self._simulators = [SimulatorLink(self, namespace) for namespace in namespaces(self.training.simulators)]
        self._set_policy = self.create_client(SetPolicy, "set_policy")

    def connect(self) -> Config:
        """Wait for simulator and policy node, and return the whole configuration.

        Raises:
            PeerError: one of them does not appear in time.
        """
        for simulator in self._simulators:
            self._until(simulator.describe.service_is_ready, simulator.name)
        self._until(self._set_policy.service_is_ready, "policy")
        tasks = [self._connected(s.describe, DescribeTask.Request(), s.name) for s in self._simulators]
        task, *others = tasks
        for simulator, other in zip(self._simulators[1:], others, strict=True):
            if (other.environment, other.options) != (task.environment, task.options):
                raise PeerError(f"expected all simulators of one task, got {other.environment} from {simulator.name}")
        self.observation_dim, self.action_dim = task.observation_dim, task.action_dim
        return Config(Environment(task.environment, json.loads(task.options)), self.training)

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy.

        Raises:
            PeerError: a node did not answer in time, or there are two of it.
            ValueError: a node refused the policy or the batch.
        """
        self._check_alone()
        self._serve(policy)
        self.identity += 1
        parts = batch.split(len(self._simulators))
        for simulator, part in zip_longest(self._simulators, parts):
            simulator.expect(part)
        for simulator, part in zip(self._simulators, parts, strict=False):
            request = start_request(self.identity, part)
            _accepted(self._call(simulator.start, request, simulator.name), simulator.name)
        while any(simulator.busy for simulator in self._simulators):
            self._wait_beyond()
        heard = [simulator.heard for simulator in self._simulators if simulator.heard is not None]
        return reduce(add, heard)

    def _check_alone(self) -> None:
        for simulator in self._simulators:
            for name, topic in ((simulator.name, "observation"), ("policy", "action")):
                if (count := self.count_publishers(simulator.namespace + topic)) > 1:
                    raise PeerError(f"expected one {name} node, got {count}; set ROS_DOMAIN_ID to keep runs apart")

    def _wait_beyond(self) -> None:
        """Wait for the episodes; where they take long, every simulator must have come to a later step."""
        if self._spin(lambda: not any(s.busy for s in self._simulators), self.training.timeout):
            return
        for simulator in [s for s in self._simulators if s.busy]:
            task = self._call(simulator.describe, DescribeTask.Request(), simulator.name)
            if task.batch != self.identity:
                raise PeerError(f"the {simulator.name} node was started anew and does not know the batch")
            if task.step <= simulator.step and simulator.busy:
                raise self._silent("policy")
            simulator.step = int(task.step)

    def _serve(self, policy: GaussianPolicy) -> None:
        if policy is not self._served:
            self.version += 1
            request = set_policy_request(policy, self.version)
            _accepted(self._connected(self._set_policy, request, "policy"), "policy")
            self._served = policy

    def _connected(self, client: Any, request: Any, name: str) -> Any:
        """Ask a node again and again until it is connected to its peers."""
        deadline = time.monotonic() + self.training.timeout
        while not (response := self._call(client, request, name)).connected:
            if time.monotonic() > deadline:
                raise self._silent(name)
        return response

    def _call(self, client: Any, request: Any, name: str) -> Any:
        """Ask a node; ask again where the answer was lost, as may happen to peers that have just met."""
        deadline = time.monotonic() + self.training.timeout
        while time.monotonic() < deadline:
            future = client.call_async(request)
            if self._spin(future.done, min(ASK_AGAIN, self.training.timeout)):
                return future.result()
            client.remove_pending_request(future)
        raise self._silent(name)

    def _until(self, condition: Callable[[], bool], name: str) -> None:
        if not self._spin(condition, self.training.timeout):
            raise self._silent(name)

    def _silent(self, name: str) -> PeerError:
        return PeerError(f"the {name} node did not answer within {self.training.timeout:g} s")

    def _spin(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Handle messages until the condition holds or the time is over; return whether it holds."""
        deadline = time.monotonic() + seconds
        while not condition():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(left, LOOK_UP))  # nor do new peers wake it
            if self.told.is_set():
                raise StoppedError
        return True


def _accepted(response: Any, name: str) -> None:
    if not response.accepted:
        raise ValueError(f"the {name} node refused: {response.message}")


def learn(node: LearnerNode, told: Event) -> None:
    """Run the whole training of a learner node, or until told to end."""
    node.told = told
    config = node.connect()
    run_training(config, node, Path(node.output) if node.output else None, quiet=node.quiet)


def main() -> None:
    """Run the learner node."""
    run(LearnerNode, learn)


if __name__ == "__main__":
    main()
