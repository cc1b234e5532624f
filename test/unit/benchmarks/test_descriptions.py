"""The descriptions of tasks in benchmarks/: proper environments that equal their tasks through the inverse map."""

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import descriptions
from described import DESCRIPTIONS, NOISE, OFFSET, described, environment_id
from described_tasks import TASKS, MountainCarAtRate, PendulumAtRate
from descriptions import trial_of, until_reached
from descriptions_table import Row, as_csv, as_markdown
from sim_nodes.envs.pendulum import Pendulum
from sim_nodes.envs.vector_task import SingleTask
from task_learners import missing
from trial import Point

IS_HERE = {"cart-pole": "rkhs/CartPoleSwingUp-v0" in gymnasium.registry} | {
    name: not missing(task.packages) for name, task in TASKS.items() if task.packages
}
USABLE = [name for name in TASKS if IS_HERE.get(name, True)]
PAIRS = [(task, name) for task in USABLE for name, how in DESCRIPTIONS.items() if how.applies(TASKS[task])]
over_pairs = pytest.mark.parametrize(("task", "description"), PAIRS)
over_tasks = pytest.mark.parametrize("task", USABLE)


def actions_of(task: str, steps: int) -> np.ndarray:
    space: Any = TASKS[task].make(TASKS[task].rate).action_space
    return np.random.default_rng(0).uniform(space.low, space.high, (steps, *space.shape)).astype(space.dtype)


