"""A session serves each batch with one policy, step by step, and never answers an observation out of order."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import settings, strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, precondition, rule

from rkhs_ros.base.endings import RunError
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.serving import OtherBatchError, Place, ServedPolicy, Session
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF

COLUMNS = 2


def policy(seed: int, history: int = 1) -> GaussianPolicy:
    rng, inputs = np.random.default_rng(seed), Inputs(history=history)
    d = inputs.dimension(COLUMNS, 1)
    return GaussianPolicy(
        Function(RBF((2.0,)), rng.normal(size=(4, d)), rng.normal(size=(4, 1))), ConstantVariance(np.ones(1)), inputs
    )


def shown(batch: Batch, number: int, step: int, columns: int = COLUMNS) -> np.ndarray:
    return np.random.default_rng([number, step]).normal(size=(batch.num_envs, columns))


def acted(served: ServedPolicy, number: int, batch: Batch, step: int) -> np.ndarray:
    """Return the actions of a policy that runs all steps of a batch in order."""
    acting = Acting(served.policy, batch, explore=batch.explore and served.explores)
    return [acting(k, shown(batch, number, k)) for k in range(step + 1)][-1]


class AnyOrder(RuleBasedStateMachine):
    """A simulator that sends arbitrary observations and a learner that changes the policy at any time."""

    places = Bundle("places")

    def __init__(self) -> None:
        super().__init__()
        self.session = Session()
        self.served = ServedPolicy(policy(0), version=0)
        self.policies = {0: self.served}  # by version
        self.batches: dict[int, Batch] = {}  # by number

    @rule(seed=st.integers(0, 9), history=st.integers(1, 3), explores=st.booleans())
    def serve_another_policy(self, seed: int, history: int, explores: bool) -> None:
        version = len(self.policies)
        self.served = self.policies[version] = ServedPolicy(policy(seed, history), version, explores)

    @rule(target=places, rows=st.integers(1, 3), horizon=st.integers(1, 6), explore=st.booleans())
    def show_a_new_batch(self, rows: int, horizon: int, explore: bool) -> Place:
        return self.new(Batch(7, 3, rows, horizon, explore), self.served.version, 0)

    @rule(target=places, version=st.integers(0, 5), step=st.integers(0, 2))
    def show_a_new_batch_of_another_policy_or_from_its_middle(self, version: int, step: int) -> Place:
        return self.new(Batch(7, 3, 2, 4, explore=True), version, step)

    def new(self, batch: Batch, version: int, step: int) -> Place:
        number = len(self.batches) + 1
        self.batches[number] = batch
        return self.show(Place(number, version, step))

    @precondition(lambda self: self.session.last != Place())
    @rule(target=places, ahead=st.sampled_from([1, 1, 1, 2, 0, -1]))
    def show_the_batch_under_way(self, ahead: int) -> Place:
        last = self.session.last
        horizon = self.batches[last.batch].horizon
        return self.show(last._replace(step=min(max(last.step + ahead, 1), horizon)))

    @rule(place=places)
    def show_again(self, place: Place) -> None:
        self.show(place)

    @rule(place=places, name=st.sampled_from(["version", "batch", "columns"]))
    def show_something_else(self, place: Place, name: str) -> None:
        batch = self.batches[place.batch]
        if (name == "batch" and place.step == 0) or (name == "columns" and self.is_over(place)):
            return  # any first step may start a batch; the columns are not used at the end
        before, observed = self.session.last, shown(batch, place.batch, place.step, COLUMNS + (name == "columns"))
        wrong = place._replace(version=99) if name == "version" else place
        batch = replace(batch, seed=8) if name == "batch" else batch
        with pytest.raises(ValueError, match="expected"):
            self.session.answer(wrong, batch, observed, self.served, over=self.is_over(place))
        assert self.session.last is before

    def is_over(self, place: Place) -> bool:
        """Return whether all episodes are over before a step; every other batch ends early."""
        return place.step >= max(1, self.batches[place.batch].horizon - place.batch % 2)

    def show(self, place: Place) -> Place:
        before, batch, over = self.session.last, self.batches[place.batch], self.is_over(place)
        observed, is_first = shown(batch, place.batch, place.step), place.step == 0
        starts, goes_on = is_first and place.version == self.served.version, place[:2] == before[:2]
        if not starts and (not goes_on or place.step != before.step + 1):
            with pytest.raises(ValueError, match="expected") as refused:
                self.session.answer(place, batch, observed, self.served, over=over)
            assert isinstance(refused.value, OtherBatchError) is not goes_on
            assert self.session.last is before
            return place
        actions = self.session.answer(place, batch, observed, self.served, over=over)
        assert (actions is None) == over
        assert self.session.last is (before if over else place)
        if actions is not None:
            np.testing.assert_array_equal(actions, acted(self.policies[place.version], place.batch, batch, place.step))
        return place


AnyOrder.TestCase.settings = settings(max_examples=30, stateful_step_count=40)
TestAnyOrder = AnyOrder.TestCase

BATCH = Batch(seed=3, first_episode=5, num_envs=2, horizon=4, explore=True)
SERVED = ServedPolicy(policy(0), version=1)


def test_a_failing_start_keeps_the_previous_batch_running() -> None:
    session, observed = Session(), np.repeat(SERVED.policy.mean.centres[:1], 2, axis=0)
    session.answer(Place(1, 1, 0), BATCH, shown(BATCH, 1, 0), SERVED)
    loud = SERVED.policy.with_mean(replace(SERVED.policy.mean, weights=np.full((4, 1), 1e308)))
    with pytest.raises(ValueError, match="points: expected"):
        session.answer(Place(2, 2, 0), BATCH, observed[:, :1], ServedPolicy(policy(1, history=2), 2))
    with pytest.raises(RunError, match="expected finite numbers"):
        session.answer(Place(3, 2, 0), BATCH, observed, ServedPolicy(loud, 2))
    actions = session.answer(Place(1, 1, 1), BATCH, shown(BATCH, 1, 1), ServedPolicy(loud, 2))
    np.testing.assert_array_equal(actions, acted(SERVED, 1, BATCH, 1))
