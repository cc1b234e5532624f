from collections.abc import Iterator
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import SyncVectorEnv

import rkhs_ros
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.env_batch import MOST_VECTORS
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation


class Walk(gymnasium.Env[np.ndarray, np.ndarray]):
    """Environment with observations of shape (2, 2) that terminates when the sum of the actions exceeds 3."""

    observation_space = Box(-100.0, 100.0, (2, 2), np.float32)
    action_space = Box(-1.0, 2.0, (1, 2), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self.position, self.offset = 0.0, float(self.np_random.uniform())
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        assert action.shape == (1, 2)
        assert action.dtype == np.float32
        self.position += float(action.sum())
        return self._observation(), 1.0, self.position > 3.0, False, {}

    def _observation(self) -> np.ndarray:
        return np.array([[self.position, self.offset], [0, 1]], dtype=np.float32)


@pytest.fixture
def walk() -> Iterator[Simulation]:
    gymnasium.register("test/Walk-v0", Walk)
    yield Simulation("test/Walk-v0")
    del gymnasium.registry["test/Walk-v0"]


def batch(num_envs: int, horizon: int, first: int = 0) -> Batch:
    return Batch(0, first, num_envs, horizon, explore=True)


def test_observations_and_actions_are_flattened(walk: Simulation) -> None:
    assert (walk.spaces.observation_dim, walk.spaces.action_dim) == (4, 2)
    assert (walk.spaces.action_low.tolist(), walk.spaces.action_high.tolist()) == ([[-1, -1]], [[2, 2]])
    frame = walk.start(batch(3, 5))
    assert frame.observations.shape == (3, 4)
    assert frame.observations.dtype == np.float64
    assert frame.active.all()


def test_actions_of_a_type_that_recordings_do_not_have_are_refused() -> None:
    class Half(Walk):
        action_space = Box(-1.0, 2.0, (1, 2), np.float16)

    with pytest.raises(ValueError, match=r"Half actions: expected numbers of type float32 or float64, got float16"):
        Simulation(Half)


def test_a_gymnasium_environment_is_simulated() -> None:
    simulation = Simulation("Pendulum-v1", {"g": 9.0})
    spaces = simulation.spaces
    assert (spaces.observation_dim, spaces.action_dim, spaces.action_high.tolist()) == (3, 1, [2.0])
    simulation.start(batch(2, 210))  # longer than its time limit of 200
    frames = [simulation.step(np.zeros((2, 1))) for _ in range(210)]
    assert [frame.active.all() for frame in frames] == [True] * 209 + [False]
    assert all((frame.rewards < 0).all() for frame in frames)


class Robot(Walk):
    """Environment of which only one instance can exist, like a robot."""

    is_in_use = False
    metadata: ClassVar[dict[str, Any]] = {"num_envs": 1, "render_modes": []}

    def __init__(self, actions: int = 1) -> None:
        if Robot.is_in_use:
            raise RuntimeError("in use")
        Robot.is_in_use = True
        if actions != 1:
            self.action_space = Discrete(actions)  # type: ignore[assignment]

    def close(self) -> None:
        Robot.is_in_use = False


@pytest.fixture
def robot() -> Iterator[str]:
    gymnasium.register("test/Robot-v0", Robot, max_episode_steps=3)
    yield "test/Robot-v0"
    del gymnasium.registry["test/Robot-v0"]
    Robot.is_in_use = False


SHORT: dict[str, Any] = {"iterations": 2, "episodes_per_iteration": 2, "evaluation_episodes": 1, "horizon": 3}
SHORT |= {"model": "none", "progress": False}


@pytest.mark.parametrize("source", [None, lambda: SyncVectorEnv([Robot])], ids=["id", "function"])
def test_training_closes_the_environments_that_it_creates(robot: str, source: Any) -> None:
    rkhs_ros.train(source or robot, **SHORT)
    gymnasium.make(robot).close()
    with pytest.raises(ValueError, match=r"^iterations: "):
        rkhs_ros.train(source or robot, **SHORT | {"iterations": -1})
    for _ in rkhs_ros.learn(source or robot, **{k: v for k, v in SHORT.items() if k != "progress"}):
        break
    gymnasium.make(robot)


@pytest.mark.parametrize(("is_vector", "batches"), [(False, MOST_VECTORS + 2), (True, 2)])
def test_a_passed_environment_stays_open(robot: str, is_vector: bool, batches: int) -> None:
    passed: Any = SyncVectorEnv([Robot]) if is_vector else gymnasium.make(robot)
    with InlineRunner(Simulation(passed)) as runner:
        for horizon in range(1, batches + 1):
            runner.simulation.start(batch(1, horizon))
    assert Robot.is_in_use
    rkhs_ros.train(passed, **SHORT)
    assert Robot.is_in_use
