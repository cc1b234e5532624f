"""Define the tasks that `described` writes down in several ways, each at any number of steps per second.

The duration of an episode in seconds and the reward per second do not depend on the rate. So one threshold of the
undiscounted return holds for all rates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.classic_control.continuous_mountain_car import Continuous_MountainCarEnv
from gymnasium.wrappers import TransformReward

from sim_nodes.envs.pendulum import Pendulum
from sim_nodes.envs.vector_task import Array, SingleTask

AnyEnv = gymnasium.Env[Any, Any]
RATES = (10, 20, 50, 100)  # steps per second
MOUNTAIN_CAR_RATE = 30  # its frames per second; it has no other unit of time
REACHER_TIMESTEP = 0.01  # of its physics, in seconds


@dataclass(frozen=True)
class Task:
    """A task and what the descriptions must know about it.

    Attributes:
        make: function from the steps per second to an environment without a time limit.
        rate: steps per second as written.
        steps: steps of an episode as written.
        threshold: threshold of the undiscounted return.
        spread: typical standard deviation of each observation column while the task is learnt.
        velocities: columns of all velocities.
        angular_velocities: columns of the velocities of angles.
        angles: columns of angles in radians, wrapped to [-pi, pi).
        cosines: columns of the cosines of angles.
        sines: columns of the sines of the same angles.
        terminates: whether an episode may end before its time limit.
        is_single: whether the observations have single precision as written.
        packages: packages that must be installed.
    """

    make: Callable[[int], AnyEnv]
    rate: int
    steps: int
    threshold: float
    spread: tuple[float, ...]
    velocities: tuple[int, ...]
    angular_velocities: tuple[int, ...] = ()
    angles: tuple[int, ...] = ()
    cosines: tuple[int, ...] = ()
    sines: tuple[int, ...] = ()
    terminates: bool = False
    is_single: bool = False
    packages: tuple[str, ...] = ()

    def steps_at(self, rate: int) -> int:
        """Return the steps of an episode at another rate."""
        return round(self.steps * rate / self.rate)


class PendulumAtRate(Pendulum):
    """`Pendulum` with another duration of a step.

    Integrates in Euler steps of at most 0.05 s, as the original does. The noise has the same variance per second.

    Args:
        rate: steps per second.
    """

    def __init__(self, rate: int) -> None:
        self.step_seconds = 1.0 / rate
        self.substeps = max(1, round(20 / rate))
        self.noise_dim = 2 * self.substeps
        super().__init__(angle="wrap")

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        h = self.step_seconds / self.substeps
        sds = self.noise_sd * np.sqrt(h / 0.05) * np.array([[1.0], [2.0]])
        columns = states.T
        for kick in noise.T.reshape(self.substeps, 2, -1):
            columns = columns + h * np.stack([columns[1], actions[:, 0]]) + sds * kick
            self._bound(columns)
        return columns.T

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        return super().reward(states, actions) * self.step_seconds / Pendulum.step_seconds


class MountainCarAtRate(Continuous_MountainCarEnv):
    """MountainCarContinuous-v0 with another duration of a step.

    Integrates in steps of at most the original one. The cost of the force is per second, and the reward at the goal
    is unchanged. The velocity is per original step.

    Args:
        rate: steps per second; the original has 30.
    """

    def __init__(self, rate: int) -> None:
        super().__init__()
        self._duration = MOUNTAIN_CAR_RATE / rate  # in original steps
        self._substeps = max(1, int(np.ceil(self._duration)))

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Make one step."""
        position, velocity = (float(value) for value in self.state)
        terminated, h = False, self._duration / self._substeps
        for _ in range(self._substeps):
            position, velocity = self._moved(position, velocity, float(np.clip(action[0], -1.0, 1.0)), h)
            terminated = position >= self.goal_position and velocity >= self.goal_velocity
            if terminated:
                break
        self.state = np.array([position, velocity], dtype=np.float32)
        return self.state, 100.0 * terminated - 0.1 * float(action[0]) ** 2 * self._duration, terminated, False, {}

    def _moved(self, position: float, velocity: float, force: float, h: float) -> tuple[float, float]:
        velocity += h * (force * self.power - 0.0025 * float(np.cos(3 * position)))
        velocity = min(max(velocity, -self.max_speed), self.max_speed)
        position = min(max(position + h * velocity, self.min_position), self.max_position)
        return position, 0.0 if position == self.min_position and velocity < 0 else velocity


def _original(environment: str, **options: Any) -> AnyEnv:
    """Return an environment without a time limit, and without a specification, since its descriptions differ."""
    env: AnyEnv = gymnasium.make(environment, max_episode_steps=-1, disable_env_checker=True, **options).unwrapped
    env.spec = None
    return env


def _per_second(env: AnyEnv, seconds: float) -> AnyEnv:
    """Multiply the rewards by the duration of a step relative to the original one."""
    return TransformReward(env, lambda reward: float(reward) * seconds)


def _pendulum_wrap(rate: int) -> AnyEnv:
    return _original("rkhs/Pendulum-v0", angle="wrap") if rate == 10 else SingleTask(PendulumAtRate(rate))


def _pendulum_v1(rate: int) -> AnyEnv:
    env: Any = _original("Pendulum-v1")
    env.dt = 1.0 / rate
    return env if rate == 20 else _per_second(env, 20 / rate)


def _cart_pole(rate: int) -> AnyEnv:
    return _original("rkhs/CartPoleSwingUp-v0", rate=rate, observation="cosine")  # its reward is per second


def _reacher(rate: int) -> AnyEnv:
    env = _original("Reacher-v5", frame_skip=round(1 / (REACHER_TIMESTEP * rate)))
    return env if rate == 50 else _per_second(env, 50 / rate)


def _mountain_car(rate: int) -> AnyEnv:
    return _original("MountainCarContinuous-v0") if rate == MOUNTAIN_CAR_RATE else MountainCarAtRate(rate)


TASKS = {
    "pendulum-wrap": Task(
        _pendulum_wrap, 10, 100, 80.0, (1.8, 2.0), velocities=(1,), angular_velocities=(1,), angles=(0,)
    ),
    "Pendulum-v1": Task(
        _pendulum_v1,
        20,
        200,
        -150.0,
        (0.7, 0.7, 3.0),
        velocities=(2,),
        angular_velocities=(2,),
        cosines=(0,),
        sines=(1,),
        is_single=True,
    ),
    "cart-pole": Task(
        _cart_pole,
        20,
        60,
        45.0,
        (0.4, 1.2, 0.7, 0.7, 4.0),
        velocities=(1, 4),
        angular_velocities=(4,),
        cosines=(2,),
        sines=(3,),
    ),
    "Reacher-v5": Task(
        _reacher,
        50,
        50,
        -7.0,
        (0.6, 0.6, 0.6, 0.6, 0.1, 0.1, 6.0, 6.0, 0.15, 0.15),
        velocities=(6, 7),
        angular_velocities=(6, 7),
        cosines=(0, 1),
        sines=(2, 3),
        packages=("mujoco",),
    ),
    "MountainCarContinuous-v0": Task(
        _mountain_car,
        MOUNTAIN_CAR_RATE,
        999,
        90.0,
        (0.35, 0.025),
        velocities=(1,),
        terminates=True,
        is_single=True,
    ),
}
