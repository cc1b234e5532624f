"""Episodes collected over topics, with batches that are begun anew where a node died or stalled."""

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

WORTH_TELLING_S = 1.0  # that an episode of a slow simulator takes longer than the quickest's
IDLE_CHECK_S = 0.5  # without episodes before the peers are looked after
UNKNOWN = repeat(BatchProgress())  # of a policy node that says nothing
MOST_ATTEMPTS = 5  # at a batch that comes no further, as a node dies at the same step each time


class TopicRunner:
    """Lets policies act in simulator nodes; a `Runner` to the training loop.

    Owns the steps that the simulators' clocks have counted, and when there was progress. Does not own the environment,
    the policy in service or the steps of a batch: it hears whole episodes, so that a step costs one message each way
    between simulator and policy node. Brings peers back that died: what one of them no longer knows begins anew, and
    comes out the same to the last bit. So it does where another policy acted. What was asked of one of several
    simulators that falls silent, the others make. A discarded episode of a robot is requested again, under the same
    number.

    Args:
        node: the learner node.
        peers: how it calls others.
        simulators: number of simulator nodes.
        rows: of the batches to come, for which the simulators are to make room.
        kind: what their nodes are called, simulator or robot, until they tell themselves.

    Attributes:
        record: is told of each simulator's batch when all have ended.
    """

    def __init__(self, node: ReportingNode, peers: Peers, simulators: int, rows: int, kind: str = SIMULATOR) -> None:
        self._node = node
        self._peers = peers
        self.record: Record = discard
        self._clock_steps = 0
        self._discarded: list[Batch] = []  # finished ones, which are to run again
        self._progress_at = 0.0  # monotonic time, seconds
        refuse = node.diagnostics.refuse
        self._simulators = [SimulatorLink(node, peers, place, rows, refuse, kind) for place in namespaces(simulators)]
        self._policy = PolicyLink(node, peers, several=simulators > 1)

    def connect(self, environment: Environment | None = None) -> Environment:
        """Wait for simulators and policy node, and return the environment.

        Args:
            environment: that the simulators must have; that of the first one where None.

        Raises:
            PeerError: one of them does not appear in time, or a simulator has another environment.
        """
        for simulator in self._simulators:
            simulator.wait()
        self._policy.wait()
        if environment is None:
            self._node.get_logger().info("no environment is given: that of the first simulator is learnt in")
        first, *others = self._simulators
        environment = first.connect(environment)
        for simulator in others:
            simulator.connect(environment)
        self._clock_steps = max(simulator.task.clock for simulator in self._simulators)
        self.spaces = self._simulators[0].spaces
        return environment

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments, at most those of the batches to come, can run side by side."""
        return min(num_envs, sum(simulator.task.capacity for simulator in self._simulators))

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy, as many at a time as the simulators have room for.

        Raises:
            PeerError: a node did not answer in time, there was one of the learner's name before, or episodes in which
                another policy acted came again and again.
            RunError: the environment failed, the policy's actions are not finite, or a node dies again and again.
            ValueError: a node refused the policy or the batch.
        """
        self._policy.serve(policy)
        try:
            done = self._in_parts(policy, batch)
        finally:
            self._record_vetoes()  # also if the run is stopped: it may be resumed
        for simulator in self._simulators:
            simulator.forget_finished()
        return Episodes.concatenate(
            done[part] for part in sorted(done, key=lambda part: (not part.explore, part.first_episode))
        )

    def _in_parts(self, policy: GaussianPolicy, batch: Batch) -> dict[Batch, Episodes]:
        """Return the episodes of a batch by the batches of the simulators, part after part."""
        parts = deque([batch])
        done: dict[Batch, Episodes] = {}
        while parts:
            self._look_around()
            whole = parts.popleft()
            part, *rest = whole.parts(sum(self._shares(whole.num_envs)))
            parts.extendleft(reversed(rest))
            done |= self._together(policy, part)
            parts.extend([*self._take_discarded(done), *self._left_over()])
        return done

    @property
    def is_of_robots(self) -> bool:
        """Whether the wall clock ends the steps: what is recorded then cannot be had again."""
        return any(simulator.is_robot for simulator in self._simulators)

    def heartbeat(self) -> float:
        """Give robots the signs of life that are due; return the seconds until the next one."""
        return min(simulator.heartbeat() for simulator in self._simulators)

    def _left_over(self) -> list[Batch]:
        """Return what simulators that fell silent had been asked for."""
        return [each.batch for each in self._simulators if each.is_gone and each.batch is not None]

    def _record_vetoes(self) -> None:
        """Record which finished episodes a person discarded since; they are to run again."""
        for simulator in self._simulators:
            for ended in simulator.vetoed:
                self._report_discarded(ended)
                self._discarded.append(ended.batch)
            simulator.vetoed.clear()

    def _take_discarded(self, done: dict[Batch, Episodes]) -> list[Batch]:
        """Remove the discarded episodes from those that are done, and return their batches."""
        self._record_vetoes()
        discarded, self._discarded = self._discarded, []
        for batch in discarded:
            del done[batch]
        return discarded

    def report(self) -> dict[str, object]:
        """Return what is to be reported of policy and batches."""
        batches = " ".join(str(simulator.request.batch) for simulator in self._simulators)
        steps = " ".join(str(simulator.step) for simulator in self._simulators)
        return {"serving version": self._policy.version, "batch": batches, "step": steps}

    def _look_around(self) -> None:
        """Make all simulators ready for a batch, and look whether one that fell silent is back."""
        for simulator in self._simulators:
            simulator.mark_idle()
            if simulator.is_gone and simulator.answers():
                simulator.is_gone = False
                self._node.get_logger().warning(f"the {simulator.name} node is back")

    def _shares(self, rows: int) -> list[int]:
        """Return how many rows each simulator that is there is to make side by side, by how quick they were."""
        there = self._there
        return share(rows, [each.task.capacity for each in there], [each.timing.seconds for each in there])

    @property
    def _there(self) -> list[SimulatorLink]:
        return [simulator for simulator in self._simulators if not simulator.is_gone]

    def _together(self, policy: GaussianPolicy, batch: Batch) -> dict[Batch, Episodes]:
        """Return the episodes of a batch that there is room for, by the batches of the simulators."""
        counts = self._shares(batch.num_envs)
        asked = list(compress(self._there, counts))
        for simulator in self._there:
            if simulator not in asked:
                self._leave_out(simulator, min(each.timing.seconds for each in asked))
        self._begin(list(zip(asked, batch.shared(list(filter(None, counts))), strict=True)))
        self._progress_at = time.monotonic()
        while not self._complete():
            if self._peers.spin(self._has_news, IDLE_CHECK_S):
                self._record_vetoes()
                self._rerun_discarded()
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

    def _leave_out(self, simulator: SimulatorLink, quickest: float) -> None:
        """Have the others make a simulator's episodes for a while, of which is told once if it is a slow one."""
        timing = simulator.timing
        if timing.is_new and timing.seconds > quickest + WORTH_TELLING_S:
            times = f"{timing.seconds / quickest:.1f} times as long for an episode as the quickest"
            self._node.get_logger().warning(f"the {simulator.name} node takes {times}: the others make its episodes")
        timing.left_out()

    def _has_news(self) -> bool:
        return self._complete() or any(simulator.discarded or simulator.vetoed for simulator in self._simulators)

    def _rerun_discarded(self) -> None:
        """Ask robots again for the episodes that were discarded.

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
                number = ended.batch.first_episode
                raise RunError(
                    f"episode {number} was discarded {simulator.discards} times in a row, the last time: {reason}"
                )
            self._begin([(simulator, ended.batch)])
            self._progressed(simulator)

    def _report_discarded(self, ended: FinishedBatch) -> str:
        """Record an episode that does not count, tell of it, and return why."""
        self.record(*ended)
        reason = next(execution.discard_reason for execution in ended.executions if execution.discard_reason)
        self._node.diagnostics.publish_event(DISCARDED_EPISODE, f"episode {ended.batch.first_episode}: {reason}")
        return reason

    def _complete(self) -> bool:
        return not any(simulator.busy for simulator in self._simulators)

    def _begin(self, parts: list[tuple[SimulatorLink, Batch]]) -> None:
        """Have simulators begin batches side by side."""
        for simulator, batch in parts:
            with self._others_at_hand(simulator):
                simulator.begin(batch, self._policy.policy, self._policy.version, self._clock_steps)
        self._clock_steps += max(batch.horizon for _, batch in parts)

    def _recover(self, policy: GaussianPolicy) -> None:
        """Ask again for what may have been lost, and begin anew what a node that died no longer knows."""
        policy_is_new = self._policy.push(policy)
        for simulator, answered in zip(self._simulators, chain(self._policy.progress, UNKNOWN), strict=False):
            if simulator.busy and simulator.batch is not None:
                with self._others_at_hand(simulator):
                    self._recover_batch(simulator, simulator.batch, answered, policy_is_new)
        stuck = f"no {ROBOT if self._simulators[0].is_robot else SIMULATOR} makes a step"
        if not (self._complete() or self._peers.check_progress(self._progress_at, stuck)):
            raise self._peers.silent("policy", "acted in no step")

    @contextmanager
    def _others_at_hand(self, simulator: SimulatorLink) -> Iterator[None]:
        """Have others make a simulator's episodes where it falls silent meanwhile; a robot may still move.

        Raises:
            PeerError: there are no others.
        """
        try:
            yield
        except SilentError as error:
            simulator.is_gone = True
            if simulator.is_robot or all(each.is_gone for each in self._simulators):
                raise
            self._node.get_logger().warning(f"{error}: the others make its episodes")
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
            self._begin_anew(simulator, batch, POLICY if policy_is_new else simulator.name)
            self._progressed(simulator)
        elif further:
            self._progressed(simulator)
        elif simulator.busy and simulator.refusal:
            self._take_again(simulator, batch)
            self._progressed(simulator)
        elif self._peers.stalled(self._progress_at) or not simulator.ask_again():
            self._begin([(simulator, batch)])  # for reasons not known, or since somebody began another of its number

    def _progressed(self, simulator: SimulatorLink) -> None:
        """Note that there was progress now, and that the next is to be expected after a period of a robot."""
        self._progress_at = time.monotonic() + simulator.task.period

    def _begin_anew(self, simulator: SimulatorLink, batch: Batch, died: str) -> None:
        if simulator.attempts >= MOST_ATTEMPTS:
            raise RunError(f"the {died} node died {simulator.attempts} times at the same place; {simulator.place}")
        text = f"the batch of the {simulator.name} node begins anew"
        self._node.get_logger().info(text)
        self._node.diagnostics.publish_event(RESTART, f"{text}, as the {died} node died")
        self._begin([(simulator, batch)])

    def _take_again(self, simulator: SimulatorLink, batch: Batch) -> None:
        """Have a batch begin anew whose episodes were refused, and say who may have sent them.

        Raises:
            PeerError: they were refused too often.
        """
        topics = (f"{simulator.namespace}{topic}" for topic in ("observation", "action", "episodes"))
        publishers = f"publishers of {'; '.join(listed(self._node, topic) for topic in topics)}"
        if simulator.attempts >= MOST_ATTEMPTS:
            times = f"{simulator.attempts} times"
            raise PeerError(f"the {simulator.name} node sent wrong episodes {times}: {simulator.refusal}; {publishers}")
        self._node.get_logger().warning(f"the batch of the {simulator.name} node begins anew; {publishers}")
        self._begin([(simulator, batch)])
