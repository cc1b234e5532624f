"""Client for stepping a simulator or robot node from a process outside a run."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import rclpy
from numpy.typing import ArrayLike
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.signals import SignalHandlerOptions

from rkhs_interfaces.msg import Action, Observation
from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import finite_array, require, truncated
from rkhs_ros.nodes.core.diagnostics import Diagnostics
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, observations_of
from rkhs_ros.nodes.core.names import fresh_number
from rkhs_ros.nodes.core.peers import Peers
from rkhs_ros.nodes.core.spin import PeerError, ReportingNode
from rkhs_ros.nodes.core.transport import LAST_DOMAIN, by_udp
from rkhs_ros.nodes.lockstep.simulator_link import MAX_DISCARDS, SimulatorLink, discard_reason
from rkhs_ros.policies.messages import doubles
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.env_batch import CONTINUE_EPISODE, Flags

IDLE_CHECK_S = 0.5  # without an observation before the progress is checked


class RemoteStep(NamedTuple):
    """Result of a reset or a step of all environments.

    Attributes:
        observations: shape (num_envs, d); for ended episodes the last one.
        rewards: of the last step, shape (num_envs,); 0 after a reset.
        terminated: whether the task ended the episode, shape (num_envs,).
        truncated: whether the episode was cut off, shape (num_envs,).
        discard_reason: why the episode of a robot is discarded; empty if it is valid.
    """

    observations: Array
    rewards: Array
    terminated: Flags
    truncated: Flags
    discard_reason: str = ""


class RemoteNode(ReportingNode):
    """The client's node, with a ROS context of its own, so that the process may have other nodes.

    Owns the link to the simulator or robot node.

    Args:
        namespace: of the simulator or robot node.
        domain: ROS domain; None for ROS_DOMAIN_ID.
        timeout: seconds after which a silent node is an error.
        num_envs: environments per batch.
        hear: callback for observations.
    """

    def __init__(
        self, namespace: str, domain: int | None, timeout: float, num_envs: int, hear: Callable[[Observation], None]
    ) -> None:
        context, place = Context(), namespace.strip("/")
        with _by_udp():
            rclpy.init(args=[], context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
            try:
                super().__init__("remote", context=context, namespace=f"/{place}")
            except NameValidationException as error:
                context.try_shutdown()
                raise ValueError(f"namespace: expected a ROS namespace, got {truncated(repr(namespace))}") from error
        self.diagnostics = Diagnostics(self, lambda: {"batch": self.link.request.batch}, ["observation"])
        self.peers = Peers(self, timeout)
        self.actions = self.create_publisher(Action, "action", LOCKSTEP_QOS)
        self.create_subscription(Observation, "observation", hear, LOCKSTEP_QOS)  # before the link's clients, see there
        self.link = SimulatorLink(self, self.peers, f"/{place}/" if place else "", num_envs)

    def heartbeat(self) -> float:
        """Publish the status, and heartbeats to a robot, if due; return the seconds until the next ones."""
        return min(self.diagnostics.heartbeat(), self.link.heartbeat())

    def close(self) -> None:
        """Destroy the node and its context."""
        if self.context.ok():
            self.peers.close()
            self.destroy_node()
            self.context.try_shutdown()


class RemoteSimulation:
    """A client that resets and steps the environments of a simulator or robot node.

    It replaces the learner and policy nodes of a run. Owns the node and the current step. If the remote node dies, its
    episodes are lost; the next reset can use a restarted node.

    Args:
        num_envs: parallel environments.
        namespace: of the simulator or robot node.
        domain: ROS domain; None for ROS_DOMAIN_ID.
        timeout: seconds after which a silent node is an error.
        horizon: steps per episode; None for that of the environment.

    Attributes:
        task: the node's description of its task.
        spaces: of the task.

    Raises:
        SilentError: no node answers in time.
        ValueError: an argument is out of range, or the node's task does not match.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        namespace: str = "",
        domain: int | None = None,
        timeout: float = 10.0,
        horizon: int | None = None,
    ) -> None:
        good = domain is None or (type(domain) is int and 0 <= domain <= LAST_DOMAIN)
        require(good, "domain", f"a whole number from 0 to {LAST_DOMAIN}", repr(domain))
        require(isinstance(timeout, int | float) and timeout > 0, "timeout", "seconds > 0", repr(timeout))
        self._num_envs = num_envs
        self._session, self._version, self._episodes = fresh_number(), fresh_number(), 0
        self._heard: RemoteStep | None = None  # the result of the step, until it is returned
        self._last: RemoteStep | None = None  # the last returned result
        self._step = 0  # the awaited or the last one
        self._over = True
        self._node = RemoteNode(namespace, domain, timeout, num_envs, self._hear)
        self._link, self._peers = self._node.link, self._node.peers
        try:
            self._environment = self._link.connect(None)
            self.task, self.spaces = self._link.task, self._link.spaces
            most = self.task.capacity
            require(num_envs <= most, f"{self._link.name}: num_envs", f"at most {most}", num_envs)
            self._horizon = self.task.horizon if horizon is None else horizon
            expected = f"a number of steps (required because {self.task.environment} has no horizon of its own)"
            require(self._horizon > 0, "horizon", expected, self._horizon)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Destroy the node and its context."""
        self._node.close()

    def reset(self, seeds: Sequence[int]) -> RemoteStep:
        """Start episodes, and return the first observations.

        Args:
            seeds: of each environment; `CONTINUE_STREAM` resets it without a seed, `CONTINUE_EPISODE` continues its
                episode. A robot ignores them.

        Raises:
            SilentError: the node does not answer in time.
            PeerError: it has another task than before, or lost the episodes to continue.
            RunError: the environment failed.
            ValueError: the node refuses the request.
        """
        self._link.connect(self._environment)
        for _ in range(MAX_DISCARDS):
            self._begin(seeds)
            result = self._awaited()
            if not result.discard_reason:
                return result
        raise RunError(
            f"the {self._link.name} node could not start an episode {MAX_DISCARDS} times: {result.discard_reason}"
        )

    def step(self, actions: ArrayLike) -> RemoteStep:
        """Make a step with actions of shape (num_envs, n) in the environments whose episode has not ended.

        If a robot's episode is discarded, it is truncated with its last observation and a reward of 0.

        Raises:
            SilentError: the node does not answer or step in time, for example because another client uses it.
            RunError: the environment failed, or there was no reset.
            ValueError: the actions have the wrong shape or are not finite.
        """
        if self._over:
            raise RunError("step: expected a reset first, because the episodes have ended or were lost")
        good = finite_array(actions, (self._num_envs, self.spaces.action_dim), "action")
        request = self._link.request
        names = {"batch": request.batch, "policy_version": request.policy_version, "step": self._step}
        self._node.actions.publish(Action(**names, actions=doubles(good)))
        self._step += 1
        return self._awaited()

    def _begin(self, seeds: Sequence[int]) -> None:
        self._over, self._heard, self._last, self._step = True, None, None, 0
        self._link.release()
        batch = Batch(self._session, self._episodes, self._num_envs, self._horizon, explore=False)
        self._episodes += self._num_envs
        try:
            self._link.begin(batch, self._version, seeds=seeds)
        except ValueError as error:
            if CONTINUE_EPISODE in seeds:
                raise PeerError(f"the {self._link.name} node lost the running episodes: {error}") from error
            raise

    def _hear(self, message: Observation) -> None:
        request, batch = self._link.request, self._link.batch
        expected = (request.batch, request.policy_version, self._step)
        if batch is None or (message.batch, message.policy_version, message.step) != expected:
            return
        try:
            self._heard = _step_of(message, batch)
        except ValueError as error:
            self._node.diagnostics.refuse(f"observation: {error}")

    def _awaited(self) -> RemoteStep:
        """Wait for the result of the step, and return it."""
        link, begin = self._link, time.monotonic()
        try:
            while not self._peers.spin(self._has_result, IDLE_CHECK_S):
                link.check()
                has_limit = self._step > 0 or not link.is_robot  # an operator may take any time to prepare a robot
                if has_limit and time.monotonic() > begin + self.task.period + self._peers.timeout_s:
                    raise self._peers.silent(link.name, f"made no step {self._step}")
        except RunError:
            self._over = True
            raise
        result, self._heard = self._heard or self._discarded_step(), None
        self._last = result
        self._over = bool((result.terminated | result.truncated).all())
        return result

    def _has_result(self) -> bool:
        """Return whether the step has a result, or the episode was discarded; raise RunError if the batch failed."""
        finished = self._link.finished
        self._link.raise_failure()
        return self._heard is not None or (finished is not None and bool(discard_reason(finished)))

    def _discarded_step(self) -> RemoteStep:
        """Return the result of the step or reset in which a robot's episode was discarded."""
        reason = discard_reason(self._link.finished) if self._link.finished else ""
        result = self._last
        observations = (
            np.zeros((self._num_envs, self.spaces.observation_dim)) if result is None else result.observations
        )
        no, yes = np.zeros(self._num_envs, dtype=bool), np.ones(self._num_envs, dtype=bool)
        return RemoteStep(observations, np.zeros(self._num_envs), no, yes, reason)


def _step_of(message: Observation, batch: Batch) -> RemoteStep:
    """Return the result in an observation message.

    Raises:
        ValueError: the shape is wrong, an index is out of range, or a value is not finite.
    """
    flags = np.zeros((2, batch.num_envs), dtype=bool)
    for mask, indices in zip(flags, (message.terminated, message.truncated), strict=True):
        good = all(index < batch.num_envs for index in indices)
        require(good, "ended environments", f"indices below {batch.num_envs}", list(indices))
        mask[list(indices)] = True
    observations = observations_of(message, batch)
    rewards = np.array(message.rewards) if message.step else np.zeros(batch.num_envs)
    return RemoteStep(observations, rewards, *flags)


@contextmanager
def _by_udp() -> Iterator[None]:
    """Use the nodes' transport settings inside the context, and restore the environment afterwards."""
    before = dict(os.environ)
    os.environ.update(by_udp(before))
    try:
        yield
    finally:
        for name in set(os.environ) - set(before):
            del os.environ[name]
        os.environ.update(before)
