"""A session serves each batch with one policy, step by step, and never answers an observation out of order."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, precondition, rule

from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.serving import Answer, BatchOver, Failed, Ignored, Observation, Reply, ServedPolicy, Session
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


def shown(identity: int, version: int, step: int, batch: Batch) -> Observation:
    """Return the observation of a step, the same each time; every other batch ends early."""
    observed = np.random.default_rng([identity, step]).normal(size=(batch.num_envs, COLUMNS))
    over = step >= max(1, batch.horizon - identity % 2)
    return Observation(identity, version, step, batch, observed, over)


def acted(served: ServedPolicy, identity: int, batch: Batch, step: int) -> np.ndarray:
    """Return the actions of a policy that runs all steps of a batch in order."""
    acting = Acting(served.policy, batch, explore=batch.explore and served.explores)
    return [acting(k, shown(identity, 0, k, batch).observations) for k in range(step + 1)][-1]


class AnyOrder(RuleBasedStateMachine):
    """A simulator that sends arbitrary observations and a learner that changes the policy at any time."""

    observations = Bundle("observations")

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

    @rule(target=observations, rows=st.integers(1, 3), horizon=st.integers(1, 6), explore=st.booleans())
    def show_a_new_batch(self, rows: int, horizon: int, explore: bool) -> Observation:
        return self.show(self.new(Batch(7, 3, rows, horizon, explore), self.served.version, 0))

    @rule(target=observations, version=st.integers(0, 5), step=st.integers(0, 2))
    def show_a_new_batch_of_another_policy_or_from_its_middle(self, version: int, step: int) -> Observation:
        return self.show(self.new(Batch(7, 3, 2, 4, explore=True), version, step))

    @precondition(lambda self: self.session.last is not None)
    @rule(target=observations, ahead=st.sampled_from([1, 1, 1, 2, 0, -1]))
    def show_the_batch_under_way(self, ahead: int) -> Observation:
        last = self.session.last
        batch = self.batches[last.identity]
        return self.show(shown(last.identity, last.version, min(max(last.step + ahead, 1), batch.horizon), batch))

    def new(self, batch: Batch, version: int, step: int) -> Observation:
        identity = len(self.batches) + 1
        self.batches[identity] = batch
        return shown(identity, version, step, batch)

    @rule(observation=observations)
    def show_again(self, observation: Observation) -> None:
        self.show(observation)

    @rule(observation=observations, name=st.sampled_from(["version", "batch", "columns"]))
    def show_something_else(self, observation: Observation, name: str) -> None:
        other: dict[str, object] = {
            "version": 99,
            "batch": replace(observation.batch, seed=8),
            "columns": np.ones((observation.batch.num_envs, COLUMNS + 1)),
        }
        if name == "batch" and observation.step == 0:
            return  # any first step may start a batch
        if name == "columns" and observation.over:
            return  # not used
        field = "observations" if name == "columns" else name
        before = self.session.last
        reply = self.session.answer(observation._replace(**{field: other[name]}), self.served)
        assert isinstance(reply, Ignored | Failed)
        assert self.session.last is before

    def show(self, observation: Observation) -> Observation:
        identity, step = observation.identity, observation.step
        before, reply = self.session.last, self.session.answer(observation, self.served)
        if step == 0 and observation.version == self.served.version:
            assert isinstance(reply, Answer)
        elif before is None or (identity, observation.version) != (before.identity, before.version):
            assert isinstance(reply, Ignored)
        elif step != before.step + 1:
            assert isinstance(reply, Failed)
        else:
            assert isinstance(reply, BatchOver if observation.over else Answer)
        self.check(observation, reply, before)
        return observation

    def check(self, observation: Observation, reply: Reply, before: Answer | None) -> None:
        if not isinstance(reply, Answer):
            assert self.session.last is before
            return
        identity, step = observation.identity, observation.step
        assert (reply.identity, reply.step, reply.version) == (identity, step, observation.version)
        assert reply is self.session.last
        served = self.policies[reply.version]
        np.testing.assert_array_equal(reply.actions, acted(served, identity, observation.batch, step))


AnyOrder.TestCase.settings = settings(max_examples=30, stateful_step_count=40)
TestAnyOrder = AnyOrder.TestCase

BATCH = Batch(seed=3, first_episode=5, num_envs=2, horizon=4, explore=True)
SERVED = ServedPolicy(policy(0), version=1)


def test_an_idle_session_reports_what_it_expects() -> None:
    session = Session()
    reply = session.answer(shown(3, 1, 0, BATCH), None)
    expected = "expected batch 0 or step 0 of a new one, policy version 0, got batch 3, step 0, policy version 1"
    assert (reply, session.last) == (Ignored(expected), None)


@pytest.mark.parametrize("explores", [True, False])
def test_a_policy_without_exploration_uses_its_mean(explores: bool) -> None:
    first = shown(1, 1, 0, BATCH)
    reply = Session().answer(first, replace(SERVED, explores=explores))
    assert isinstance(reply, Answer)
    assert np.array_equal(reply.actions, SERVED.policy.mean(first.observations)) is not explores


def test_a_failing_start_keeps_the_previous_batch_running() -> None:
    session = Session()
    session.answer(shown(1, 1, 0, BATCH), SERVED)
    with np.errstate(over="ignore", invalid="ignore"):
        loud = replace(SERVED.policy.mean, weights=np.full((4, 1), 1e308))
        misfits = (policy(1, history=2), SERVED.policy.with_mean(loud))
        observed = np.repeat(SERVED.policy.mean.centres[:1], 2, axis=0)
        for identity, misfit in enumerate(misfits, start=2):
            observation = shown(identity, 2, 0, BATCH)._replace(
                observations=observed[:, : 1 if identity == 2 else None]
            )
            assert isinstance(session.answer(observation, ServedPolicy(misfit, 2)), Failed)
    reply = session.answer(shown(1, 1, 1, BATCH), ServedPolicy(misfits[0], 2))
    assert isinstance(reply, Answer)
    np.testing.assert_array_equal(reply.actions, acted(SERVED, 1, BATCH, 1))
