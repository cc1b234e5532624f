"""Collection of episodes over topics, with the learner's client of the policy node."""

from collections import deque
from functools import partial

from rkhs_interfaces import msg
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.base.endings import RunError
from rkhs_ros.learning.episodes import Episodes, Record, discard
from rkhs_ros.nodes.core.peers import Peers, fresh_number
from rkhs_ros.nodes.core.spin import ReportingNode
from rkhs_ros.nodes.lockstep.simulator_link import SIMULATOR, FinishedBatch, SimulatorLink, discard_reason
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.messages import policy_message
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import Environment

MAX_DISCARDS = 10  # of one episode of a robot in a row, after which the run ends
CHECK_S = 1.0  # without episodes before the simulator is asked whether it still answers
POLICY = "policy"


class TopicRunner:
    """Runs policies in a simulator node; a `Runner` for the training loop.

    It receives whole episodes, so that a step costs one message each way between simulator and policy node. If a robot
    discards an episode, the runner requests it again under the same number. Any other fault ends the run, which can be
    resumed. Owns the clients of simulator and policy node, the policy in service and its version.
    """

    def __init__(self, node: ReportingNode, peers: Peers, num_envs: int, kind: str = SIMULATOR) -> None:
        self._node = node
        self._peers = peers
        self.record: Record = discard  # called with each batch that has ended
        self._simulator = SimulatorLink(node, peers, "", num_envs, kind)
        self._set_policy = node.create_client(SetPolicy, "set_policy")
        self._policy: GaussianPolicy | None = None
        self._version = 0

    def connect(self, environment: Environment | None = None) -> Environment:
        """Wait for simulator and policy node, and return the environment; see `SimulatorLink.connect`."""
        if environment is None:
            self._node.get_logger().info("no environment is set: using that of the simulator")
        connected = self._simulator.connect(environment)
        self._peers.wait_for_service(self._set_policy, POLICY)
        self.spaces = self._simulator.spaces
        return connected

    @property
    def is_robot(self) -> bool:
        """Whether episodes run on a robot, so that they cannot be reproduced."""
        return self._simulator.is_robot

    def heartbeat(self) -> float:
        """Send due heartbeats to a robot; return the seconds until the next one."""
        return self._simulator.heartbeat()

    def report(self) -> dict[str, object]:
        """Return the diagnostics values of policy and batch."""
        return {"serving version": self._version, "batch": self._simulator.request.batch}

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy, run in parallel up to the simulator's capacity."""
        with self._peers.stop.interrupting(False):  # the executor loses exceptions of signal handlers
            return self._collected(policy, batch)

    def _collected(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        self._serve(policy)
        parts = deque(batch.parts(self._simulator.task.capacity))
        done: dict[Batch, Episodes] = {}
        try:
            while parts:
                part = parts.popleft()
                done[part] = self._completed(part)
                self._node.diagnostics.steps += part.horizon
                while self._simulator.vetoed:
                    parts.append(vetoed := self._simulator.vetoed.pop())
                    del done[vetoed]
        finally:
            self._record_ended()  # even if the run is stopped, because it may be resumed
        self._simulator.release()
        if self.is_robot:  # the next version tells the robot node that these can no longer be vetoed
            self._policy = None
        return Episodes.concatenate(done[part] for part in sorted(done, key=lambda part: part.first_episode))

    def _serve(self, policy: GaussianPolicy) -> None:
        """Send a policy to the policy node, unless the node serves it already."""
        if policy is not self._policy:
            version = fresh_number()
            request = SetPolicy.Request(policy=policy_message(msg, policy, version))
            ask = partial(self._peers.call, self._set_policy, request, POLICY, repeatable=True)
            self._peers.call_until_accepted(ask, POLICY)
            self._policy, self._version = policy, version

    def _completed(self, batch: Batch) -> Episodes:
        """Run a batch within the capacity until it is complete, again whenever a robot discards it."""
        reason = ""
        for _ in range(MAX_DISCARDS):
            finished = self._finished(batch)
            if not (reason := discard_reason(finished)):
                return finished.episodes
        number = batch.first_episode + 1  # people count from 1
        raise RunError(f"episode {number} was discarded {MAX_DISCARDS} times in a row; the last reason: {reason}")

    def _finished(self, batch: Batch) -> FinishedBatch:
        """Run a batch within the capacity until it ends."""
        simulator = self._simulator
        simulator.begin(batch, self._version, timeout=self._peers.timeout_s)
        while simulator.finished is None:
            if not self._peers.spin(lambda: bool(simulator.ended or simulator.finished or simulator.failure), CHECK_S):
                simulator.check()
            self._record_ended()
            if simulator.failure is not None:
                raise simulator.failure
        return simulator.finished

    def _record_ended(self) -> None:
        """Record the episodes that have ended, including those that were discarded or vetoed."""
        for finished in self._simulator.ended:
            self.record(*finished)
        self._simulator.ended.clear()
