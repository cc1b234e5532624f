"""Collection of episodes over topics; restarts batches if a node dies or stalls."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain, compress, repeat

from rkhs_interfaces.msg import BatchProgress
from rkhs_ros.base.endings import RunError
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.execution import Record, discard, record_kinds
from rkhs_ros.nodes.core.diagnostics import DISCARDED_EPISODE, RESTART
from rkhs_ros.nodes.core.names import namespaces
from rkhs_ros.nodes.core.peers import Peers, SilentError
from rkhs_ros.nodes.core.publishers import listed
from rkhs_ros.nodes.core.spin import PeerError, ReportingNode
from rkhs_ros.nodes.lockstep.policy_link import NAME as POLICY
from rkhs_ros.nodes.lockstep.policy_link import PolicyLink
from rkhs_ros.nodes.lockstep.simulator_link import MAX_DISCARDS, ROBOT, SIMULATOR, FinishedBatch, SimulatorLink
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.batch_sharing import share
from rkhs_ros.runs.config import Environment

SLOW_S = 1.0  # by which an episode of a slow simulator must exceed that of the fastest to be logged
IDLE_CHECK_S = 0.5  # without episodes before the peers are checked
UNKNOWN = repeat(BatchProgress())  # of a policy node that reports no progress
MOST_ATTEMPTS = 5  # at a batch without progress, for example if a node dies at the same step each time


class TopicRunner:
    """Runs policies in simulator nodes; a `Runner` for the training loop.

    Owns the steps counted by the simulators' clocks, and the time of the last progress. It receives whole episodes, so
    that a step costs one message each way between simulator and policy node.

    If a node dies or another policy acted, the runner restarts the batch, with bit-identical results. If one of several
    simulators falls silent, the others run its episodes. If a robot discards an episode, the runner requests it again
    under the same number.

    Args:
        node: the learner node.
        peers: the learner's calls to other nodes.
        simulators: number of simulator nodes.
        num_envs: number of environments of the coming batches; the simulators report their capacity for it.
        kind: assumed kind of the nodes, `SIMULATOR` or `ROBOT`, until they describe themselves.

    Attributes:
        record: callback for each simulator's batch, after all have ended.
    """

    def __init__(
        self, node: ReportingNode, peers: Peers, simulators: int, num_envs: int, kind: str = SIMULATOR
    ) -> None:
        self._node = node
        self._peers = peers
        self.record: Record = discard
        self._clock_steps = 0
        self._discarded: list[Batch] = []  # completed batches that were vetoed and must run again
        self._progress_at = 0.0  # monotonic time, seconds
        refuse = node.diagnostics.refuse
        places = namespaces(simulators)
        self._simulators = [SimulatorLink(node, peers, place, num_envs, refuse, kind) for place in places]
        self._policy = PolicyLink(node, peers, several=simulators > 1)

    def connect(self, environment: Environment | None = None) -> Environment:
        """Wait for simulators and policy node, and return the environment.

        Args:
            environment: the required environment of the simulators; None for that of the first one.

        Raises:
            PeerError: a node does not appear in time, or a simulator has another environment.
        """
        for simulator in self._simulators:
            simulator.wait()
        self._policy.wait()
        if environment is None:
            self._node.get_logger().info("no environment is set: using that of the first simulator")
        first, *others = self._simulators
        environment = first.connect(environment)
        for simulator in others:
            simulator.connect(environment)
        self._clock_steps = max(simulator.task.clock for simulator in self._simulators)
        self.spaces = self._simulators[0].spaces
        return environment

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments, up to the size of the coming batches, can run in parallel."""
        return min(num_envs, sum(simulator.task.capacity for simulator in self._simulators))

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy, run in parallel up to the simulators' capacity.

        Raises:
            PeerError: a node did not answer in time, an older node has the learner's name, or episodes in which another
                policy acted arrive repeatedly.
            RunError: the environment failed, the policy's actions are not finite, or a node dies repeatedly.
            ValueError: a node refused the policy or the batch.
        """
        self._policy.serve(policy)
        try:
            done = self._in_parts(policy, batch)
        finally:
            self._record_vetoes()  # even if the run is stopped, because it may be resumed
        for simulator in self._simulators:
            simulator.clear_finished()
        return Episodes.concatenate(
            done[part] for part in sorted(done, key=lambda part: (not part.explore, part.first_episode))
        )

    def _in_parts(self, policy: GaussianPolicy, batch: Batch) -> dict[Batch, Episodes]:
        """Return the episodes of a batch, run part by part, keyed by the simulators' batches."""
        parts = deque([batch])
        done: dict[Batch, Episodes] = {}
        while parts:
            self._prepare_simulators()
            whole = parts.popleft()
            part, *rest = whole.parts(sum(self._shares(whole.num_envs)))
            parts.extendleft(reversed(rest))
            done |= self._together(policy, part)
            parts.extend([*self._take_discarded(done), *self._left_over()])
        return done

    @property
    def is_robot(self) -> bool:
        """Whether episodes run on a robot, so that they cannot be reproduced."""
        return any(simulator.is_robot for simulator in self._simulators)

    def heartbeat(self) -> float:
        """Send due heartbeats to robots; return the seconds until the next one."""
        return min(simulator.heartbeat() for simulator in self._simulators)

    def _left_over(self) -> list[Batch]:
        """Return the batches of simulators that have fallen silent."""
        return [each.batch for each in self._simulators if each.is_gone and each.batch is not None]

    def _record_vetoes(self) -> None:
        """Record episodes that the operator has vetoed after their completion; they will run again."""
        for simulator in self._simulators:
            for ended in simulator.vetoed:
                self._report_discarded(ended)
                self._discarded.append(ended.batch)
            simulator.vetoed.clear()

    def _take_discarded(self, done: dict[Batch, Episodes]) -> list[Batch]:
        """Remove vetoed episodes from those that are done, and return their batches."""
        self._record_vetoes()
        discarded, self._discarded = self._discarded, []
        for batch in discarded:
            del done[batch]
        return discarded

    def report(self) -> dict[str, object]:
        """Return the diagnostics values of policy and batches."""
        batches = " ".join(str(simulator.request.batch) for simulator in self._simulators)
        steps = " ".join(str(simulator.step) for simulator in self._simulators)
        return {"serving version": self._policy.version, "batch": batches, "step": steps}

    def _prepare_simulators(self) -> None:
        """Prepare all simulators for a batch, and check whether silent ones are back."""
        for simulator in self._simulators:
            simulator.mark_idle()
            if simulator.is_gone and simulator.answers():
                simulator.is_gone = False
                self._node.get_logger().warning(f"the {simulator.name} node is back")

    def _shares(self, num_envs: int) -> list[int]:
        """Return how many environments each available simulator runs in parallel, based on their timing."""
        available = self._available
        return share(num_envs, [each.task.capacity for each in available], [each.timing.seconds for each in available])

    @property
    def _available(self) -> list[SimulatorLink]:
        return [simulator for simulator in self._simulators if not simulator.is_gone]

    def _together(self, policy: GaussianPolicy, batch: Batch) -> dict[Batch, Episodes]:
        """Return the episodes of a batch within the capacity, keyed by the simulators' batches."""
        counts = self._shares(batch.num_envs)
        chosen = list(compress(self._available, counts))
        for simulator in self._available:
            if simulator not in chosen:
                self._exclude(simulator, min(each.timing.seconds for each in chosen))
        self._begin(list(zip(chosen, batch.shared(list(filter(None, counts))), strict=True)))
        self._progress_at = time.monotonic()
        while not self._complete():
            if self._peers.spin(self._has_news, IDLE_CHECK_S):
                self._record_vetoes()
                self._repeat_discarded()
            else:
                self._recover(policy)
        self._node.diagnostics.stuck = ""
        self._node.diagnostics.steps += batch.horizon
        done: dict[Batch, Episodes] = {}
        for each in self._simulators:
            if each.batch and each.episodes is not None:
                record_kinds(self.record, each.batch, each.episodes, each.executions)
                done[each.batch] = each.episodes
        return done

    def _exclude(self, simulator: SimulatorLink, quickest: float) -> None:
        """Leave a simulator's episodes to the others for a while; log this once if the simulator is slow."""
        timing = simulator.timing
        if timing.is_new and timing.seconds > quickest + SLOW_S:
            times = f"{timing.seconds / quickest:.1f} times as long for an episode as the fastest"
            self._node.get_logger().warning(f"the {simulator.name} node takes {times}: the others run its episodes")
        timing.left_out()

    def _has_news(self) -> bool:
        return self._complete() or any(simulator.discarded or simulator.vetoed for simulator in self._simulators)

    def _repeat_discarded(self) -> None:
        """Request discarded episodes again from robots.

        Raises:
            RunError: an episode was discarded too often.
        """
        for simulator in self._simulators:
            if simulator.discarded is None:
                continue
            ended = simulator.discarded
            reason = self._report_discarded(ended)
            simulator.discards += 1
            if simulator.discards >= MAX_DISCARDS:
                number = ended.batch.first_episode + 1  # people count from 1
                times = f"{simulator.discards} times in a row"
                raise RunError(f"episode {number} was discarded {times}; the last reason: {reason}")
            self._begin([(simulator, ended.batch)])
            self._progressed(simulator)

    def _report_discarded(self, ended: FinishedBatch) -> str:
        """Record a discarded episode, publish an event, and return the reason."""
        self.record(*ended)
        reason = next(execution.discard_reason for execution in ended.executions if execution.discard_reason)
        self._node.diagnostics.publish_event(DISCARDED_EPISODE, f"episode {ended.batch.first_episode}: {reason}")
        return reason

    def _complete(self) -> bool:
        return not any(simulator.busy for simulator in self._simulators)

    def _begin(self, parts: list[tuple[SimulatorLink, Batch]]) -> None:
        """Start batches in simulators, in parallel."""
        for simulator, batch in parts:
            with self._tolerating_silence(simulator):
                simulator.begin(batch, self._policy.policy, self._policy.version, self._clock_steps)
        self._clock_steps += max(batch.horizon for _, batch in parts)

    def _recover(self, policy: GaussianPolicy) -> None:
        """Request possibly lost messages again, and restart batches that a restarted node has lost."""
        policy_is_new = self._policy.push(policy)
        for simulator, answered in zip(self._simulators, chain(self._policy.progress, UNKNOWN), strict=False):
            if simulator.busy and simulator.batch is not None:
                with self._tolerating_silence(simulator):
                    self._recover_batch(simulator, simulator.batch, answered, policy_is_new)
        stuck = f"no {ROBOT if self._simulators[0].is_robot else SIMULATOR} makes a step"
        if not (self._complete() or self._peers.check_progress(self._progress_at, stuck)):
            raise self._peers.silent("policy", "acted in no step")

    @contextmanager
    def _tolerating_silence(self, simulator: SimulatorLink) -> Iterator[None]:
        """Let other simulators run a simulator's episodes if it falls silent in this context.

        Raises:
            PeerError: there are no others, or it is a robot, which may still move.
        """
        try:
            yield
        except SilentError as error:
            simulator.is_gone = True
            if simulator.is_robot or all(each.is_gone for each in self._simulators):
                raise
            self._node.get_logger().warning(f"{error}: the others run its episodes")
            self._progressed(simulator)

    def _recover_batch(
        self, simulator: SimulatorLink, batch: Batch, answered: BatchProgress, policy_is_new: bool
    ) -> None:
        further = simulator.advanced(answered.batch, answered.step + 1)
        task = simulator.describe()
        simulator.check(task, answered)
        simulator.report_waiting(task.waiting)
        further |= simulator.advanced(task.batch, task.step) or task.resetting
        if policy_is_new or simulator.lost(task):
            self._restart(simulator, batch, POLICY if policy_is_new else simulator.name)
            self._progressed(simulator)
        elif further:
            self._progressed(simulator)
        elif simulator.busy and simulator.refusal:
            self._repeat_refused(simulator, batch)
            self._progressed(simulator)
        elif self._peers.stalled(self._progress_at) or not simulator.ask_again():
            self._begin([(simulator, batch)])  # for unknown reasons, or because another client used its number

    def _progressed(self, simulator: SimulatorLink) -> None:
        """Record progress; expect the next one after a robot's period."""
        self._progress_at = time.monotonic() + simulator.task.period

    def _restart(self, simulator: SimulatorLink, batch: Batch, died: str) -> None:
        if simulator.attempts >= MOST_ATTEMPTS:
            raise RunError(f"the {died} node died {simulator.attempts} times at the same step; {simulator.place}")
        text = f"the batch of the {simulator.name} node restarts"
        self._node.get_logger().info(text)
        self._node.diagnostics.publish_event(RESTART, f"{text}, because the {died} node died")
        self._begin([(simulator, batch)])

    def _repeat_refused(self, simulator: SimulatorLink, batch: Batch) -> None:
        """Restart a batch whose episodes were refused, and log the nodes that may have sent them.

        Raises:
            PeerError: the episodes were refused too often.
        """
        topics = (f"{simulator.namespace}{topic}" for topic in ("observation", "action", "episodes"))
        publishers = f"publishers of {'; '.join(listed(self._node, topic) for topic in topics)}"
        if simulator.attempts >= MOST_ATTEMPTS:
            times = f"{simulator.attempts} times"
            raise PeerError(f"the {simulator.name} node sent wrong episodes {times}: {simulator.refusal}; {publishers}")
        self._node.get_logger().warning(f"the batch of the {simulator.name} node restarts; {publishers}")
        self._begin([(simulator, batch)])
