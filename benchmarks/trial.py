"""The table of tasks: the input of a learner, its learning curve, and what measures it."""

import csv
import fcntl
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from io import StringIO
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

import robots  # noqa: F401  # registers their tasks
from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config
from rkhs_ros.studies.aggregates import Estimate, median_over_runs

FIXED_SEED, FIXED_STARTS, LONG_STARTS = 987654, 20, 5  # of the evaluation episodes, which no run explores
LONG = 1000  # steps from which an episode is long
Success = Callable[[Array], Array]  # from observations, shape (N, H, d), to whether each episode succeeds


@dataclass(frozen=True)
class Trial:
    """The input of a learner.

    Attributes:
        config: task, seed, and the settings of learners that use them.
        episodes: budget; the learner stops after the first update that reaches it.
        discounted: whether the thresholds of the task are for the discounted return.
        repeat: steps for which learners without an own choice hold an action.
        success: criterion of the task, if it has one besides the return.
    """

    config: Config
    episodes: int
    discounted: bool = False
    repeat: int = 1
    success: Success | None = None

    @property
    def judged_by(self) -> float:
        """Discount of the return that the thresholds are for."""
        return self.config.training.discount if self.discounted else 1.0

    @property
    def evaluation(self) -> Batch:
        """The evaluation episodes after each update, which are the same for all learners and seeds."""
        horizon = self.config.training.horizon
        return Batch(FIXED_SEED, 0, LONG_STARTS if horizon >= LONG else FIXED_STARTS, horizon, explore=False)


class Point(NamedTuple):
    """One point of a learning curve, after an update.

    Attributes:
        episodes: real exploration episodes so far.
        steps: steps of these episodes.
        cpu_seconds: CPU time of training and exploration so far, over all threads, without evaluations.
        undiscounted_return: mean over the evaluation episodes.
        discounted_return: the same with the task's discount.
        least_return: the least undiscounted return.
        succeeded: share of the episodes that meet the task's own criterion; nan if it has none.
        action_repeat: steps for which the policy holds an action.
    """

    episodes: int
    steps: int
    cpu_seconds: float
    undiscounted_return: float
    discounted_return: float
    least_return: float
    succeeded: float
    action_repeat: int


