"""Serve a policy to a simulator: a session answers its observations, batch by batch."""

from dataclasses import dataclass
from typing import NamedTuple

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import require
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class ServedPolicy:
    """The policy that is being served.

    Attributes:
        policy: the policy.
        version: its unique number.
        explores: whether it explores in batches that request exploration; otherwise it always uses the mean.
    """

    policy: GaussianPolicy
    version: int
    explores: bool = True


class Observation(NamedTuple):
    """The observations of a batch of episodes before its next step.

    Attributes:
        identity: number of the batch.
        version: version of the policy that the batch expects.
        step: index of the next step, from 0.
        batch: the episodes.
        observations: shape (num_envs, d), in the units of the task.
        over: whether all episodes are over, so that no action is needed.
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
        step: index of the step.
        actions: shape (num_envs, n), in the units of the task.
    """

    identity: int
    version: int
    step: int
    actions: Array


@dataclass(frozen=True)
class BatchOver:
    """Reply to the last observation of a batch, which needs no action."""


@dataclass(frozen=True)
class Ignored:
    """Reply to an observation of another batch or policy; the reason names what was expected."""

    reason: str


@dataclass(frozen=True)
class Failed:
    """Reply if the policy cannot act on an observation of its batch, with the reason."""

    reason: str


Reply = Answer | BatchOver | Ignored | Failed


class Serving(NamedTuple):
    """A batch that is being served: the policy that acts in it, and the last answer."""

    acting: Acting
    last: Answer


class Session:
    """A session between one simulator and the policy.

    The session is idle until the first step of a batch arrives. It then serves the batch that started last. One policy
    serves all steps of a batch, in order.
    """

    def __init__(self) -> None:
        self._serving: Serving | None = None  # idle

    @property
    def last(self) -> Answer | None:
        """Last answer; None while idle."""
        return None if self._serving is None else self._serving.last

    def answer(self, observation: Observation, served: ServedPolicy | None) -> Reply:
        """Return the reply to an observation.

        The session does not change if the observation is ignored, or if the policy fails.

        Args:
            observation: the observation from the simulator.
            served: the policy for batches that start now; None if there is none yet.
        """
        serving = self._serving
        try:
            if observation.step == 0 and served is not None and observation.version == served.version:
                return self._begin(observation, served)
            if serving is not None and _names(observation) == _names(serving.last):
                return self._go_on(observation, serving)
        except (ValueError, RunError) as error:
            return Failed(str(error))
        batch, version = serving.last.identity if serving else 0, served.version if served else 0
        return Ignored(
            f"expected batch {batch} or step 0 of a new one, policy version {version}, "
            f"got batch {observation.identity}, step {observation.step}, policy version {observation.version}"
        )

    def _begin(self, observation: Observation, served: ServedPolicy) -> Answer:
        """Start a batch; if the policy fails at its first step, the session stays with the previous batch."""
        batch = observation.batch
        acting = Acting(served.policy, batch, explore=batch.explore and served.explores)
        answer = _act(acting, observation)
        self._serving = Serving(acting, answer)
        return answer

    def _go_on(self, observation: Observation, serving: Serving) -> Reply:
        batch, step, awaited = serving.acting.batch, observation.step, serving.last.step + 1
        if observation.batch is not batch and observation.batch != batch:
            raise ValueError(f"batch {observation.identity}: expected {batch}, got {observation.batch}")
        require(step == awaited, "step", f"{awaited}, the next one", step)
        if observation.over:
            return BatchOver()
        require(step < batch.horizon, "step", f"less than {batch.horizon} unless all episodes are over", step)
        answer = _act(serving.acting, observation)
        self._serving = Serving(serving.acting, answer)
        return answer


def _names(value: Observation | Answer) -> tuple[int, int]:
    return value.identity, value.version


def _act(acting: Acting, observation: Observation) -> Answer:
    actions = acting(observation.step, observation.observations)
    return Answer(observation.identity, observation.version, observation.step, actions)
