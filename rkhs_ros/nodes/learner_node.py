"""The learner node: collects episodes over topics, updates the policy and pushes it to the policy node."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.subscription import Subscription

from rkhs_interfaces.msg import Action, Observation
from rkhs_interfaces.srv import DescribeTask, SetPolicy, StartEpisodes
from rkhs_ros.experiments.config import Config, Environment, training_from
from rkhs_ros.experiments.rollout import EpisodeRecorder
from rkhs_ros.experiments.run import run_training
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.nodes.messages import LOCKSTEP_QOS, frame_of, matrix, set_policy_request, start_request
from rkhs_ros.nodes.parameters import declare, declared, given
from rkhs_ros.nodes.spin import PeerSilentError, run
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.settings import entries


class LearnerNode(Node):
    """Runs the training loop over topics; a `Runner` to that loop.

    Owns the settings of the run and the episodes under way. Does not own the environment or the policy in
    service: it hears both topics and pairs them by batch and step.
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
        self._executor = EventsExecutor()
        self._executor.add_node(self)
        self._identity = time.time_ns()  # names a batch for the peers; no result depends on it
        self._version = 0
        self._served: GaussianPolicy | None = None
        self._recording: Recording | None = None
        self._start = self.create_client(StartEpisodes, "start_episodes")
        self._describe = self.create_client(DescribeTask, "describe_task")
        self._set_policy = self.create_client(SetPolicy, "set_policy")
        self._heard = (
            ("simulator", self.create_subscription(Observation, "observation", self._observe, LOCKSTEP_QOS)),
            ("policy", self.create_subscription(Action, "action", self._act, LOCKSTEP_QOS)),
        )

    def connect(self) -> Config:
        """Wait for simulator and policy node, and return the whole configuration.

        Raises:
            PeerSilentError: one of them does not appear in time, or there are two of it.
        """
        clients = {"simulator": (self._start, self._describe), "policy": (self._set_policy,)}
        for name, subscription in self._heard:
            self._until(partial(_is_heard, subscription), name)
            for client in clients[name]:
                self._until(client.service_is_ready, name)
            if (count := subscription.get_publisher_count()) > 1:
                raise PeerSilentError(f"expected one {name} node, got {count}; set ROS_DOMAIN_ID to keep runs apart")
        task = self._call(self._describe, DescribeTask.Request(), "simulator")
        self.observation_dim, self.action_dim = task.observation_dim, task.action_dim
        return Config(Environment(task.environment, json.loads(task.options)), self.training)

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy.

        Raises:
            PeerSilentError: a node did not answer in time.
            ValueError: a node refused the policy or the batch.
        """
        self._serve(policy)
        self._identity += 1
        recording = Recording(self._identity, self._version, batch, self.observation_dim, self.action_dim)
        self._recording = recording
        self._request(self._start, start_request(self._identity, batch), "simulator")
        while not recording.complete:
            self._until(recording.grown(), recording.awaited)
        return recording.recorder.episodes()

    def _serve(self, policy: GaussianPolicy) -> None:
        if policy is not self._served:
            self._version += 1
            self._request(self._set_policy, set_policy_request(policy, self._version), "policy")
            self._served = policy

    def _observe(self, message: Observation) -> None:
        if self._recording is not None:
            self._recording.observe(message)

    def _act(self, message: Action) -> None:
        if self._recording is not None:
            self._recording.act(message)

    def _request(self, client: Any, request: Any, name: str) -> None:
        response = self._call(client, request, name)
        if not response.accepted:
            raise ValueError(f"the {name} node refused: {response.message}")

    def _call(self, client: Any, request: Any, name: str) -> Any:
        future = client.call_async(request)
        self._until(future.done, name)
        return future.result()

    def _until(self, condition: Callable[[], bool], name: str) -> None:
        """Handle messages until the condition holds."""
        deadline = time.monotonic() + self.training.timeout
        while not condition():
            left = deadline - time.monotonic()
            if left <= 0:
                raise PeerSilentError(f"the {name} node did not answer within {self.training.timeout:g} s")
            self._executor.spin_once(timeout_sec=min(left, 0.1))
            if not rclpy.ok():
                raise ExternalShutdownException


def _is_heard(subscription: Subscription) -> bool:
    return bool(subscription.get_publisher_count() > 0)


class Recording:
    """The messages of one batch, paired by step.

    Args:
        identity: the batch's number on the topics.
        version: version of the policy that must act.
        batch: the episodes.
        observation_dim: d.
        action_dim: n.
    """

    def __init__(self, identity: int, version: int, batch: Batch, observation_dim: int, action_dim: int) -> None:
        self.recorder = EpisodeRecorder(batch, observation_dim, action_dim)
        self._identity, self._version, self._batch = identity, version, batch
        self._dims = observation_dim, action_dim
        self._observed = self._acted = 0

    def grown(self) -> Callable[[], bool]:
        """Return a condition that holds once another message is recorded."""
        seen = self._observed + self._acted
        return lambda: self._observed + self._acted > seen

    @property
    def complete(self) -> bool:
        """All steps were observed and acted in."""
        return self._observed == self._batch.horizon + 1 and self._acted == self._batch.horizon

    @property
    def awaited(self) -> str:
        """The node that has to speak next."""
        return "policy" if self._acted < self._observed else "simulator"

    def observe(self, message: Observation) -> None:
        """Record the next observation of the batch; any other is ignored."""
        if (message.batch, message.step) == (self._identity, self._observed):
            self.recorder.observed(message.step, frame_of(message, self._dims[0]))
            self._observed += 1

    def act(self, message: Action) -> None:
        """Record the next action of the batch by the right policy; any other is ignored."""
        if (message.batch, message.step, message.policy_version) == (self._identity, self._acted, self._version):
            self.recorder.acted(message.step, matrix(message.actions, self._batch.rows, self._dims[1], "actions"))
            self._acted += 1


def learn(node: LearnerNode) -> None:
    """Run the whole training of a learner node."""
    config = node.connect()
    run_training(config, node, Path(node.output) if node.output else None, quiet=node.quiet)


def main() -> None:
    """Run the learner node."""
    run(LearnerNode, learn)


if __name__ == "__main__":
    main()