class Meter:
    """Counts episodes, steps and CPU time of a learner. Owns the counts.

    Args:
        trial: what the learner learns.
    """

    def __init__(self, trial: Trial) -> None:
        self.episodes = 0
        self.steps = 0
        self._trial = trial
        self._begin = time.process_time()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Exclude the CPU time of the block."""
        at = time.process_time()
        yield
        self._begin += time.process_time() - at

    def point(self, rewards: Array, observations: Array, action_repeat: int) -> Point:
        """Return the point of the curve for evaluation episodes.

        Args:
            rewards: shape (N, H), 0 after the end of an episode.
            observations: raw observations before each action, shape (N, H, d).
            action_repeat: steps for which the policy holds an action.
        """
        seconds, success = time.process_time() - self._begin, self._trial.success
        discounts = self._trial.config.training.discount ** np.arange(rewards.shape[1])
        undiscounted = rewards.sum(axis=1)
        return Point(
            self.episodes,
            self.steps,
            seconds,
            float(undiscounted.mean()),
            float((rewards @ discounts).mean()),
            float(undiscounted.min()),
            float(success(observations).mean()) if success else float("nan"),
            action_repeat,
        )


class MeteredRunner:
    """Rolls out policies in the task of a trial, counts exploration episodes, and evaluates.

    Args:
        trial: what the learner learns.
    """

    def __init__(self, trial: Trial) -> None:
        self.meter = Meter(trial)
        self._trial = trial
        self._runner = runner_of(trial.config.environment)
        self.spaces = self._runner.spaces

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""
        episodes = self._runner.collect(policy, batch)
        self.meter.episodes += len(episodes)
        self.meter.steps += int(episodes.mask.sum())
        return episodes

    def evaluated(self, policy: GaussianPolicy) -> Point:
        """Return the point of the curve for a policy."""
        with self.meter.paused():
            episodes = self._runner.collect(policy, self._trial.evaluation)
        return self.meter.point(episodes.rewards, episodes.observations, policy.action_repeat)


NEVER = 1e15  # episodes or steps, instead of infinity, so that means and differences are defined


def median_until(values: Array) -> Estimate:
    """Return the median over the runs of counts, some of which may be infinite."""
    estimate = median_over_runs(np.minimum(values, NEVER))
    return Estimate(*(np.inf if number > NEVER / 1e5 else float(number) for number in estimate))


@dataclass(frozen=True)
class Task:
    """A task of the table.

    Attributes:
        environment: Gymnasium id.
        thresholds: thresholds of the evaluation return.
        rate: steps per second of experience; nan if the task has no time.
        episodes: budget of learners with a model.
        changes: settings that the task needs besides its horizon.
        discounted: whether the thresholds are for the discounted return.
        packages: packages that must be installed.
        success: the task's own criterion, if it has one.
    """

    environment: str
    thresholds: tuple[float, ...]
    rate: float
    episodes: int = 15
    changes: tuple[str, ...] = ()
    discounted: bool = False
    packages: tuple[str, ...] = ()
    success: Success | None = None


def balanced(observations: Array) -> Array:
    """Return whether the cart and the pole of each episode are in the middle and upright in the last second."""
    x, cosine, sine = np.moveaxis(observations[:, -20:], 2, 0)[[0, 2, 3]]
    angle = np.pi - np.abs(np.arctan2(sine, cosine))
    return np.asarray(((np.abs(x) <= 0.1) & (angle <= 0.25)).all(axis=1))


CLIP, WRAP = (f"environment.options.angle={at_the_ends}" for at_the_ends in ("clip", "wrap"))
ANGLE, WINDOW = "inputs.angles=[0]", "inputs.history=5"
SWUNG_UP = (45.0, 50.0)  # of 51.8 at best
MUJOCO = ("mujoco",)
# These tasks declare no horizon.
dm_control = partial(Task, changes=("horizon=1000",), packages=("shimmy", "dm-control", "mujoco"))
TASKS = {
    "pendulum-clip": Task("rkhs/Pendulum-v0", SWUNG_UP, 10, changes=(CLIP,), discounted=True),
    "pendulum-wrap": Task("rkhs/Pendulum-v0", SWUNG_UP, 10, changes=(WRAP, ANGLE), discounted=True),
    "pendulum-pomdp": Task("rkhs/PendulumPOMDP-v0", SWUNG_UP, 10, changes=(ANGLE, WINDOW), discounted=True),
    "Pendulum-v1": Task("Pendulum-v1", (-170.0, -150.0), 20),
    "cart-pole": Task("rkhs/CartPoleSwingUp-v0", (45.0, 48.0), 20, success=balanced),
    "cartpole-swingup": dm_control("shimmy:dm_control/cartpole-swingup-v0", (750.0,), 100),
    "cartpole-balance": dm_control("shimmy:dm_control/cartpole-balance-v0", (950.0,), 100, 5),
    "pendulum-swingup": dm_control("shimmy:dm_control/pendulum-swingup-v0", (750.0,), 50),
    "reacher-easy": dm_control("shimmy:dm_control/reacher-easy-v0", (900.0,), 50, 30),
    "ball-in-cup": dm_control("shimmy:dm_control/ball_in_cup-catch-v0", (900.0,), 50, 30),
    "InvertedPendulum-v5": Task("InvertedPendulum-v5", (900.0, 999.0), 25, 12, packages=MUJOCO),
    "InvertedDoublePendulum-v5": Task("InvertedDoublePendulum-v5", (9000.0,), 20, 40, packages=MUJOCO),
    "Reacher-v5": Task("Reacher-v5", (-7.0, -6.0), 50, 30, packages=MUJOCO),
    "Swimmer-v5": Task("Swimmer-v5", (30.0, 100.0), 25, packages=MUJOCO),
    "MountainCarContinuous-v0": Task("MountainCarContinuous-v0", (90.0,), float("nan"), 5),
    "ball-on-beam": Task("rkhs/BallOnBeam-v0", (-0.2,), 50),
    "tanks": Task("rkhs/Tanks-v0", (-2.0,), 1),
    "furuta": Task("rkhs/Furuta-v0", (150.0,), 100),
    "motor-pendulum": Task("robots/MotorPendulum-v0", SWUNG_UP, 10, changes=(ANGLE,), discounted=True),
    "arm": Task("robots/Arm-v0", (20.0, 24.0), 5, changes=("inputs.history=2",), packages=("pybullet",)),
    "pr2-door": Task(
        "rkhs/PR2Door-v0",
        (0.5, 0.8),
        float("nan"),
        100,
        ("environment.options.pose=per_episode",),
        packages=("pybullet",),
    ),
}


class Key(NamedTuple):
    """What a curve is of."""

    task: str
    learner: str
    seed: int


Curves = dict[Key, list[Point]]
Row = TypeVar("Row")
HEAD = (*Key._fields, *Point._fields)


def as_csv(head: Sequence[str], lines: Iterable[Sequence[object]]) -> str:
    """Return a CSV file."""
    text = StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([head, *lines])
    return text.getvalue()


def rows_of(path: Path, head: Sequence[str], row: Callable[..., Row]) -> list[Row]:
    """Return what ``row`` makes of the entries of each line of a CSV file below its head.

    Raises:
        ValueError: the file has another head, or ``row`` does not accept a line.
    """
    try:
        with path.open(newline="") as file:
            first, *lines = list(csv.reader(file)) or [[]]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path}: expected a CSV file, got one that cannot be read: {error}") from None
    require(first == [*head], f"{path}", f"a first line {','.join(head)}", ",".join(first))
    rows = []
    for number, line in enumerate(lines, 2):
        try:
            rows.append(row(*line))
        except (ValueError, TypeError):
            what = f"{path}, line {number}"
            raise ValueError(f"{what}: expected values of {','.join(head)}, got {','.join(line)}") from None
    return rows


def read_curves(path: Path) -> Curves:
    """Return the curves of a file; none if it does not exist.

    Raises:
        ValueError: the file has another content.
    """
    curves: Curves = {}
    for key, point in rows_of(path, HEAD, _row) if path.exists() else []:
        its = curves.setdefault(key, [])
        episodes, steps = its[-1][:2] if its else (0, 0)
        rises = point.episodes > episodes and point.steps > steps
        require(rises, f"{path}", f"more episodes and steps of {' '.join(map(str, key))} in each line", point.episodes)
        its.append(point)
    return curves


def _row(task: str, learner: str, seed: str, episodes: str, steps: str, *rest: str) -> tuple[Key, Point]:
    *numbers, repeat = rest
    return Key(task, learner, int(seed)), Point(int(episodes), int(steps), *map(float, numbers), int(repeat))


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock the folder of a file while this process adds to the file, since others add, too."""
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)


def add_curves(path: Path, curves: Curves) -> None:
    """Add curves to a file, sorted by task, learner and seed."""
    with locked(path):
        lines = [
            (*key, *map(_text, point)) for key, its in sorted((read_curves(path) | curves).items()) for point in its
        ]
        write_whole(path, as_csv(HEAD, lines).encode())


def _text(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"
