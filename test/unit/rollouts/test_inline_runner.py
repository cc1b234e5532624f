import numpy as np
import pytest

from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import RBF, Kernel, Polynomial
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from sim_nodes.envs.lever_stafford import Pendulum
from test.unit.conftest import random_policy

ARRAYS = ("observations", "actions", "rewards", "mask")


@pytest.fixture
def runner() -> InlineRunner:
    return InlineRunner(Simulation("rkhs/Pendulum-v0"))


def test_episodes_align_observations_actions_and_rewards(runner: InlineRunner, rng: np.random.Generator) -> None:
    policy, batch = random_policy(rng, n=1), Batch(3, 20, 2, 6, explore=True)
    episodes = runner.collect(policy, batch)
    task, exploration = Pendulum(2), batch.exploration(1)
    observations = task.reset(seed=batch.environment_seeds())[0]
    for t in range(6):
        assert np.array_equal(episodes.observations[:, t], observations)
        actions = policy.act(observations, exploration[:, t])
        assert np.array_equal(episodes.actions[:, t], actions)  # as sampled, not clipped
        observations, rewards, *_ = task.step(actions)
        assert np.array_equal(episodes.rewards[:, t], rewards)
    assert episodes.mask.all()


@pytest.mark.parametrize(
    ("kernel", "learnt", "sizes"), [(RBF((1.0, 2.0)), False, (1,) * 7), (Polynomial(1.0, 2), True, (3, 4))], ids=str
)
def test_episodes_do_not_depend_on_the_split_into_batches(
    runner: InlineRunner, rng: np.random.Generator, kernel: Kernel, learnt: bool, sizes: tuple[int, ...]
) -> None:
    policy = random_policy(rng, n=1, m=40, kernel=kernel, learnt=learnt)
    together = runner.collect(policy, Batch(0, 10, 7, 30, explore=True))
    starts = np.cumsum([10, *sizes])
    parts = [
        runner.collect(policy, Batch(0, int(start), size, 30, explore=True))
        for start, size in zip(starts, sizes, strict=False)
    ]
    for name in ARRAYS:
        assert np.array_equal(np.concatenate([getattr(part, name) for part in parts]), getattr(together, name))
