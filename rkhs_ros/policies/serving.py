"""Serve a policy to a simulator: a session answers its observations, batch by batch."""

from dataclasses import dataclass
from typing import NamedTuple

from rkhs_ros.base.validation import require
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array


class OtherBatchError(ValueError):
    """Raised for an observation of another batch or policy; the message names what was expected."""


@dataclass(frozen=True)
class ServedPolicy:
    """The policy that is being served."""

    policy: GaussianPolicy
    version: int  # unique
    explores: bool = True  # in batches that request exploration; otherwise it always uses the mean


class Place(NamedTuple):
    """A step of a batch."""

    batch: int = 0
    version: int = 0  # of the policy that the batch expects
    step: int = -1  # from 0


class Session:
    """A session between one simulator and the policy.

    The session is idle until the first step of a batch arrives. It then serves the batch that started last. One policy
    serves all steps of a batch, in order.

    Attributes:
        last: place of the last answer; ``Place()`` while idle.
    """

    def __init__(self) -> None:
        self.last = Place()
        self._acting: Acting | None = None  # idle

    def answer(
        self, place: Place, batch: Batch, observations: Array, served: ServedPolicy | None, *, over: bool = False
    ) -> Array | None:
        """Return the actions of a step, shape (num_envs, n), or None if all episodes of the batch are over.

        An error leaves the session with the batch before.

        Args:
            place: batch and step of the observations.
            batch: the episodes.
            observations: shape (num_envs, d), in the units of the task.
            served: the policy for batches that start now; None if there is none yet.
            over: whether all episodes are over.

        Raises:
            OtherBatchError: the place is neither the batch that is being served nor the first step of a new one.
            ValueError: the place or the observations do not fit the batch.
            RunError: an action is not finite.
        """
        last, acting, version = self.last, self._acting, served.version if served else 0
        if place.step == 0 and served is not None and place.version == version:
            acting = Acting(served.policy, batch, explore=batch.explore and served.explores)
        elif acting is not None and place[:2] == last[:2]:
            require(batch == acting.batch, f"batch {place.batch}", f"{acting.batch}", batch)
            require(place.step == last.step + 1, "step", f"{last.step + 1}, the next one", place.step)
            if over:
                return None
            expected = f"less than {batch.horizon} unless all episodes are over"
            require(place.step < batch.horizon, "step", expected, place.step)
        else:
            raise OtherBatchError(
                f"expected batch {last.batch} or step 0 of a new one, policy version {version}, "
                f"got batch {place.batch}, step {place.step}, policy version {place.version}"
            )
        actions = acting(place.step, observations)
        self.last, self._acting = place, acting
        return actions
