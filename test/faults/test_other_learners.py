"""A learner of Stable-Baselines3 has bit-identical transitions through a simulator node, and learns."""

from collections.abc import Callable

import gymnasium
import numpy as np
import pytest

import sim_nodes.envs  # noqa: F401  # registers the tasks
from test.ros.conftest import Process, domain, start

__all__ = ["domain", "start"]
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(1200)]
TASK, DISCOUNT, GOOD = "rkhs/Pendulum-v0", 0.99, 45.0  # of at most 51.8
FIELDS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def test_sac_makes_bit_identical_transitions_and_learns(start: Callable[..., Process]) -> None:
    torch, sb3 = pytest.importorskip("torch"), pytest.importorskip("stable_baselines3")
    torch.set_num_threads(1)  # in which it is deterministic
    start("rkhs", "simulate", "--env", TASK)
    options = {"gamma": DISCOUNT, "learning_rate": 1e-3, "learning_starts": 500, "batch_size": 128}
    models = []
    for environment in (gymnasium.make("rkhs/Remote-v0", timeout=60.0), gymnasium.make(TASK)):
        models.append(sb3.SAC("MlpPolicy", environment, policy_kwargs={"net_arch": [64, 64]}, seed=0, **options))
        models[-1].learn(4_000)  # at once, with the seed of torch's only stream
        environment.close()
    ours, theirs = (model.replay_buffer for model in models)
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(ours, field)[:4_000], getattr(theirs, field)[:4_000], err_msg=field)
    task, total = gymnasium.make(TASK), 0.0
    for episode in range(5):
        observation, _ = task.reset(seed=1_000 + episode)
        for step in range(100):
            observation, reward, *_ = task.step(models[0].predict(observation, deterministic=True)[0])
            total += DISCOUNT**step * float(reward) / 5
    assert total >= GOOD
