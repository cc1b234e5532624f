"""Serving a policy: a session answers what one simulator shows, one policy from a batch's first step to its last."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from rkhs_ros.base.endings import RunError
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

REMEMBERED_BATCHES = 64  # that were begun, so that their late messages do not begin them again


@dataclass(frozen=True)
class ServedPolicy:
    """The policy in service.

    Attributes:
        policy: the policy.
        version: its number, which no other policy has.
        explores: whether it explores in the batches that ask for it; otherwise it always acts by its mean.
    """

    policy: GaussianPolicy
    version: int
    explores: bool = True


class Observation(NamedTuple):
    """What a batch of episodes shows before its next step.

    Attributes:
        identity: number of the batch.
        version: version of the policy that is to act in it.
        step: the step about to be made, from 0.
        batch: the episodes.
        observations: shape (rows, d), in the units of the task.
        over: whether all episodes are over, so that no action is asked for.
    """

    identity: int
    version: int
    step: int
    batch: Batch
    observations: Array
    over: bool = False


class Answer(NamedTuple):
    """The actions of a step.

    Attributes:
        identity: number of the batch.
        version: version of the policy that acted.
        step: the step they are of.
        actions: shape (rows, n), in the units of the task.
    """

    identity: int
    version: int
    step: int
    actions: Array


@dataclass(frozen=True)
class BatchOver:
    """The batch is over: no action is asked for."""


@dataclass(frozen=True)
class Ignored:
    """The observation came late, early or for another policy; the reason says what was expected."""

    reason: str


@dataclass(frozen=True)
class Refused:
    """The observation cannot be answered; the reason says why."""

    reason: str


@dataclass(frozen=True)
class Failed:
    """The policy cannot act in the batch; the reason says where."""

    reason: str


Reply = Answer | BatchOver | Ignored | Refused | Failed


class Serving(NamedTuple):
    """A batch being served.

    Attributes:
        acting: the policy as it acts in the batch.
        last: the last answer.
        awaited: the first step without an answer.
    """

    acting: Acting
    last: Answer
    awaited: int


class Session:
    """One simulator's session with the policy.

    It is idle until it is shown the first step of a batch, and from then on serves the batch that began last. A batch
    is served by one policy from its first step to its last, no step left out; one that was left is not begun again, as
    its messages may come late.

    Owns the batch being served, and the numbers of those begun.
    """

    def __init__(self) -> None:
        self._serving: Serving | None = None  # idle
        self._begun: deque[int] = deque(maxlen=REMEMBERED_BATCHES)

    @property
    def last(self) -> Answer | None:
        """The last answer; None while idle."""
        return None if self._serving is None else self._serving.last

    def answer(self, observation: Observation, served: ServedPolicy | None) -> Reply:
        """Return the answer to an observation; a duplicate is answered alike.

        What is ignored or refused, or where the policy fails, leaves the session as it was.

        Args:
            observation: what the simulator shows.
            served: the policy in service, which acts in the batches that begin now; None where there is none yet.
        """
        serving = self._serving
        new = observation.step == 0 and observation.identity not in self._begun
        try:
            if new and served is not None and observation.version == served.version:
                return self._begin(observation, served)
            if serving is not None and _names(observation) == _names(serving.last):
                return self._go_on(observation, serving)
        except ValueError as error:
            return Refused(str(error))
        except RunError as error:
            return Failed(str(error))
        batch, version = serving.last.identity if serving else 0, served.version if served else 0
        return Ignored(
            f"expected batch {batch} or step 0 of a new one, policy version {version}, "
            f"got batch {observation.identity}, step {observation.step}, policy version {observation.version}"
        )

    def _begin(self, observation: Observation, served: ServedPolicy) -> Answer:
        """Begin a batch; the one before is left only once the policy has an answer to what this one shows."""
        batch = observation.batch
        acting = Acting(served.policy, batch, explore=batch.explore and served.explores)
        answer = _act(acting, observation)
        self._serving = Serving(acting, answer, awaited=1)
        self._begun.append(observation.identity)
        return answer

    def _go_on(self, observation: Observation, serving: Serving) -> Reply:
        batch, step = serving.acting.batch, observation.step
        if observation.batch is not batch and observation.batch != batch:
            raise ValueError(f"batch {observation.identity}: expected {batch}, got {observation.batch}")
        if step > serving.awaited:
            raise ValueError(f"step: expected at most {serving.awaited}, the next one, got {step}")
        if observation.over:
            return BatchOver()
        if step >= batch.horizon:
            raise ValueError(f"step: expected less than {batch.horizon}, unless all is over, got {step}")
        if step == serving.last.step:
            return serving.last
        answer = _act(serving.acting, observation)
        self._serving = Serving(serving.acting, answer, max(serving.awaited, step + 1))
        return answer


def _names(value: Observation | Answer) -> tuple[int, int]:
    return value.identity, value.version


def _act(acting: Acting, observation: Observation) -> Answer:
    actions = acting(observation.step, observation.observations)
    return Answer(observation.identity, observation.version, observation.step, actions)
