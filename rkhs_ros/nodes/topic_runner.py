"""Episodes collected over topics, with batches that are begun anew where a node died or stalled."""

from __future__ import annotations

import json
import time
from functools import reduce
from itertools import count
from operator import add

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.nodes.names import namespaces
from rkhs_ros.nodes.peers import Peers
from rkhs_ros.nodes.policy_link import PolicyLink
from rkhs_ros.nodes.simulator_link import SimulatorLink
from rkhs_ros.nodes.spin import PeerError, ReportingNode
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import Environment

IDLE_CHECK_S = 0.5  # without episodes before the peers are looked after


class TopicRunner:
    """Lets policies act in simulator nodes; a `Runner` to the training loop.

    Owns the numbers of the batches, the steps that the simulators' clocks have counted, and when there was progress.
    Does not own the environment, the policy in service or the steps of a batch: it hears whole episodes, so that a step
    costs one message each way between simulator and policy node. Brings peers back that died: what one of them no
    longer knows begins anew, and comes out the same to the last bit.

    Args:
        node: the learner node.
        peers: how it calls others.
        simulators: number of simulator nodes.
        rows: of the batches to come, for which the simulators are to make room.
    """

    def __init__(self, node: ReportingNode, peers: Peers, simulators: int, rows: int) -> None:
        self._node = node
        self._peers = peers
        # No result depends on the numbers; no other learner, and not this one started again, uses the same ones.
        self._identities = count(time.time_ns())
        self._clock_steps = 0
        self._progress_at = 0.0  # monotonic time, seconds
        refuse = node.diagnostics.refuse
        self._simulators = [SimulatorLink(node, peers, place, rows, refuse) for place in namespaces(simulators)]
        self._policy = PolicyLink(node, peers)

    def connect(self) -> Environment:
        """Wait for simulators and policy node, and return the task.

        Raises:
            PeerError: one of them does not appear in time, or the simulators have different tasks.
        """
        for simulator in self._simulators:
            simulator.wait()
        self._policy.wait()
        for simulator in self._simulators:
            simulator.connect()
        task = self._simulators[0].task
        for simulator in self._simulators:
            other = simulator.task
            if (other.environment, other.options) != (task.environment, task.options):
                raise PeerError(f"expected all simulators of one task, got {other.environment} from {simulator.name}")
        self._clock_steps = max(simulator.task.clock for simulator in self._simulators)
        self.spaces = self._simulators[0].spaces
        return Environment(task.environment, json.loads(task.options), task.rows_at_once)

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy, as many at a time as the simulators have room for.

        Raises:
            PeerError: a node did not answer in time, or there was one of the learner's name before.
            ValueError: a node refused the policy or the batch.
        """
        self._policy.serve(policy)
        room = sum(simulator.task.room for simulator in self._simulators)
        return reduce(add, (self._together(policy, part) for part in batch.parts(room)))

    def report(self) -> dict[str, object]:
        """Return what is to be reported of policy and batches."""
        batches = " ".join(str(simulator.request.batch) for simulator in self._simulators)
        steps = " ".join(str(simulator.step) for simulator in self._simulators)
        return {"serving version": self._policy.version, "batch": batches, "step": steps}

    def _together(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch that there is room for."""
        for simulator in self._simulators:
            simulator.mark_idle()
        self._begin(list(zip(self._simulators, batch.split(len(self._simulators)), strict=False)))
        self._progress_at = time.monotonic()
        while not self._peers.spin(self._complete, IDLE_CHECK_S):
            self._recover(policy)
        self._node.diagnostics.stuck = ""
        self._node.diagnostics.steps += batch.horizon
        return reduce(add, (simulator.episodes for simulator in self._simulators if simulator.episodes is not None))

    def _complete(self) -> bool:
        return not any(simulator.busy for simulator in self._simulators)

    def _begin(self, parts: list[tuple[SimulatorLink, Batch]]) -> None:
        """Have simulators begin batches side by side."""
        for simulator, batch in parts:
            simulator.begin(batch, next(self._identities), self._policy.version, self._clock_steps)
        self._clock_steps += max(batch.horizon for _, batch in parts)

    def _recover(self, policy: GaussianPolicy) -> None:
        """Ask again for what may have been lost, and begin anew what a node that died no longer knows."""
        policy_is_new = self._policy.push(policy)
        for simulator in self._simulators:
            if simulator.busy and simulator.batch is not None:
                self._recover_batch(simulator, simulator.batch, policy_is_new)
        if not (self._complete() or self._peers.check_progress(self._progress_at, "no simulator makes a step")):
            raise self._peers.silent("policy", "acted in no step")

    def _recover_batch(self, simulator: SimulatorLink, batch: Batch, policy_is_new: bool) -> None:
        task, now = simulator.describe(), time.monotonic()
        moved = simulator.moved(task)
        if policy_is_new or simulator.lost(task):
            self._node.get_logger().warning(f"the batch of the {simulator.name} node begins anew")
            self._begin([(simulator, batch)])
            self._progress_at = now
        elif moved:
            self._progress_at = now
        elif self._peers.stalled(self._progress_at):
            self._begin([(simulator, batch)])  # for reasons that are not known
        else:
            simulator.ask_for_episodes()
