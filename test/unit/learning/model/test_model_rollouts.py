"""Model rollouts match the task if the model has learnt it, and follow the conventions of real episodes."""

from collections.abc import Callable
from dataclasses import fields, replace
from itertools import permutations

import numpy as np
import pytest

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.learning.model.priors import Priors
from rkhs_ros.learning.model.rewards import reward_depends_on_action_only
from rkhs_ros.learning.model.transitions import points_of
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch, stream
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from rkhs_ros.rkhs.posterior import Posterior

SPACES = Spaces((2,), np.array([-1.0]), np.array([1.0]))
NOISE = np.array([0.02, 0.05])
TURNING, PUSH = np.array([[0.95, 0.3], [-0.3, 0.95]]), np.array([[0.0, 0.5]])
ROWS, HORIZON, LIMIT = 60, 12, 1.0
OVER = 10.0  # additional cost of a terminal step
Step = Callable[[np.ndarray, np.ndarray], np.ndarray]


def linear(observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
    return observations @ TURNING + np.clip(actions, -1.0, 1.0) @ PUSH


def reward(observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
    return 3.0 - observations[:, 0] ** 2 - 0.1 * np.clip(actions[:, 0], -1.0, 1.0)


def simulated_episodes(
    rng: np.random.Generator, step: Step = linear, rows: int = ROWS, *, ending: bool = False, turning: bool = False
) -> Episodes:
    """Return episodes with random actions; if ``ending``, an episode ends when the first number leaves the limits."""
    observations, actions = np.zeros((rows, HORIZON + 1, 2)), rng.uniform(-1.5, 1.5, (rows, HORIZON, 1))
    rewards, mask = np.zeros((rows, HORIZON)), np.zeros((rows, HORIZON), dtype=bool)
    now, going = rng.uniform(-1.0, 1.0, (rows, 2)), np.ones(rows, dtype=bool)
    if turning:
        now[:, 0] = rng.uniform(-np.pi, np.pi, rows)
    final = now.copy()
    for t in range(HORIZON):
        following = step(now, actions[:, t]) + NOISE * rng.standard_normal(now.shape)
        if turning:
            following[:, 0] = np.remainder(following[:, 0] + np.pi, 2 * np.pi) - np.pi
        over = ending & (np.abs(following[:, 0]) > LIMIT)
        observations[going, t], mask[:, t] = now[going], going
        rewards[going, t] = (reward(now, actions[:, t]) - OVER * over)[going]
        final[going] = following[going]
        now, going = following, going & ~over
    actions[~mask] = 0.0
    return Episodes(observations[:, :-1], actions, rewards, mask, final, ~going)


def policy_of(rng: np.random.Generator, inputs: Inputs = Inputs(), sd: float = 0.5) -> GaussianPolicy:  # noqa: B008
    size = inputs.dimension(2, 1)
    mean = Function(RBF((2.0,)), rng.normal(size=(8, size)), 0.3 * rng.normal(size=(8, 1)))
    return GaussianPolicy(mean, ConstantVariance(np.array([sd**2])), inputs)


def batch_of(rows: int, horizon: int = HORIZON, first: int = 0) -> Batch:
    return Batch(5, first, rows, horizon, explore=True)


def assert_bit_identical(ours: Episodes, theirs: Episodes) -> None:
    for f in fields(ours):
        np.testing.assert_array_equal(getattr(ours, f.name), getattr(theirs, f.name))


def transitions(episodes: Episodes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return observations, actions and next observations of all steps."""
    following = np.concatenate([episodes.observations[:, 1:], episodes.final_observations[:, None]], axis=1)
    last = episodes.mask.sum(axis=1) - 1
    following[np.arange(len(episodes)), last] = episodes.final_observations
    return tuple(episodes.flat(v) for v in (episodes.observations, episodes.actions, following))


def test_rollouts_of_a_linear_system_have_the_true_mean_and_spread(rng: np.random.Generator) -> None:
    model = DynamicsModel.fit(simulated_episodes(rng, rows=200), Inputs(), SPACES, 50)
    model = replace(model, low=np.full(2, -np.inf), high=np.full(2, np.inf))
    rollouts = ModelRunner(model).collect(policy_of(rng), batch_of(200))
    now, actions, following = transitions(rollouts)
    errors = following - linear(now, actions)
    # The mean of 2400 steps is within 0.02 standard deviations of the noise; the rest is the model's uncertainty.
    np.testing.assert_allclose(errors.mean(axis=0) / NOISE, 0.0, atol=0.1)
    # Adjacent noise candidates differ by a factor of 1.47, so the closest one is within a fifth.
    np.testing.assert_allclose(errors.std(axis=0) / NOISE, 1.0, atol=0.25)
    earned = rollouts.flat(rollouts.rewards)
    np.testing.assert_allclose(earned, np.clip(reward(now, actions), *model.rewards.limits), atol=0.1)


def on_a_line_through_two(points: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return the place of each point on the line through two starts, 0 and 1 at these; nan if it is on no such line."""
    places = np.full(len(points), np.nan)
    for one, other in permutations(starts, 2):
        way = other - one
        place = (points - one) @ way / (way @ way)
        on_line = np.linalg.norm(points - one - np.outer(place, way), axis=1) < 1e-9
        places[on_line] = place[on_line]
    return places


def test_rollouts_start_near_initial_observations_and_from_visited_ones(rng: np.random.Generator) -> None:
    episodes = simulated_episodes(rng, rows=3)
    model = DynamicsModel.fit(episodes, Inputs(), SPACES, 30)
    assert model.starts_vary
    begins = ModelRunner(model).collect(policy_of(rng), batch_of(400)).observations[:, 0]
    near, elsewhere = begins[np.arange(400) % 4 != 1], {row.tobytes() for row in begins[1::4]}
    places = on_a_line_through_two(near, model.starts)
    assert np.isfinite(places).mean() > 0.95  # the others left the range of possible observations
    assert places[np.isfinite(places)].min() == pytest.approx(-0.5, abs=0.05)
    assert places[np.isfinite(places)].max() == pytest.approx(1.5, abs=0.05)
    assert (near == model.possible(near)).all()
    assert elsewhere <= {row.tobytes() for row in episodes.flat(episodes.observations)}
    assert len(elsewhere) > 0.8 * episodes.mask.sum()  # of 36, with 100 draws


def test_a_constant_column_does_not_make_starts_vary(rng: np.random.Generator) -> None:
    observations = np.full((3, 8, 2), 0.37)  # whose computed standard deviation is not 0
    observations[:, :, 0] = np.cumsum(rng.normal(size=(3, 8)), axis=1)
    observations[:, 0, 0] = 0.0
    zeros, mask = np.zeros((3, 8)), np.ones((3, 8), dtype=bool)
    episodes = Episodes.without_ends(observations, zeros[:, :, None], zeros, mask)
    assert not DynamicsModel.fit(episodes, Inputs(), SPACES, 10).starts_vary


def test_starts_between_angles_take_the_short_way(rng: np.random.Generator) -> None:
    inputs = Inputs(angles=(0.0,))
    model = DynamicsModel.fit(simulated_episodes(rng, rows=2), inputs, SPACES, 20)
    model = replace(model, starts=np.array([[3.0, 0.0], [-3.0, 0.0]]), low=np.full(2, -np.inf), high=np.full(2, np.inf))
    begins = ModelRunner(model, visited_starts=False).collect(policy_of(rng, inputs), batch_of(200)).observations[:, 0]
    assert (np.abs(begins[:, 0]) > 3.0 - 0.5 * (2 * np.pi - 6.0) - 1e-9).all()  # and none is near 0


def test_if_starts_do_not_vary_rollouts_start_from_one_of_them(rng: np.random.Generator) -> None:
    model = DynamicsModel.fit(simulated_episodes(rng, rows=3), Inputs(), SPACES, 30)
    model = replace(model, starts_vary=False)
    begins = ModelRunner(model, visited_starts=False).collect(policy_of(rng), batch_of(40)).observations[:, 0]
    assert {row.tobytes() for row in begins} == {row.tobytes() for row in model.starts}


def test_with_a_history_no_rollout_starts_from_a_visited_observation(rng: np.random.Generator) -> None:
    episodes, inputs = simulated_episodes(rng, rows=3), Inputs(history=2)
    model = replace(DynamicsModel.fit(episodes, inputs, SPACES, 30), starts_vary=False)
    begins = ModelRunner(model).collect(policy_of(rng, inputs), batch_of(40)).observations[:, 0]
    assert {row.tobytes() for row in begins} == {row.tobytes() for row in episodes.observations[:, 0]}


def test_rollouts_take_turns_in_the_worlds_that_they_share(rng: np.random.Generator) -> None:
    model = DynamicsModel.fit(simulated_episodes(rng, rows=2), Inputs(), SPACES, 20)
    quiet = replace(model.state_delta, coefficients=model.state_delta.coefficients._replace(noise=np.zeros(2)))
    model = replace(model, state_delta=quiet, starts=model.starts[:1], starts_vary=False)
    runner = ModelRunner(model, visited_starts=False, worlds=[stream(3, "world", i) for i in range(2)])
    policy = policy_of(rng)
    rollouts = runner.collect(policy, Batch(5, 0, 6, HORIZON, explore=False))
    for world in range(2):
        alike = rollouts.take(np.arange(6) % 2 == world)
        assert_bit_identical(alike, alike.take(np.zeros(3, dtype=int)))
    assert not np.array_equal(rollouts.rewards[0], rollouts.rewards[1])
    last = runner.collect(policy, Batch(5, 3, 3, HORIZON, explore=False))
    assert_bit_identical(last, rollouts.take(slice(3, None)))


def test_rollouts_earn_the_least_reward_once_they_reach_a_limit(rng: np.random.Generator) -> None:
    model = DynamicsModel.fit(simulated_episodes(rng, rows=20), Inputs(), SPACES, 40)
    model = replace(model, starts=np.zeros((1, 2)), starts_vary=False)
    model = replace(model, low=np.full(2, -np.inf), high=np.full(2, np.inf))
    policy, batch = policy_of(rng), batch_of(40)
    free = ModelRunner(model, visited_starts=False).collect(policy, batch)
    farthest = np.abs(free.next_observations).max(axis=(1, 2))
    limit = np.median(farthest)
    range_ = {"low": np.full(2, -limit / 1.5), "high": np.full(2, limit / 1.5)}  # which may be exceeded by a quarter
    rollouts = ModelRunner(replace(model, **range_), visited_starts=False).collect(policy, batch)
    beyond = np.cumsum((np.abs(rollouts.next_observations) >= limit).any(axis=2), axis=1) > 0
    np.testing.assert_array_equal(beyond.any(axis=1), farthest >= limit)
    assert (rollouts.rewards[beyond] == model.least_reward).all()
    np.testing.assert_array_equal(rollouts.rewards[~beyond], free.rewards[~beyond])


def certain(posterior: Posterior) -> Posterior:
    """Return a posterior whose draws are its mean."""
    zero = np.zeros_like(posterior.coefficients.sd)
    return replace(posterior, coefficients=posterior.coefficients._replace(sd=zero, signal=zero[0]))


def test_at_a_limit_the_actions_still_cost_what_they_cost(rng: np.random.Generator) -> None:
    episodes = simulated_episodes(rng, rows=20)
    push = np.clip(episodes.actions[..., 0], -1.0, 1.0)
    model = DynamicsModel.fit(
        replace(episodes, rewards=0.01 * episodes.observations[..., 0] - push**2), Inputs(), SPACES, 40
    )
    model = replace(model, low=np.full(2, -0.01), high=np.full(2, 0.01), starts=np.zeros((1, 2)), starts_vary=False)
    rollouts = ModelRunner(model, visited_starts=False).collect(policy_of(rng), batch_of(20))
    others = rollouts.rewards[:, 1:] + np.clip(rollouts.actions[:, 1:, 0], -1.0, 1.0) ** 2
    least = 0.01 * episodes.observations[..., 0].min()
    assert np.median(others) == pytest.approx(least, abs=1e-3)


def test_the_functions_of_rollouts_spread_around_the_mean(rng: np.random.Generator) -> None:
    model = DynamicsModel.fit(simulated_episodes(rng, rows=2), Inputs(), SPACES, 20)
    quiet = replace(model.state_delta, coefficients=model.state_delta.coefficients._replace(noise=np.zeros(2)))
    model = replace(model, state_delta=quiet, low=np.full(2, -np.inf), high=np.full(2, np.inf))
    still, batch = policy_of(rng), batch_of(400, horizon=1)

    def changes_in(model: DynamicsModel) -> tuple[np.ndarray, np.ndarray]:
        rollouts = ModelRunner(model).collect(still, batch)
        points = points_of(rollouts.observations[:, 0], rollouts.actions[:, 0], SPACES)
        return rollouts.final_observations - rollouts.observations[:, 0], points

    mean, points = changes_in(replace(model, state_delta=certain(model.state_delta)))
    np.testing.assert_allclose(mean, model.state_delta.mean(points), atol=1e-9)
    expected = np.sqrt(np.mean(model.state_delta.sd(points) ** 2, axis=0))
    np.testing.assert_allclose(
        (changes_in(model)[0] - mean).std(axis=0), expected, rtol=0.2
    )  # 7 % for 400 draws, and the waves' error


def test_rollouts_terminate_like_the_task(rng: np.random.Generator) -> None:
    real = simulated_episodes(rng, rows=200, ending=True)
    assert 0.2 < real.terminated.mean() < 1.0
    model = DynamicsModel.fit(real, Inputs(), SPACES, 60)
    rollouts = ModelRunner(model).collect(policy_of(rng), batch_of(200))
    _, _, following = transitions(rollouts)
    lengths = rollouts.mask.sum(axis=1)
    ended = np.zeros(rollouts.mask.shape, dtype=bool)
    ended[np.arange(200), lengths - 1] = rollouts.terminated
    over, beyond = rollouts.flat(ended), np.abs(following[:, 0])
    assert over[beyond > LIMIT].mean() > 0.85  # most steps beyond the limit are close to it
    assert not over[beyond < 0.85 * LIMIT].any()
    assert over[beyond < LIMIT].mean() < 0.1
    # A terminal step has an additional cost.
    now, actions, _ = transitions(rollouts)
    beside = rollouts.flat(rollouts.rewards) - reward(now, actions) + OVER * over
    inside = np.abs(now[:, 0]) < LIMIT  # where rollouts start further out, no reward was observed
    np.testing.assert_allclose(beside[inside], 0.0, atol=0.5)


@pytest.mark.parametrize(("threshold", "is_rare"), [(0.3, True), (0.9, False)])
def test_a_narrow_kernel_may_fit_rewards_that_most_steps_do_not_earn(threshold: float, is_rare: bool) -> None:
    places = np.random.default_rng(0).uniform(-1.0, 1.0, size=(400, 1, 2))
    rewards = np.where(np.linalg.norm(places, axis=2) < threshold, 1.0, 0.0)  # 8 and 64 % of the places
    alone = Episodes.without_ends(places, np.zeros((400, 1, 1)), rewards, np.ones((400, 1), dtype=bool))
    learnt = DynamicsModel.fit(alone, Inputs(), SPACES, 200).rewards
    assert learnt.posterior.bandwidth == pytest.approx((0.4 if is_rare else 1.0) * np.sqrt(1.5))


def test_a_distance_is_known_between_the_targets_of_a_few_episodes() -> None:
    def error(seed: int) -> float:
        rng = np.random.default_rng(seed)
        targets, starts = rng.uniform(-1.0, 1.0, (2, 8, 1))
        places = targets + (starts - targets) * 0.9 ** np.arange(40) + 0.1 * rng.normal(size=(8, 40)).cumsum(axis=1)
        seen = np.stack([places, np.broadcast_to(targets, places.shape)], axis=2)
        rewards = -np.abs(places - targets)
        alone = Episodes.without_ends(seen, np.zeros((8, 40, 1)), rewards, np.ones((8, 40), dtype=bool))
        learnt = DynamicsModel.fit(alone, Inputs(), SPACES, 200).rewards
        new = np.column_stack([rng.uniform(-0.8, 0.8, (300, 2)), np.zeros(300)])
        known = learnt.of(learnt.posterior.mean(new)[:, 0], new[:, 2:], margin=0.0)
        return float(np.abs(known + np.abs(new[:, 0] - new[:, 1])).mean())

    assert np.mean([error(seed) for seed in range(5)]) < 0.12  # 0.22 with wide kernels alone


def test_rollouts_that_end_on_the_better_side_earn_more(rng: np.random.Generator) -> None:
    def with_goal(episodes: Episodes) -> np.ndarray:
        """Return the rewards if an end on the right earns 10 instead of costing 10."""
        last = (np.arange(len(episodes)), episodes.mask.sum(axis=1) - 1)
        rewards = episodes.rewards.copy()
        rewards[last] += 2 * OVER * (episodes.terminated & (episodes.final_observations[:, 0] > 0.0))
        return rewards

    real = simulated_episodes(rng, rows=200, ending=True)
    real = replace(real, rewards=with_goal(real))
    rollouts = ModelRunner(DynamicsModel.fit(real, Inputs(), SPACES, 60)).collect(policy_of(rng), batch_of(200))
    now, actions, _ = transitions(rollouts)
    last = (np.arange(200), rollouts.mask.sum(axis=1) - 1)
    expected = np.zeros(rollouts.mask.shape)
    expected[rollouts.mask] = reward(now, actions)
    expected[last] -= OVER * rollouts.terminated
    expected = with_goal(replace(rollouts, rewards=expected))
    errors = np.abs(rollouts.rewards - expected)[last][rollouts.terminated]
    assert rollouts.terminated.sum() > 50
    assert np.median(errors) < 0.5
    assert np.mean(errors < 2.0) > 0.9


def test_rollouts_follow_the_conventions_of_real_episodes(rng: np.random.Generator) -> None:
    model = DynamicsModel.fit(simulated_episodes(rng, rows=100, ending=True), Inputs(), SPACES, 40)
    rollouts = ModelRunner(model).collect(policy_of(rng), batch_of(50))
    lengths = rollouts.mask.sum(axis=1)
    np.testing.assert_array_equal(rollouts.mask, np.arange(HORIZON) < lengths[:, None])
    assert (lengths[~rollouts.terminated] == HORIZON).all()
    assert (lengths[rollouts.terminated] < HORIZON).any()
    for name in ("observations", "actions", "rewards"):
        assert not getattr(rollouts, name)[~rollouts.mask].any()


def test_termination_only_truncates_a_rollout(rng: np.random.Generator) -> None:
    model = DynamicsModel.fit(simulated_episodes(rng, rows=100, ending=True), Inputs(), SPACES, 40)
    policy = policy_of(rng)
    ending, endless = (ModelRunner(m).collect(policy, batch_of(50)) for m in (model, replace(model, termination=None)))
    assert endless.mask.all()
    assert not endless.terminated.any()
    mask, last = ending.mask, ending.mask.sum(axis=1) - 1
    for name in ("observations", "actions"):
        np.testing.assert_array_equal(getattr(ending, name)[mask], getattr(endless, name)[mask])
    short = np.flatnonzero(last < HORIZON - 1)
    np.testing.assert_array_equal(ending.final_observations[short], endless.observations[short, last[short] + 1])
    difference = (endless.rewards - ending.rewards)[np.arange(50), last]
    np.testing.assert_allclose(difference, -model.rewards.terminal.mean * ending.terminated)


@pytest.mark.parametrize(("rows", "values", "limited"), [(40, 9, False), (40, 10, True), (1, 5, False), (1, 6, True)])
def test_a_column_that_repeats_less_than_ten_values_has_no_limits(
    rng: np.random.Generator, rows: int, values: int, limited: bool
) -> None:
    real = simulated_episodes(rng, rows=rows)
    flags = np.arange(rows * HORIZON).reshape(rows, HORIZON) % values
    seen = np.dstack([real.observations[..., 0], flags])
    final = np.column_stack([real.final_observations[:, 0], np.zeros(rows)])
    model = DynamicsModel.fit(replace(real, observations=seen, final_observations=final), Inputs(), SPACES, 9)
    assert model.at_limits(np.full((1, 2), 1e9)).tolist() == [[True, limited]]


def test_splitting_a_batch_gives_bit_identical_rollouts(rng: np.random.Generator) -> None:
    inputs = Inputs(history=3, angles=(0.0,))
    episodes = simulated_episodes(rng, rows=40, ending=True)
    runner = ModelRunner(DynamicsModel.fit(episodes, inputs, SPACES, 40))
    policy, batch = policy_of(rng, inputs), batch_of(13)
    whole = runner.collect(policy, batch)
    assert_bit_identical(whole, runner.collect(policy, batch))
    for size in (7, 1):
        first, *rest = (runner.collect(policy, part) for part in batch.parts(size))
        assert_bit_identical(whole, sum(rest, start=first))


def test_angles_are_periodic(rng: np.random.Generator) -> None:
    def spin(observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        return observations * [1.0, 0.5] + [0.7, 0.0] + np.clip(actions, -1.0, 1.0) * [[0.1, 0.2]]

    inputs = Inputs(angles=(0.0,))
    model = DynamicsModel.fit(simulated_episodes(rng, spin, 100, turning=True), inputs, SPACES, 40)
    rollouts = ModelRunner(model).collect(policy_of(rng, inputs), batch_of(50, horizon=30))
    angles = rollouts.observations[:, :, 0]
    assert ((-np.pi <= angles) & (angles < np.pi)).all()
    now, actions, following = transitions(rollouts)
    turned = np.remainder(following[:, 0] - spin(now, actions)[:, 0] + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(turned, 0.0, atol=6 * NOISE[0])
    assert (np.abs(following[:, 0] - now[:, 0]) > np.pi).mean() > 0.05  # many crossed the boundary
    assert (now == model.possible(now)).all()


def test_changes_are_functions_of_the_policy_inputs(rng: np.random.Generator) -> None:
    inputs = Inputs(history=3, angles=(0.0,))
    model = DynamicsModel.fit(simulated_episodes(rng, rows=30), inputs, SPACES, 40)
    still = model.state_delta.coefficients._replace(noise=np.zeros(2))
    delta = replace(model.state_delta, coefficients=still)
    model = replace(
        model, state_delta=certain(delta), rewards=replace(model.rewards, posterior=certain(model.rewards.posterior))
    )
    policy = policy_of(rng, inputs)
    rollouts = ModelRunner(model).collect(policy, batch_of(10))
    windows = inputs.unfold(rollouts.observations, rollouts.actions)
    explored = policy.exploration(batch_of(10))
    for t in range(HORIZON):
        np.testing.assert_array_equal(rollouts.actions[:, t], policy.act(windows[:, t], explored[:, t]))
    now, actions, following = transitions(rollouts)
    points = points_of(rollouts.flat(windows), actions, SPACES)
    expected = model.state_delta.mean(points)
    np.testing.assert_allclose(model.predict(now, points[:, -1:], expected), following, atol=1e-9)
    earned = model.rewards.posterior.mean(points)[:, 0]
    np.testing.assert_allclose(rollouts.flat(rollouts.rewards), np.clip(earned, *model.rewards.limits), atol=1e-9)


@pytest.mark.parametrize("is_known", [False, True])
def test_rollouts_stay_on_circles(rng: np.random.Generator, is_known: bool) -> None:
    def turn(observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        angle = np.arctan2(observations[:, 1], observations[:, 0]) + 0.3 * np.clip(actions[:, 0], -1.0, 1.0)
        return np.column_stack([np.cos(angle), np.sin(angle)])

    rows = np.arange(20)
    actions = rng.uniform(-1.0, 1.0, (20, HORIZON, 1))
    observations = np.zeros((20, HORIZON + 1, 2))
    observations[:, 0] = turn(np.ones((20, 2)), rng.uniform(-10.0, 10.0, (20, 1)))
    for t in range(HORIZON):
        observations[:, t + 1] = turn(observations[:, t], actions[:, t])
    mask = np.ones((20, HORIZON), dtype=bool)
    episodes = Episodes(
        observations[:, :-1], actions, observations[:, 1:, 0], mask, observations[rows, -1], ~mask[:, 0]
    )
    euler = Priors(dynamics_fn=lambda now, done: 0.3 * done * np.column_stack([-now[:, 1], now[:, 0]]))
    model = DynamicsModel.fit(episodes, Inputs(), SPACES, 40, euler if is_known else Priors())
    rollouts = ModelRunner(model).collect(policy_of(rng), batch_of(20, horizon=HORIZON))
    now, done, following = transitions(rollouts)
    np.testing.assert_allclose(np.hypot(*following.T), 1.0, atol=1e-9)
    np.testing.assert_allclose(following, turn(now, done), atol=0.02)


@pytest.mark.parametrize("follow", [False, True])
def test_rewards_of_current_and_next_observations_are_distinguished(rng: np.random.Generator, follow: bool) -> None:
    episodes = simulated_episodes(rng)
    now, actions, following = transitions(episodes)
    rewards = reward(following if follow else now, actions).reshape(episodes.rewards.shape)
    model = DynamicsModel.fit(replace(episodes, rewards=rewards), Inputs(), SPACES, 50)
    assert model.rewards.depends_on_next is follow
    rollouts = ModelRunner(model).collect(policy_of(rng), batch_of(50))
    now, actions, following = transitions(rollouts)
    inside = ((model.clip_to_observed(now) == now) & (model.clip_to_observed(following) == following)).all(axis=1)
    expected = np.clip(reward(following if follow else now, actions), *model.rewards.limits)
    np.testing.assert_allclose(rollouts.flat(rollouts.rewards)[inside], expected[inside], atol=0.1)


def test_rollouts_exceed_the_observed_range_by_at_most_a_quarter(rng: np.random.Generator) -> None:
    model = DynamicsModel.fit(simulated_episodes(rng, rows=5), Inputs(), SPACES, 20)
    far = model.predict(np.zeros((2, 2)), np.zeros((2, 1)), np.array([[1e3, 1e3], [-1e3, -1e3]]))
    size = model.high - model.low
    np.testing.assert_allclose(far, [model.high + 0.25 * size, model.low - 0.25 * size], rtol=1e-12)
    np.testing.assert_array_equal(model.clip_to_observed(far), [model.high, model.low])


@pytest.mark.parametrize("size", [1e-3, 1e6])
@pytest.mark.parametrize(
    ("earned", "alike"),
    [
        (lambda place, push: np.full(push.shape, -0.7), True),
        (lambda place, push: -(push**2) - 0.3 * push, True),
        (lambda place, push: 2.0 - np.abs(push), True),
        (lambda place, push: -(push**2) + 100.0 * (place == place.max()), False),  # which one step of 720 reached
        (lambda place, push: 0.2 * place - push**2, False),
        (lambda place, push: push / push.std() + 0.0085 * np.sign(place), True),
        (lambda place, push: push / push.std() + 0.012 * np.sign(place), False),
    ],
    ids=["nothing", "square", "size", "a goal", "a slope", "a hundredth of the deviation", "more"],
)
def test_rewards_depend_on_actions_only_until_a_state_is_better(
    rng: np.random.Generator, earned: Step, alike: bool, size: float
) -> None:
    episodes = simulated_episodes(rng)
    place, push = episodes.observations[..., 0], np.clip(episodes.actions[..., 0], -1.0, 1.0)
    assert reward_depends_on_action_only(replace(episodes, rewards=size * earned(place, push)), SPACES) == alike


def test_rewards_do_not_depend_on_actions_only_if_the_task_terminates_episodes(rng: np.random.Generator) -> None:
    episodes = simulated_episodes(rng, ending=True)
    assert episodes.terminated.any()
    same = replace(episodes, rewards=episodes.mask.astype(float))
    assert not reward_depends_on_action_only(same, SPACES)
    assert reward_depends_on_action_only(replace(same, terminated=np.zeros(ROWS, dtype=bool)), SPACES)


@pytest.mark.parametrize("action_dim", [1, 8])
def test_rewards_of_few_steps_are_not_explained_by_as_many_coefficients(
    rng: np.random.Generator, action_dim: int
) -> None:
    rows = 1 + 3 * action_dim  # as many as coefficients
    actions, place = rng.uniform(-1.0, 1.0, (rows, 1, action_dim)), rng.uniform(-1.0, 1.0, (rows, 1, 1))
    steps, never = np.ones((rows, 1), dtype=bool), np.zeros(rows, dtype=bool)
    episodes = Episodes(place, actions, place[:, :, 0], steps, place[:, 0], never)
    spaces = Spaces((1,), np.full(action_dim, -1.0), np.full(action_dim, 1.0))
    assert not reward_depends_on_action_only(episodes, spaces)
    assert reward_depends_on_action_only(replace(episodes, rewards=steps.astype(float)), spaces)


@pytest.mark.parametrize(("steps", "enough"), [(7, False), (8, True)])
def test_a_cost_of_one_action_is_recognised_from_eight_steps_on(
    rng: np.random.Generator, steps: int, enough: bool
) -> None:
    actions, ones = rng.uniform(-1.0, 1.0, (1, steps, 1)), np.ones((1, steps), dtype=bool)
    episodes = Episodes.without_ends(np.zeros((1, steps, 1)), actions, -(actions[..., 0] ** 2), ones)
    assert reward_depends_on_action_only(episodes, Spaces((1,), -np.ones(1), np.ones(1))) == enough


@pytest.mark.parametrize(("share", "is_fitted"), [(0.6, True), (0.8, False)])
def test_a_cost_of_the_actions_that_explains_most_rewards_is_fitted_first(
    rng: np.random.Generator, share: float, is_fitted: bool
) -> None:
    episodes = simulated_episodes(rng)
    place, push = episodes.observations[..., 0], np.clip(episodes.actions[..., 0], -1.0, 1.0)
    of_place, cost = np.sign(place), push**2 + np.abs(push) - push
    earned = share * of_place / of_place.std() - np.sqrt(1.0 - share**2) * cost / cost.std()
    learnt = DynamicsModel.fit(replace(episodes, rewards=earned), Inputs(), SPACES, 60).rewards
    assert (learnt.cost is not None) == is_fitted


def test_a_cost_of_the_actions_does_not_hide_what_states_earn(rng: np.random.Generator) -> None:
    def earned(place: np.ndarray, push: np.ndarray) -> np.ndarray:
        return 0.02 * np.cos(2.0 * place) - 2.0 * np.clip(push, -1.0, 1.0) ** 2

    episodes = simulated_episodes(rng)
    real = replace(episodes, rewards=earned(episodes.observations[..., 0], episodes.actions[..., 0]))
    model = DynamicsModel.fit(real, Inputs(), SPACES, 60)
    assert np.ptp(model.rewards.limits) == pytest.approx(0.04, abs=0.005)
    rollouts = ModelRunner(model, visited_starts=False).collect(policy_of(rng), batch_of(50))
    now, actions, _ = transitions(rollouts)
    inside = (model.clip_to_observed(now) == now).all(axis=1)
    errors = rollouts.flat(rollouts.rewards) - earned(now[:, 0], actions[:, 0])
    np.testing.assert_allclose(errors[inside], 0.0, atol=0.004)


def test_rewards_may_lie_outside_the_observed_range_by_the_margin(rng: np.random.Generator) -> None:
    episodes = simulated_episodes(rng)
    least, greatest = np.quantile(episodes.rewards, [0.3, 0.6])
    model = DynamicsModel.fit(episodes, Inputs(), SPACES, 60)
    model = replace(model, rewards=replace(model.rewards, limits=(least, greatest)))
    policy, batch = policy_of(rng), batch_of(50)
    free = (
        ModelRunner(replace(model, rewards=replace(model.rewards, limits=(-1e9, 1e9)))).collect(policy, batch).rewards
    )
    low, high = least - 0.3 * (greatest - least), greatest + 0.3 * (greatest - least)
    assert free.min() < low
    assert free.max() > high
    np.testing.assert_array_equal(ModelRunner(model).collect(policy, batch).rewards, np.clip(free, low, high))
