"""Policies that hold actions: decisions, acting, the choice of the action repeat, and training."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.rkhs_ac import RKHSAC
from rkhs_ros.learning.discovery import change_per_decision, choose_action_repeat, correct_action_repeat
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model_based.training_in_model import model_rollouts_of
from rkhs_ros.learning.replay import check_actions
from rkhs_ros.learning.state import first_policy, first_state
from rkhs_ros.learning.training import train, with_action_repeat
from rkhs_ros.learning.training_settings import AUTO, ModelBased, Training
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Array
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.offline import learn_offline
from test.unit.conftest import model_free

SPACES = Spaces.unbounded(2, 1)
SHORT = model_free(
    iterations=2, episodes_per_iteration=4, evaluation_episodes=2, horizon=200, action_repeat=AUTO, seed=1
)
REPEATS = st.integers(1, 7)


def make_policy(repeat: int, history: int = 1) -> GaussianPolicy:
    rng, inputs = np.random.default_rng(3), Inputs(history=history)
    size = inputs.dimension(2, 1)
    mean = Function(RBF((2.0,)), rng.normal(size=(4, size)), rng.normal(size=(4, 1)))
    return GaussianPolicy(mean, ConstantVariance(np.array([0.3])), inputs, action_repeat=repeat)


def run(policy: GaussianPolicy, batch: Batch) -> Episodes:
    """Return episodes of the policy on random observations."""
    shape = (batch.num_envs, batch.horizon)
    observations, acting = np.random.default_rng(0).normal(size=(*shape, 2)), Acting(policy, batch, explore=True)
    actions = np.stack([acting(t, observations[:, t]) for t in range(batch.horizon)], axis=1)
    return Episodes.without_ends(observations, actions, np.zeros(shape), np.ones(shape, dtype=bool))


def pendulum() -> InlineRunner:
    return InlineRunner(Simulation("rkhs/Pendulum-v0"))


@st.composite
def episodes_and_repeat(draw: st.DrawFn) -> tuple[Episodes, int]:
    repeat, horizon, count = draw(REPEATS), draw(st.integers(1, 30)), draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 999)))
    lengths = rng.integers(1, horizon + 1, count)
    terminated = rng.random(count) < 0.5
    mask = np.arange(horizon) < lengths[:, None]
    held = np.repeat(rng.normal(size=(count, horizon, 1)), repeat, axis=1)[:, :horizon]
    observations = rng.normal(size=(count, horizon, 2)) * mask[:, :, None]
    rewards, final = rng.normal(size=mask.shape) * mask, rng.normal(size=(count, 2))
    return Episodes(observations, held * mask[:, :, None], rewards, mask, final, terminated), repeat


@given(episodes_and_repeat(), st.sampled_from([0.5, 0.99, 1.0]))
def test_decisions_keep_the_return_the_actions_and_the_ends(drawn: tuple[Episodes, int], discount: float) -> None:
    episodes, repeat = drawn
    decisions = episodes.decisions(repeat, discount, SPACES)
    for one in range(len(episodes)):
        length = int(episodes.mask[one].sum())
        rest = 0 if episodes.terminated[one] or length < repeat else length % repeat
        kept = length - rest
        count = -(-kept // repeat)
        assert decisions.mask[one].sum() == count
        assert np.array_equal(decisions.actions[one, :count], episodes.actions[one, :kept:repeat])
        assert np.array_equal(decisions.observations[one, :count], episodes.observations[one, :kept:repeat])
        final = episodes.observations[one, kept] if rest else episodes.final_observations[one]
        assert np.array_equal(decisions.final_observations[one], final)
        expected = episodes.rewards[one, :kept] @ discount ** np.arange(kept)
        np.testing.assert_allclose(decisions.take([one]).returns(discount**repeat), expected, atol=1e-12)
    assert np.array_equal(decisions.terminated, episodes.terminated)


@given(episodes_and_repeat(), st.sampled_from([0.5, 1.0]))
def test_held_decisions_group_into_the_same_decisions(drawn: tuple[Episodes, int], discount: float) -> None:
    episodes, repeat = drawn
    steps = episodes.held(repeat, repeat * episodes.horizon)
    again = steps.decisions(repeat, discount, SPACES)
    for name in ("observations", "actions", "rewards", "mask", "final_observations", "terminated"):
        assert np.array_equal(getattr(again, name), getattr(episodes, name)), name
    np.testing.assert_allclose(steps.returns(discount), episodes.returns(discount**repeat))


def test_the_clipped_mean_replaces_actions_that_differ() -> None:
    spaces = replace(SPACES, action_low=np.array([-1.0]), action_high=np.array([1.0]))
    actions = np.array([[[0.5], [3.0], [-9.0], [9.0], [4.0], [4.0]]])
    mask = np.ones((1, 6), dtype=bool)
    episodes = Episodes.without_ends(np.zeros((1, 6, 2)), actions, np.zeros((1, 6)), mask)
    assert episodes.decisions(2, 1.0, spaces).actions.ravel().tolist() == [0.75, 0.0, 4.0]  # held ones stay unclipped


def test_an_acting_policy_holds_its_actions_and_decides_from_decisions() -> None:
    policy, batch = make_policy(3, history=2), Batch(1, 0, 2, 10, explore=True)
    episodes = run(policy, batch)
    first = episodes.actions[:, ::3]
    assert np.array_equal(np.repeat(first, 3, axis=1)[:, :10], episodes.actions)
    assert (first[:, 1:] != first[:, :-1]).all()
    alone = run(replace(policy, action_repeat=1), replace(batch, horizon=4))
    draws = replace(policy, action_repeat=1).exploration(replace(batch, horizon=policy.decisions(batch.horizon)))
    assert np.array_equal(policy.exploration(batch), draws)
    assert alone.actions.shape == first.shape
    check_actions(episodes, policy, batch)
    wrong = episodes.actions.copy()
    wrong[1, 4] += 1.0  # within a decision
    with pytest.raises(ValueError, match=r"environment 1 .* step 4"):
        check_actions(replace(episodes, actions=wrong), policy, batch)


def waves(frequency: float, horizon: int = 3000) -> Array:
    """Return a sine and a cosine with a frequency in cycles per step, shape (1, horizon, 2)."""
    phase = 2.0 * np.pi * frequency * np.arange(horizon)
    return np.stack([np.sin(phase), np.cos(phase)], axis=1)[None]


def seen(observations: Array) -> Episodes:
    count, horizon = observations.shape[:2]
    zeros, mask = np.zeros((count, horizon)), np.ones((count, horizon), dtype=bool)
    return Episodes.without_ends(observations, zeros[:, :, None], zeros, mask)


@pytest.mark.parametrize("frequency", [0.002, 0.01, 0.04])
def test_the_change_of_a_wave_per_decision_has_a_closed_form(frequency: float) -> None:
    episodes = seen(waves(frequency))
    for repeat in (1, 2, 5):
        expected = 2.0 * np.sin(np.pi * frequency * repeat)
        np.testing.assert_allclose(change_per_decision(episodes, repeat), expected, rtol=0.02)
    repeats = np.arange(1, min(50, int(0.5 / frequency)) + 1)  # up to half a period; then the change falls again
    nearest = repeats[np.argmin(np.abs(np.log(2.0 * np.sin(np.pi * frequency * repeats) / 0.3)))]
    assert choose_action_repeat(episodes) == nearest


def test_units_and_uninformative_columns_do_not_change_the_action_repeat() -> None:
    observed, rng = waves(0.005), np.random.default_rng(0)
    expected = choose_action_repeat(seen(observed))
    noise, constant = rng.normal(size=(1, 3000, 1)), np.full((1, 3000, 1), 0.37)  # whose computed deviation is not 0
    for columns in ([observed * [1e6, 1e-6]], [observed, constant], [observed, observed[..., :1]], [observed, noise]):
        assert choose_action_repeat(seen(np.concatenate(columns, axis=2))) == expected
    assert choose_action_repeat(seen(np.concatenate([constant, constant], axis=2))) == 1
    goals = np.concatenate([np.concatenate([observed, goal * constant], axis=2) for goal in (1, 2)])
    assert choose_action_repeat(seen(goals)) == expected
    assert choose_action_repeat(seen(observed[:, :30])) == 1  # 50 decisions at least


@pytest.mark.parametrize(("frequency", "counts"), [(0.14, True), (0.195, False)])
def test_a_column_that_changes_by_more_than_its_deviation_in_a_step_is_noise(frequency: float, counts: bool) -> None:
    slow, fast = waves(0.01)[..., :1], waves(frequency)[..., :1]  # fast ones change by 0.85 and 1.15 deviations
    alone, both = (change_per_decision(seen(each), 1) for each in (slow, np.concatenate([slow, fast], axis=2)))
    assert (both > 2.0 * alone) == counts


def test_more_episodes_correct_only_an_action_repeat_that_differs_clearly() -> None:
    episodes = seen(waves(0.005))
    better = choose_action_repeat(episodes)
    assert better >= 6  # so that some repeats are near and others are not
    for earlier in range(1, 3 * better):
        is_near = max(earlier, better) <= 1.5 * min(earlier, better)
        assert correct_action_repeat(earlier, episodes) == (earlier if is_near else better)


def test_the_action_repeat_is_corrected_at_most_once_and_only_in_the_second_and_third_iteration() -> None:
    training = small_model(replace(SHORT, inputs=Inputs()))
    first = first_state(training, Spaces.unbounded(2, 1))
    episodes, better = seen(waves(0.005)), choose_action_repeat(seen(waves(0.005)))
    short = replace(first.policy, action_repeat=1)

    def after(iterations: int, *policies: GaussianPolicy) -> int:
        """Return the action repeat after more iterations; the policies are the newest first."""
        state = replace(first, iterations=iterations, explorer=policies[0], earlier=policies[1:])
        return with_action_repeat(replace(state, memory=episodes.take(slice(0))), training, episodes).action_repeat

    assert after(1, short, first.policy) == better
    assert after(2, short, short, first.policy) == better
    assert after(2, short, replace(short, action_repeat=3), first.policy) == 1  # corrected already
    assert after(3, short, short, short, first.policy) == 1
    given = replace(first.policy, mean=Function(RBF((1.0,)), np.zeros((1, 2)), np.ones((1, 1))))
    assert after(1, short, given) == 1  # an initial policy brings its own


def test_training_chooses_the_action_repeat_and_resumes_with_it() -> None:
    first, second = train(SHORT, pendulum())
    assert first.policy.action_repeat == second.policy.action_repeat == 4
    assert first.evaluation.horizon == SHORT.horizon  # episodes keep the environment's own steps
    held = second.exploration.actions
    assert np.array_equal(np.repeat(held[:, ::4], 4, axis=1)[:, : SHORT.horizon], held)
    (again,) = train(SHORT, pendulum(), first.state)
    assert np.array_equal(again.policy.mean.weights, second.policy.mean.weights)
    assert np.array_equal(again.exploration.actions, held)


def test_a_line_search_compares_the_returns_of_decisions() -> None:
    returns = []

    @dataclass(frozen=True)
    class Trying(RKHSAC):
        def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
            returns.append(experience.collect(policy, 2).returns(experience.discount))
            return super().update(policy, experience)

    training = replace(SHORT, iterations=1, action_repeat=3, horizon=198, discount=0.9, algorithm=Trying())
    ((tried,),) = (iteration.tried for iteration in train(training, pendulum()))
    np.testing.assert_allclose(returns, [tried.returns(0.9)])
    assert np.array_equal(np.repeat(tried.actions[:, ::3], 3, axis=1), tried.actions)


def small_model(training: Training) -> Training:
    model = ModelBased(updates=2, rollouts=4, centres=20)
    return replace(training, model=model, evaluate_every=0)


def test_offline_training_groups_the_recorded_steps() -> None:
    runner, training = pendulum(), small_model(SHORT)
    episodes = runner.collect(first_policy(SHORT, runner.spaces), Batch(0, 0, 7, 200, explore=True))
    expected = choose_action_repeat(episodes)
    assert expected > 1
    iterations = list(learn_offline(training, runner.spaces, episodes))
    assert [each.policy.action_repeat for each in iterations] == [expected] * 2


def test_model_rollouts_have_the_steps_of_the_task() -> None:
    runner, training = pendulum(), small_model(replace(SHORT, action_repeat=4))
    *_, last = train(training, runner)
    settings = training.model
    assert isinstance(settings, ModelBased)
    rollouts = model_rollouts_of(settings, last.policy, last.state.memory, runner.spaces, training.discount, 2)
    assert rollouts.observations.shape[:2] == (2, SHORT.horizon)
    assert np.array_equal(np.repeat(rollouts.actions[:, ::4], 4, axis=1)[:, : SHORT.horizon], rollouts.actions)


def test_an_initial_policy_keeps_its_action_repeat_unless_the_settings_give_one() -> None:
    given = make_policy(5)
    settings = model_free(inputs=given.inputs, action_repeat=AUTO)
    assert first_state(settings, SPACES, given).policy.action_repeat == 5
    assert first_state(replace(settings, action_repeat=2), SPACES, given).policy.action_repeat == 2
    remembering = make_policy(5, 2)
    two = replace(settings, inputs=remembering.inputs, action_repeat=2)
    with pytest.raises(ValueError, match="action_repeat: expected 5 like the initial policy, got 2"):
        first_state(two, SPACES, remembering)