def episode(env: Any, actions: np.ndarray, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return the observations and rewards of an episode with these actions."""
    observations, rewards = [env.reset(seed=seed)[0]], []
    for action in actions:
        observation, reward, *_ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
    return np.array(observations, dtype=np.float64), np.array(rewards)


def both(task: str, description: str, steps: int = 40) -> tuple[np.ndarray, ...]:
    """Return the observations and rewards of the task as written, and those of the description."""
    actions = actions_of(task, steps)
    return *episode(described(task, "as-written"), actions), *episode(described(task, description), actions)


@over_pairs
def test_a_description_is_a_gymnasium_environment(task: str, description: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # bounds may be infinite, and environments are wrapped
        check_env(described(task, description), skip_render_check=True)


@over_pairs
def test_a_description_is_determined_by_the_seed(task: str, description: str) -> None:
    env, actions = described(task, description), actions_of(task, 20)
    first, again = episode(env, actions), episode(env, actions)
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1], again[1])


@over_pairs
def test_a_description_is_registered_with_its_duration(task: str, description: str) -> None:
    rate = DESCRIPTIONS[description].rate or TASKS[task].rate
    limit = gymnasium.spec(environment_id(task, description).partition(":")[2]).max_episode_steps
    assert limit == pytest.approx(TASKS[task].steps * rate / TASKS[task].rate)


@over_tasks
@pytest.mark.parametrize(("description", "factor"), [("thousandfold", 1e3), ("thousandth", 1e-3)])
def test_units_scale_observations_and_rewards(task: str, description: str, factor: float) -> None:
    observations, rewards, seen, paid = both(task, description)
    np.testing.assert_allclose(seen / factor, observations, rtol=1e-12)
    np.testing.assert_allclose(paid / factor, rewards, rtol=1e-12)
    how = DESCRIPTIONS[description]
    assert how.threshold(TASKS[task]) == factor * TASKS[task].threshold
    assert how.original_return(TASKS[task], how.threshold(TASKS[task])) == pytest.approx(TASKS[task].threshold)


@over_tasks
def test_offsets_are_added_to_rewards_only_if_no_episode_terminates(task: str) -> None:
    observations, rewards, seen, paid = both(task, "shifted")
    np.testing.assert_allclose(seen - OFFSET * np.array(TASKS[task].spread), observations, atol=1e-12)
    offset = 0.0 if TASKS[task].terminates else 1.0
    np.testing.assert_allclose(paid - offset, rewards, atol=1e-12)
    assert DESCRIPTIONS["shifted"].threshold(TASKS[task]) == TASKS[task].threshold + offset * TASKS[task].steps


def test_angles_of_the_wrapped_pendulum_are_the_same_in_every_form() -> None:
    observations, _, degrees, _ = both("pendulum-wrap", "degrees")
    np.testing.assert_allclose(degrees / 180 * np.pi, observations, atol=1e-12)
    *_, pair, _ = both("pendulum-wrap", "cosine-sine")
    np.testing.assert_allclose(np.exp(1j * observations[:, 0]), pair[:, 0] + 1j * pair[:, 1], atol=1e-12)
    np.testing.assert_array_equal(pair[:, 2], observations[:, 1])


@pytest.mark.parametrize("task", [name for name in USABLE if TASKS[name].cosines])
def test_cosines_and_sines_are_those_of_the_angles(task: str) -> None:
    of = TASKS[task]
    count, pair = len(of.cosines), [*of.cosines, *of.sines]
    for form, unit in (("wrapped", 1.0), ("unwrapped", 1.0), ("degrees", np.pi / 180)):
        observations, _, seen, _ = both(task, form)
        angles = seen[:, :count] * unit
        np.testing.assert_allclose(np.hstack([np.cos(angles), np.sin(angles)]), observations[:, pair], atol=1e-6)
        units = np.array([unit if c in of.angular_velocities else 1.0 for c in range(observations.shape[1])])
        rest = np.delete(observations / units, pair, axis=1)
        np.testing.assert_allclose(seen[:, count:], rest, rtol=1e-9)


def test_unwrapped_angles_do_not_jump() -> None:
    env, actions = described("pendulum-wrap", "unwrapped"), np.full((100, 1), 3.0)
    seen, _ = episode(env, actions)
    wrapped, _ = episode(described("pendulum-wrap", "as-written"), actions)
    assert seen[-1, 0] > 3 * np.pi  # some turns
    np.testing.assert_allclose(np.exp(1j * seen[:, 0]), np.exp(1j * wrapped[:, 0]), atol=1e-9)
    assert np.abs(np.diff(seen[:, 0])).max() < np.pi
    assert env.reset(seed=0)[0][0] == pytest.approx(-np.pi)


@over_tasks
def test_columns_are_added_and_removed(task: str) -> None:
    observations, rewards, constant, paid = both(task, "constant")
    np.testing.assert_array_equal(constant, np.hstack([observations, np.ones((len(observations), 1))]))
    np.testing.assert_array_equal(paid, rewards)
    np.testing.assert_array_equal(both(task, "duplicate")[2], np.hstack([observations, observations[:, :1]]))
    without = np.delete(observations, TASKS[task].velocities, axis=1)
    np.testing.assert_array_equal(both(task, "no-velocities")[2], without)
    late = np.vstack([observations[:1], observations[:-1]])
    np.testing.assert_array_equal(both(task, "late")[2], late)


@over_tasks
def test_noise_has_its_standard_deviation_and_leaves_the_task_alone(task: str) -> None:
    observations, rewards, seen, paid = both(task, "noise-column")
    np.testing.assert_array_equal(seen[:, :-1], observations)
    np.testing.assert_array_equal(paid, rewards)
    assert seen[:, -1].std() == pytest.approx(1.0, abs=0.4)
    noise = (both(task, "noisy")[2] - observations) / TASKS[task].spread
    assert noise.std() == pytest.approx(NOISE, rel=0.3)
    other = episode(described(task, "noise-column"), actions_of(task, 5), seed=4)[0][:, -1]
    assert not np.isin(other, seen[:, -1]).any()


def test_single_precision_rounds() -> None:
    observations, _, seen, _ = both("pendulum-wrap", "float32")
    np.testing.assert_array_equal(seen, observations.astype(np.float32))
    assert described("pendulum-wrap", "float32").observation_space.dtype == np.float32


@over_tasks
def test_actions_beyond_the_true_bounds_are_clipped(task: str) -> None:
    plain, wide = described(task, "as-written"), described(task, "wide-actions")
    np.testing.assert_allclose(wide.action_space.low, 2 * plain.action_space.low)  # symmetric bounds
    actions = actions_of(task, 20)
    twice = episode(wide, 2 * actions)
    low, high = plain.action_space.low, plain.action_space.high
    once = episode(plain, np.clip(2 * actions, low, high))
    np.testing.assert_array_equal(twice[0], once[0])
    np.testing.assert_array_equal(twice[1], once[1])


def test_the_pendulum_at_its_own_rate_is_the_original() -> None:
    actions = actions_of("pendulum-wrap", 50)
    original = episode(SingleTask(Pendulum(angle="wrap")), actions)
    at_rate = episode(SingleTask(PendulumAtRate(10)), actions)
    np.testing.assert_allclose(at_rate[0], original[0], atol=1e-12)
    np.testing.assert_allclose(at_rate[1], original[1], atol=1e-12)


def test_the_noise_of_the_pendulum_has_the_same_variance_per_second() -> None:
    final = []
    for rate in (10, 100):
        ends = [episode(SingleTask(PendulumAtRate(rate)), np.zeros((rate, 1)), seed)[0][-1, 1] for seed in range(300)]
        final.append(np.std(ends))
    assert final[0] == pytest.approx(final[1], rel=0.15)


def test_the_mountain_car_at_its_own_rate_is_the_original() -> None:
    actions = np.sign(np.sin(np.arange(100) / 20))[:, None].astype(np.float32)
    original = episode(described("MountainCarContinuous-v0", "as-written"), actions)
    at_rate = episode(MountainCarAtRate(30), actions)
    np.testing.assert_allclose(at_rate[0], original[0], atol=1e-5)
    np.testing.assert_allclose(at_rate[1], original[1], atol=1e-9)


@over_tasks
def test_a_finer_rate_with_repeated_actions_agrees_up_to_the_integration(
    task: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PendulumAtRate, "noise_sd", 0.0)
    actions = actions_of(task, 10)
    coarse, fine = TASKS[task].make(20), TASKS[task].make(100)
    observations, rewards = episode(coarse, actions)
    finer, paid = episode(fine, np.repeat(actions, 5, axis=0))
    errors = finer[::5] - observations
    angles = list(TASKS[task].angles)
    errors[:, angles] = np.angle(np.exp(1j * errors[:, angles]))
    assert np.abs(errors / TASKS[task].spread).max() < 0.1
    assert paid.sum() == pytest.approx(rewards.sum(), rel=0.15)


def test_a_run_stops_some_episodes_after_the_threshold() -> None:
    points = [Point(n, 10 * n, 0.1, value, 0.0) for n, value in enumerate([1.0, 5.0, 1.0, 6.0, 1.0, 1.0], 1)]
    assert list(until_reached(iter(points), 5.0)) == points[:5]
    assert list(until_reached(iter(points), 7.0)) == points


def test_the_table_has_medians_and_ratios() -> None:
    reached = [[(1, 0.0), (2, 5.0)], [(1, 0.0), (4, 6.0)]]
    rows = [Row("toy", "as-written", 5.0, reached), Row("toy", "late", 5.0, [reached[0], [(1, 0.0), (2, 1.0)]])]
    assert as_csv(rows).splitlines()[1:] == ["toy,as-written,2,2,3,1,5.5", "toy,late,2,1,inf,inf,3"]
    assert "| late | 2 | 1 | inf | inf | 3 |" in as_markdown(rows)


def test_a_trial_has_the_defaults_of_the_command_line() -> None:
    trial = trial_of("pendulum-wrap", "50-hz", 7, 4)
    training = trial.config.training
    assert (training.horizon, training.seed, training.iterations, training.episodes_per_iteration) == (500, 7, 4, 1)
    assert trial.config.environment.id == "described:described/pendulum-wrap-50-hz-v0"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tasks", "Pendulm-v1"], "unknown task 'Pendulm-v1', did you mean 'Pendulum-v1'?"),
        (["--descriptions", "degreees"], "unknown description 'degreees', did you mean 'degrees'?"),
        (["--episodes", "0"], "--episodes: expected at least 1, got 0"),
    ],
)
def test_bad_arguments_are_rejected(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert descriptions.main([*arguments, "--out", str(tmp_path)]) == 2
    assert message in capsys.readouterr().err


def test_a_description_that_does_not_apply_is_rejected() -> None:
    with pytest.raises(ValueError, match="degrees: expected a description that applies to MountainCarContinuous-v0"):
        described("MountainCarContinuous-v0", "degrees")
