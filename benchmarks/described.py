"""Write two tasks down in several ways, as Gymnasium environments ``described/TASK-DESCRIPTION-v0``.

A description changes what is observed, rewarded or sent, or the duration of a step, but not the physics. The duration
of an episode and the reward per second stay the same. Importing this module registers the environments.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.wrappers import TransformAction, TransformReward

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.environments import time_limit
from sim_nodes.envs.lever_stafford import HIGH, LOW, Pendulum
from sim_nodes.envs.vector_task import SingleTask, clip, wrapped
from trial import Task

STREAM = 20_231  # separates the random numbers of a description from those of its task
AnyEnv = gymnasium.Env[Any, Any]
Observe = Callable[[Array], Array]  # from an observation to the described one


class PendulumAtRate(Pendulum):
    """`Pendulum` with other steps per second: Euler steps of at most 0.05 s, and noise of the same variance per second.

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
            columns[0] = wrapped(columns[0])
            columns = clip(columns, LOW, HIGH)
        return columns.T

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        return super().reward(states, actions) * self.step_seconds / Pendulum.step_seconds


def _pendulum(rate: int) -> AnyEnv:
    return _original("rkhs/Pendulum-v0", angle="wrap") if rate == 10 else SingleTask(PendulumAtRate(rate))


def _cart_pole(rate: int) -> AnyEnv:
    return _original("rkhs/CartPoleSwingUp-v0", rate=rate)  # its reward is per second


def _original(name: str, **options: Any) -> AnyEnv:
    """Return an environment without a time limit, and without a specification, since its descriptions differ."""
    env: AnyEnv = gymnasium.make(name, max_episode_steps=-1, disable_env_checker=True, **options).unwrapped
    env.spec = None
    return env


@dataclass(frozen=True)
class Subject:
    """A task that is written down in several ways.

    Attributes:
        make: function from the steps per second to an environment without a time limit.
        written: threshold and steps per second of the task as written, and the episodes of a run.
        spread: typical standard deviation of each observation column while the task is learnt.
        angle: columns of the angle, or of its cosine and sine.
        turning: column of the angular velocity.
        velocities: columns of all velocities.
    """

    make: Callable[[int], AnyEnv]
    written: Task
    spread: tuple[float, ...]
    angle: tuple[int, ...]
    turning: int
    velocities: tuple[int, ...]

    @property
    def steps(self) -> int:
        """Steps of an episode as written."""
        return time_limit(self.written.environment) or 0

    @property
    def columns(self) -> range:
        """The columns of an observation."""
        return range(len(self.spread))

    def angle_of(self, observation: Array) -> float:
        """Return the angle in radians."""
        found = observation[[*self.angle]]
        return float(found[0] if len(found) == 1 else np.arctan2(found[1], found[0]))


SUBJECTS = {
    "pendulum": Subject(
        _pendulum, Task("rkhs/Pendulum-v0", (80.0,), 10, 8), (1.8, 2.0), angle=(0,), turning=1, velocities=(1,)
    ),
    "cart-pole": Subject(
        _cart_pole,
        Task("rkhs/CartPoleSwingUp-v0", (45.0,), 20, 12),
        (0.4, 1.2, 0.7, 0.7, 4.0),
        angle=(2, 3),
        turning=4,
        velocities=(1, 4),
    ),
}


def _as_it_is(task: Subject, first: Array, rng: np.random.Generator) -> Observe:
    return lambda observation: observation


@dataclass(frozen=True)
class Description:
    """A way to write a task down.

    Attributes:
        observe: returns the described observations of an episode; given its task, its first observation and a random
            stream.
        applies: whether it differs from the task as written.
        rate: steps per second; 0 for those of the task as written.
        factor: of the rewards.
        offset: added to the reward of each step.
        room: half the range of the actions, relative to the true one, beyond which they are clipped.
        dtype: type of the observations.
    """

    observe: Callable[[Subject, Array, np.random.Generator], Observe] = _as_it_is
    applies: Callable[[Subject], bool] = lambda task: True
    rate: int = 0
    factor: float = 1.0
    offset: float = 0.0
    room: float = 1.0
    dtype: type[np.floating[Any]] = np.float64


def _affine(factor: float, shift: float) -> Any:
    return lambda task, first, rng: lambda o: o * factor + shift * np.array(task.spread)


def _columns(of: Callable[[Subject], Sequence[int]]) -> Any:
    return lambda task, first, rng: lambda o: o[[*of(task)]]


def _angle(form: Callable[[float], Sequence[float]], turning: float = 1.0) -> Any:
    """Replace the angle by a form of it, in the first columns, and scale its velocity."""

    def observe(task: Subject, first: Array, rng: np.random.Generator) -> Observe:
        scales = np.array([turning if column == task.turning else 1.0 for column in task.columns])
        rest = [column for column in task.columns if column not in task.angle]
        return lambda o: np.concatenate([form(task.angle_of(o)), (o * scales)[rest]])

    return observe


