"""A running simulator or robot node as the Gymnasium environment ``rkhs/Remote-v0``, for learners elsewhere."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.error import DependencyNotInstalled
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import finite_array, missing_ros, require
from rkhs_ros.policies.messages import doubles
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

try:
    from rkhs_interfaces.msg import Action, Observation
    from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, observations_of
    from rkhs_ros.nodes.core.peers import ClientNode, fresh_number
    from rkhs_ros.nodes.core.transport import LAST_DOMAIN
    from rkhs_ros.nodes.lockstep.simulator_link import SimulatorLink, discard_reason
except ImportError as error:
    got = missing_ros() or error
    raise DependencyNotInstalled(f"rkhs/Remote-v0: expected ROS 2 Jazzy and the built interfaces, got {got}") from error

Values = NDArray[np.floating[Any]]
Info = dict[str, Any]
IDLE_CHECK_S = 0.5  # without an observation before the progress is checked


class _Result(NamedTuple):
    """The result of a reset or a step: the observation, shape (d,), and what `gymnasium.Env.step` returns with it."""

    observation: Array
    reward: float
    terminated: bool
    truncated: bool
    discard_reason: str = ""  # of a robot's episode


class RemoteNode(ClientNode):
    """The client's node; it owns the link to the simulator or robot node."""

    def __init__(self, namespace: str, domain: int | None, timeout: float, hear: Callable[[Observation], None]) -> None:
        place = namespace.strip("/")
        super().__init__("remote", timeout, namespace=namespace, domain=domain, report=self._report)
        self.actions = self.create_publisher(Action, "action", LOCKSTEP_QOS)
        self.create_subscription(Observation, "observation", hear, LOCKSTEP_QOS)  # before the link's clients, see there
        self.link = SimulatorLink(self, self.peers, f"/{place}/" if place else "", num_envs=1)

    def heartbeat(self) -> float:
        """Publish the status, and heartbeats to a robot, if due; return the seconds until the next ones."""
        return min(super().heartbeat(), self.link.heartbeat())

    def _report(self) -> dict[str, object]:
        return {"batch": self.link.request.batch}


