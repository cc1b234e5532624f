"""A simulator or a robot that is stepped from a process which is no node of a run."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import rclpy
from numpy.typing import ArrayLike
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.signals import SignalHandlerOptions

from rkhs_interfaces.msg import Action, BatchProgress, Observation
from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import finite_array, require, truncated
from rkhs_ros.nodes.core.diagnostics import Diagnostics
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, observations_of
from rkhs_ros.nodes.core.names import fresh_number
from rkhs_ros.nodes.core.peers import Peers
from rkhs_ros.nodes.core.spin import PeerError, ReportingNode
from rkhs_ros.nodes.core.transport import LAST_DOMAIN, by_udp
from rkhs_ros.nodes.lockstep.simulator_link import MAX_DISCARDS, SimulatorLink
from rkhs_ros.policies.messages import doubles
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.env_batch import CONTINUE_EPISODE, Flags

IDLE_CHECK_S = 0.5  # without an observation before the world is looked after
RESEND_S = 0.02  # after an action was sent, before it is taken for lost


class RemoteStep(NamedTuple):
    """What the rows of a world show after a reset or a step.

    Attributes:
        observations: shape (rows, d); the last one of rows whose episode is over.
        rewards: of the step just made, shape (rows,); 0 after a reset.
        terminated: True in rows whose episode the task ended, shape (rows,).
        truncated: True in rows whose episode was cut off, shape (rows,).
        discard_reason: why the episode of a robot counts for nothing; empty where it counts.
    """

    observations: Array
    rewards: Array
    terminated: Flags
    truncated: Flags
    discard_reason: str = ""


class RemoteNode(ReportingNode):
    """The node by which a world is stepped; it has a context of its own, beside what else the process may be.

    Owns the link to the world.

    Args:
        namespace: the world's.
        domain: ROS domain; that of the environment where None.
        timeout: seconds after which a silent world is given up.
        rows: of its batches.
    """

    def __init__(self, namespace: str, domain: int | None, timeout: float, rows: int) -> None:
        context, place = Context(), namespace.strip("/")
        with _by_udp():
            rclpy.init(args=[], context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
            try:
                super().__init__("remote", context=context, namespace=f"/{place}")
            except NameValidationException as error:
                context.try_shutdown()
                raise ValueError(f"namespace: expected one of ROS, got {truncated(repr(namespace))}") from error
        self.diagnostics = Diagnostics(self, 0, self._report, ["observation"])
        self.peers = Peers(self, timeout)
        self.link = SimulatorLink(self, self.peers, f"/{place}/" if place else "", rows, self.diagnostics.refuse)

    def heartbeat(self) -> float:
        """Report, and give a robot signs of life; return the seconds until more is due."""
        return min(self.diagnostics.heartbeat(), self.link.heartbeat())

    def close(self) -> None:
        """Leave nothing behind."""
        if self.context.ok():
            self.peers.close()
            self.destroy_node()
            self.context.try_shutdown()

    def _report(self) -> dict[str, object]:
        return {"batch": self.link.request.batch, "step": self.link.step}


class RemoteSimulation:
    """The rows of a simulator or a robot, reset and stepped from here in the place of learner and policy node.

    Owns the node, the step that the rows are at and the action that was sent last. A message that was lost is sent
    again; a world that died takes the episodes under way with it, and is used again from the next reset on.

    Args:
        rows: side by side.
        namespace: of the simulator or robot node.
        domain: ROS domain; that of the environment where None.
        timeout: seconds after which a silent world is given up.
        horizon: steps of an episode; what the world says where None.

    Attributes:
        task: as the world describes it.
        spaces: of the task.

    Raises:
        PeerError: nobody answers in time.
        ValueError: an argument is out of range, or the world does not fit.
    """

    def __init__(
        self,
        rows: int = 1,
        *,
        namespace: str = "",
        domain: int | None = None,
        timeout: float = 10.0,
        horizon: int | None = None,
    ) -> None:
        good = domain is None or (type(domain) is int and 0 <= domain <= LAST_DOMAIN)
        require(good, "domain", f"a whole number from 0 to {LAST_DOMAIN}", repr(domain))
        require(isinstance(timeout, int | float) and timeout > 0, "timeout", "seconds > 0", repr(timeout))
        self._rows = rows
        self._session, self._version, self._episodes = fresh_number(), fresh_number(), 0
        self._heard: dict[int, RemoteStep] = {}  # by the step, until it is asked for
        self._sent: Action | None = None  # last
        self._sent_at = 0.0  # monotonic time, seconds
        self._last: RemoteStep | None = None  # that was returned
        self._shown = -1  # its step
        self._over = True
        self._node = RemoteNode(namespace, domain, timeout, rows)
        self._link, self._peers = self._node.link, self._node.peers
        try:
            self._actions = self._node.create_publisher(Action, "action", LOCKSTEP_QOS)
            self._node.create_subscription(Observation, "observation", self._hear, LOCKSTEP_QOS)
            self._link.wait()
            self._environment = self._link.connect(None)
            self.task, self.spaces = self._link.task, self._link.spaces
            require(rows <= self.task.capacity, f"{self._link.name}: rows", f"at most {self.task.capacity}", rows)
            self._horizon = self.task.horizon if horizon is None else horizon
            require(self._horizon > 0, "horizon", f"the steps of an episode, as {self.task.environment} has none", 0)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the node; nothing is left of it."""
        self._node.close()

    def reset(self, seeds: Sequence[int]) -> RemoteStep:
        """Begin episodes, and return what the rows show.

        Args:
            seeds: seeds for the resets, one per environment; `CONTINUE_STREAM` resets an environment without a seed,
                `CONTINUE_EPISODE` continues its episode. Robots ignore seeds.

        Raises:
            PeerError: the world does not answer in time, has another task than before, or lost the episodes to be kept.
            RunError: the environment failed.
            ValueError: the world refuses.
        """
        self._link.connect(self._environment)
        for _ in range(MAX_DISCARDS):
            self._begin(seeds)
            seen = self._awaited(0)
            if not seen.discard_reason:
                return seen
        raise RunError(
            f"the {self._link.name} node could not begin an episode {MAX_DISCARDS} times: {seen.discard_reason}"
        )

    def step(self, actions: ArrayLike) -> RemoteStep:
        """Make a step in the rows whose episode goes on, with actions of shape (rows, n), and return what they show.

        Where a robot's episode is discarded, it is cut off, with its last observation once more and a reward of 0.

        Raises:
            PeerError: the world does not answer in time, or lost the episodes.
            RunError: the environment failed, or no reset went before.
            ValueError: the actions are misshapen or not finite.
        """
        if self._over:
            raise RunError("step: expected a reset before it, got none since the episodes were over or lost")
        good = finite_array(actions, (self._rows, self.spaces.action_dim), "action")
        step, request = self._link.step, self._link.request
        self._sent = Action(
            batch=request.batch, policy_version=request.policy_version, step=step, actions=doubles(good)
        )
        self._send()
        self._link.step = step + 1
        return self._awaited(step + 1)

    def _begin(self, seeds: Sequence[int]) -> None:
        self._over, self._sent, self._last, self._shown = True, None, None, -1
        self._heard.clear()
        self._link.mark_idle()
        self._link.forget_finished()
        batch = Batch(self._session, self._episodes, self._rows, self._horizon, explore=False)
        self._episodes += self._rows
        try:
            self._link.begin(batch, None, self._version, self.task.clock, seeds)
        except ValueError as error:
            if CONTINUE_EPISODE in seeds:
                raise PeerError(f"the {self._link.name} node lost the episodes under way: {error}") from error
            raise

    def _send(self) -> None:
        if self._sent is not None:
            self._actions.publish(self._sent)
            self._sent_at = time.monotonic()

    def _hear(self, message: Observation) -> None:
        link = self._link
        expected = (link.request.batch, link.request.policy_version)
        if link.batch is None or (message.batch, message.policy_version) != expected or message.step in self._heard:
            return
        if message.step <= self._shown:
            self._send_again(message.step)
            return
        try:
            self._heard[message.step] = _seen(message, link.batch)
        except ValueError as error:
            self._node.diagnostics.refuse(f"an observation: {error}")

    def _send_again(self, step: int) -> None:
        """Send the action of a step again that the world still waits for, as it may have been lost."""
        given = self._sent is not None and self._sent.step == step
        if given and time.monotonic() > self._sent_at + RESEND_S:
            self._send()

    def _awaited(self, step: int) -> RemoteStep:
        """Return what the rows show at a step, once it is there."""
        heard, link = self._heard, self._link
        try:
            progress_at = time.monotonic() + self.task.period
            while not self._peers.spin(lambda: step in heard or link.discarded is not None, IDLE_CHECK_S):
                progress_at = self._look_after(step, progress_at)
        except RunError:
            self._over = True
            raise
        seen = heard.pop(step) if step in heard else self._discarded_step()
        self._last, self._shown = seen, step
        self._over = bool((seen.terminated | seen.truncated).all())
        return seen

    def _discarded_step(self) -> RemoteStep:
        """Return what stands for the step, or the reset, in which a robot's episode was discarded."""
        executions = self._link.discarded.executions if self._link.discarded else []
        reason = next(execution.discard_reason for execution in executions if execution.discard_reason)
        seen = self._last
        observations = np.zeros((self._rows, self.spaces.observation_dim)) if seen is None else seen.observations
        no, yes = np.zeros(self._rows, dtype=bool), np.ones(self._rows, dtype=bool)
        return RemoteStep(observations, np.zeros(self._rows), no, yes, reason)

    def _look_after(self, step: int, progress_at: float) -> float:
        """Ask for what may have been lost; return the monotonic time of the last progress.

        Raises:
            PeerError: the world is silent, or lost the episodes.
            RunError: the environment failed.
        """
        link = self._link
        task = link.describe()
        link.check(task, BatchProgress())
        link.report_waiting(task.waiting)
        if link.lost(task):
            raise PeerError(
                f"the {link.name} node lost the episodes in step {step}: it was started again, "
                "or somebody else had it begin others"
            )
        if task.resetting:
            return time.monotonic()
        self._send()
        link.ask_again()
        if not self._peers.check_progress(progress_at, f"the {link.name} node makes no step"):
            raise self._peers.silent(link.name, f"made no step {step}")
        return progress_at


def _seen(message: Observation, batch: Batch) -> RemoteStep:
    """Return what an observation shows.

    Raises:
        ValueError: it is misshapen or not finite.
    """
    flags = np.zeros((2, batch.num_envs), dtype=bool)
    for row, rows in zip(flags, (message.terminated, message.truncated), strict=True):
        require(
            all(each < batch.num_envs for each in rows), "rows that are over", f"below {batch.num_envs}", list(rows)
        )
        row[list(rows)] = True
    observations = observations_of(message, batch)
    rewards = np.array(message.rewards) if message.step else np.zeros(batch.num_envs)
    return RemoteStep(observations, rewards, *flags)


@contextmanager
def _by_udp() -> Iterator[None]:
    """Have what is opened meanwhile reach others as the nodes do, and leave the environment as it was."""
    before = dict(os.environ)
    os.environ.update(by_udp(before))
    try:
        yield
    finally:
        for name in set(os.environ) - set(before):
            del os.environ[name]
        os.environ.update(before)