def _unwrapped(task: Subject, first: Array, rng: np.random.Generator) -> Observe:
    last = task.angle_of(first)

    def form(angle: float) -> list[float]:
        nonlocal last
        last = last + (angle - last + np.pi) % (2 * np.pi) - np.pi  # no angle turns by half a turn in a step
        return [last]

    return _angle(form)(task, first, rng)


def _late(task: Subject, first: Array, rng: np.random.Generator) -> Observe:
    last = first

    def observed(observation: Array) -> Array:
        nonlocal last
        late, last = last, observation
        return late

    return observed


def _noise_column(task: Subject, first: Array, rng: np.random.Generator) -> Observe:
    return lambda o: np.append(o, rng.standard_normal(len(o) + 1)[-1])


def _noisy(task: Subject, first: Array, rng: np.random.Generator) -> Observe:
    return lambda o: o + 0.01 * np.array(task.spread) * rng.standard_normal(len(o))


def _at(rate: int) -> Description:
    return Description(applies=lambda task: task.written.rate != rate, rate=rate)


DESCRIPTIONS = {
    "as-written": Description(),
    "thousandfold": Description(_affine(1e3, 0.0), factor=1e3),
    "thousandth": Description(_affine(1e-3, 0.0), factor=1e-3),
    "shifted": Description(_affine(1.0, 5.0), offset=1.0),
    **{f"{rate}-hz": _at(rate) for rate in (10, 20, 50, 100)},
    "wrapped": Description(_angle(lambda angle: [angle]), lambda task: len(task.angle) == 2),
    "unwrapped": Description(_unwrapped),
    "cosine-sine": Description(_angle(lambda angle: [np.cos(angle), np.sin(angle)]), lambda task: len(task.angle) == 1),
    "degrees": Description(_angle(lambda angle: [np.degrees(angle)], turning=180.0 / np.pi)),
    "constant": Description(lambda task, first, rng: lambda o: np.append(o, 1.0)),
    "duplicate": Description(_columns(lambda task: (*task.columns, 0))),
    "noise-column": Description(_noise_column),
    "wide-actions": Description(room=2.0),
    "late": Description(_late),
    "no-velocities": Description(_columns(lambda task: [c for c in task.columns if c not in task.velocities])),
    "float32": Description(dtype=np.float32),
    "noisy": Description(_noisy),
}


class Described(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A task with other observations. Owns those of the episode, and the random stream.

    Args:
        env: the task.
        task: what is known of it.
        description: how it is written down.
    """

    def __init__(self, env: AnyEnv, task: Subject, description: Description) -> None:
        super().__init__(env)
        self._task, self._description = task, description
        shape = self._observed(np.zeros(len(task.columns)), 0).shape
        self.observation_space = Box(-np.inf, np.inf, shape, description.dtype)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._observed(np.asarray(observation, dtype=np.float64), seed), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Make one step."""
        observation, *others = self.env.step(action)
        return (self._observe(np.asarray(observation, dtype=np.float64)).astype(self._description.dtype), *others)

    def _observed(self, first: Array, seed: int | None) -> Any:
        if seed is not None:
            self._rng = np.random.default_rng([STREAM, seed])
        self._observe = self._description.observe(self._task, first, self._rng)
        return self._observe(first).astype(self._description.dtype)


def described(task: str, description: str) -> AnyEnv:
    """Return the environment of a description of a task, without a time limit."""
    of, how = SUBJECTS[task], DESCRIPTIONS[description]
    env = Described(of.make(how.rate or round(of.written.rate)), of, how)
    true: Any = env.action_space
    if how.room != 1.0:
        middle, half = (true.high + true.low) / 2, how.room * (true.high - true.low) / 2
        wide = Box(middle - half, middle + half, dtype=true.dtype)
        env = TransformAction(env, lambda action: np.clip(action, true.low, true.high), wide)  # type: ignore[assignment]
    if (how.factor, how.offset) != (1.0, 0.0):
        return TransformReward(env, lambda reward: float(how.factor * reward + how.offset))
    return env


def name_of(task: str, description: str) -> str:
    """Return the Gymnasium id of a described task, with its module."""
    return f"{__name__}:described/{task}-{description}-v0"


for _name, _task in SUBJECTS.items():
    for _how, _description in DESCRIPTIONS.items():
        if _description.applies(_task):
            gymnasium.register(
                name_of(_name, _how).partition(":")[2],
                partial(described, _name, _how),
                max_episode_steps=round(_task.steps * (_description.rate or _task.written.rate) / _task.written.rate),
            )