class RemoteEnv(gymnasium.Env[Any, Any]):
    """The environment of a simulator node, or a robot behind its gate.

    It replaces the learner and policy nodes of a run. Owns the node and the current step. If the remote node dies, its
    episode is lost; the next reset can use a restarted node. If a robot's episode is discarded, its last step is
    truncated and has the reward 0 and the entry ``discard_reason`` in its info.

    Args:
        namespace: of the simulator or robot node.
        domain: ROS domain; None for ROS_DOMAIN_ID.
        timeout: seconds after which a silent node is an error.
        horizon: steps per episode; None for that of the environment.
        render_mode: None; the node renders nothing.

    Raises:
        SilentError: no node answers in time.
        ValueError: an argument is out of range, or the node's task does not match.
    """

    metadata: Info = {"render_modes": []}

    def __init__(
        self,
        *,
        namespace: str = "",
        domain: int | None = None,
        timeout: float = 10.0,
        horizon: int | None = None,
        render_mode: None = None,
    ) -> None:
        good = domain is None or (type(domain) is int and 0 <= domain <= LAST_DOMAIN)
        require(good, "domain", f"a whole number from 0 to {LAST_DOMAIN}", repr(domain))
        require(isinstance(timeout, int | float) and timeout > 0, "timeout", "seconds > 0", repr(timeout))
        self.render_mode = render_mode
        self._session, self._episodes = fresh_number(), 0
        self._heard: _Result | None = None  # the result of the step, until it is returned
        self._last: _Result | None = None  # the last returned result
        self._step = 0  # the awaited or the last one
        self._over = True
        self._node = RemoteNode(namespace, domain, timeout, self._hear)
        self._link, self._peers = self._node.link, self._node.peers
        try:
            self._environment = self._link.connect(None)
            task = self._link.task
            self._horizon = task.horizon if horizon is None else horizon
            expected = f"a number of steps (required because {task.environment} has no horizon of its own)"
            require(self._horizon > 0, "horizon", expected, self._horizon)
            self.observation_space, self.action_space = self._spaces()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection and release its resources."""
        self._node.close()

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Values, Info]:
        """Start an episode; without a seed, ``np_random`` draws one for the environment. A robot ignores it."""
        good = seed is None or 0 <= seed < 2**63
        require(good, "seed", "a number in [0, 2^63)", seed)
        require(not options, "options", "none, since the node cannot receive them", ", ".join(options or {}))
        super().reset(seed=seed)
        given = int(self.np_random.integers(2**31)) if seed is None else int(seed)
        self._link.connect(self._environment)
        self._begin(given)
        result = self._awaited()
        if result.discard_reason:
            raise RunError(f"the {self._link.name} node could not start an episode: {result.discard_reason}")
        return self._shaped(result), {}

    def step(self, action: ArrayLike) -> tuple[Values, float, bool, bool, Info]:
        """Make one step."""
        if self._over:
            raise RunError("step: expected a reset first, because the episode has ended or was lost")
        good = finite_array(np.reshape(action, (1, -1)), (1, self._link.spaces.action_dim), "action")
        request = self._link.request
        names = {"batch": request.batch, "policy_version": request.policy_version, "step": self._step}
        self._node.actions.publish(Action(**names, actions=doubles(good)))
        self._step += 1
        result = self._awaited()
        info = {"discard_reason": result.discard_reason} if result.discard_reason else {}
        return self._shaped(result), result.reward, result.terminated, result.truncated, info

    def _spaces(self) -> tuple[Box, Box]:
        """Return the observation and action spaces; missing bounds of observations are infinite."""
        task, spaces = self._link.task, self._link.spaces
        shape, kind = spaces.observation_shape, np.dtype(task.observation_type or "float64")
        bounds = [np.array(bound, dtype=kind) for bound in (task.observation_low, task.observation_high)]
        if all(bound.size == spaces.observation_dim for bound in bounds):
            low, high = (bound.reshape(shape) for bound in bounds)
        else:
            low, high = np.full(shape, -np.inf, kind), np.full(shape, np.inf, kind)
        actions = Box(spaces.action_low, spaces.action_high, dtype=spaces.action_low.dtype.type)
        return Box(low, high, dtype=kind.type), actions

    def _shaped(self, result: _Result) -> Values:
        space = self.observation_space
        return result.observation.reshape(space.shape or ()).astype(space.dtype)

    def _begin(self, seed: int) -> None:
        self._over, self._heard, self._last, self._step = True, None, None, 0
        self._link.release()
        batch = Batch(self._session, self._episodes, 1, self._horizon, explore=False)
        self._episodes += 1
        self._link.begin(batch, fresh_number(), seeds=[seed])

    def _hear(self, message: Observation) -> None:
        request, batch = self._link.request, self._link.batch
        expected = (request.batch, request.policy_version, self._step)
        if batch is None or (message.batch, message.policy_version, message.step) != expected:
            return
        try:
            (observation,) = observations_of(message, batch)
        except ValueError as error:
            self._node.diagnostics.refuse(f"observation: {error}")
            return
        reward = float(message.rewards[0]) if message.step else 0.0
        self._heard = _Result(observation.copy(), reward, len(message.terminated) > 0, len(message.truncated) > 0)

    def _awaited(self) -> _Result:
        link, begin = self._link, time.monotonic()
        try:
            while not self._peers.spin(self._has_result, IDLE_CHECK_S):
                link.check()
                has_limit = self._step > 0 or not link.is_robot  # an operator may take any time to prepare a robot
                if has_limit and time.monotonic() > begin + link.task.period + self._peers.timeout_s:
                    raise self._peers.silent(link.name, f"made no step {self._step}")
        except RunError:
            self._over = True
            raise
        if (result := self._heard) is None:  # a robot's episode was discarded
            reason = discard_reason(link.finished) if link.finished else ""
            last = np.zeros(link.spaces.observation_dim) if self._last is None else self._last.observation
            result = _Result(last, 0.0, terminated=False, truncated=True, discard_reason=reason)
        self._heard, self._last, self._over = None, result, result.terminated or result.truncated
        return result

    def _has_result(self) -> bool:
        """Return whether the step has a result, or the episode was discarded; raise RunError if it failed."""
        finished = self._link.finished
        if self._link.failure is not None:
            raise self._link.failure
        return self._heard is not None or (finished is not None and bool(discard_reason(finished)))
