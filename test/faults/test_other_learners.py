"""Learners of Stable-Baselines3 get bit-identical transitions through a simulator node, and learn, also in a model."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest

import sim_nodes.envs  # noqa: F401  # registers the tasks
from test.ros.conftest import Process, domain, start

__all__ = ["domain", "start"]
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(1200)]
TASK, REMOTE = "rkhs/Pendulum-v0", "rkhs/Remote-v0"
DISCOUNT, GOOD = 0.99, 45.0  # of at most 51.8
EQUAL, LEARNT = 1_000, 4_000  # steps
FIELDS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
Start = Callable[..., Process]
Make = Callable[..., Any]


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Limit torch to one thread, in which it is deterministic."""
    torch = pytest.importorskip("torch")
    pytest.importorskip("stable_baselines3")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def remote(start: Start) -> Iterator[Any]:
    start("rkhs", "simulate", "--env", TASK)
    environment = gymnasium.make(REMOTE, timeout=60.0)
    yield environment
    environment.close()


def sac(environment: Any) -> Any:
    from stable_baselines3 import SAC

    small = {"net_arch": [64, 64]}
    options = {"gamma": DISCOUNT, "learning_rate": 1e-3, "learning_starts": 500, "batch_size": 128}
    return SAC("MlpPolicy", environment, policy_kwargs=small, seed=0, **options)


def returned(model: Any, episodes: int = 5) -> float:
    """Return the mean discounted return of a model without exploration, in the environment itself."""
    environment = gymnasium.make(TASK)
    total = 0.0
    for episode in range(episodes):
        observation, _ = environment.reset(seed=1_000 + episode)
        for step in range(100):
            observation, reward, *_ = environment.step(model.predict(observation, deterministic=True)[0])
            total += DISCOUNT**step * float(reward)
    return total / episodes


def learnt(model: Any, steps: int) -> float:
    """Train a model and return the seconds."""
    began = time.monotonic()
    model.learn(steps)
    return time.monotonic() - began


def test_sac_makes_bit_identical_transitions_and_learns(remote: Any) -> None:
    models, reached = {}, {}
    for name, environment in (("over topics", remote), ("direct", gymnasium.make(TASK))):
        models[name] = sac(environment)  # with the seed of torch's only stream
        seconds = learnt(models[name], LEARNT)
        reached[name] = returned(models[name])
        print(f"SAC {name}, {LEARNT} steps: {seconds:.0f} s, evaluation return {reached[name]:.1f}")
    ours, theirs = (model.replay_buffer for model in models.values())
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(ours, field)[:EQUAL], getattr(theirs, field)[:EQUAL], err_msg=field)
    assert ours.timeouts[:EQUAL].sum() == EQUAL // 100
    assert reached["over topics"] == reached["direct"] >= GOOD
