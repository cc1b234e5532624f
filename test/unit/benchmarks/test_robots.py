"""The simulated robots as environments in benchmarks/."""

import gymnasium
import numpy as np
import pytest

import robots  # noqa: F401  # registers the environments


def episode(name: str, seed: int, actions: list[float]) -> tuple[np.ndarray, np.ndarray, dict[str, object]]:
    """Return observations, rewards and the robot's report of an episode; each action is for all components."""
    environment = gymnasium.make(f"robots/{name}-v0")
    observations, rewards = [environment.reset(seed=seed)[0]], []
    for action in actions:
        observation, reward, *_ = environment.step(np.full(environment.action_space.shape, action))
        observations.append(observation)
        rewards.append(float(reward))
    return np.array(observations), np.array(rewards), environment.unwrapped._hardware.report()


def test_the_motor_turns_the_pendulum_as_its_torque_says() -> None:
    observations, rewards, _ = episode("MotorPendulum", 3, [2.0] * 15)
    times = 0.1 * np.arange(16) - 0.01  # the delays of a command and a sample are at most 0.03 s
    noise = 0.04 / np.sqrt(0.05) * times[1:] ** 1.5  # accumulated in the angle, up to a factor
    assert (np.abs(observations[1:, 0] - (times[1:] ** 2 - np.pi)) < 3 * noise + 0.05 * times[1:] + 0.01).all()
    np.testing.assert_allclose(rewards, np.exp(-0.5 * observations[:-1, 0] ** 2))


@pytest.mark.parametrize("name", ["MotorPendulum", "Arm"])
def test_an_episode_depends_on_its_seed_alone_and_violates_no_limit(name: str) -> None:
    pytest.importorskip("pybullet")
    actions = [3.0, -3.0, 0.2, 3.0]
    first, again, other = (episode(name, seed, actions) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first[0], again[0])
    assert (first[0] != other[0]).any()
    assert first[2]["violations"] == 0
