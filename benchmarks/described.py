"""Write tasks down in different ways, as Gymnasium environments ``described/TASK-DESCRIPTION-v0``.

Importing this module registers them, such as ``described:described/Pendulum-v1-degrees-v0``. A description changes
what is observed, rewarded or sent, or the duration of a step, but not the physics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import gymnasium
import numpy as np
from gymnasium.wrappers import TransformReward

import sim_nodes.envs  # noqa: F401  # registers the tasks
from described_tasks import RATES, TASKS, AnyEnv, Task
from described_wrappers import Affine, Angles, Columns, ConstantColumn, Late, Random, Single, WideActions
from rkhs_ros.base.validation import pick, require

OFFSET = 5.0  # in typical standard deviations of a column
NOISE = 0.01  # likewise
REWARD_OFFSET = 1.0  # per step


def _always(task: Task) -> bool:
    return True


def _has_angles(task: Task) -> bool:
    return bool(task.angles or task.cosines)


@dataclass(frozen=True)
class Description:
    """A way to write a task down.

    Attributes:
        meaning: what differs from the task as written.
        wrap: function from the environment and its task to the described environment.
        applies: whether the description applies to a task and differs from it as written.
        rate: steps per second; 0 for those of the task as written.
        reward_factor: factor of the rewards.
        reward_offset: added to the reward of each step, only if no episode terminates.
    """

    meaning: str
    wrap: Callable[[AnyEnv, Task], AnyEnv] = lambda env, task: env
    applies: Callable[[Task], bool] = _always
    rate: int = 0
    reward_factor: float = 1.0
    reward_offset: float = 0.0

    def threshold(self, task: Task) -> float:
        """Return the threshold of the undiscounted return of the described task."""
        return self.reward_factor * task.threshold + self.offset_of(task) * task.steps

    def original_return(self, task: Task, value: float) -> float:
        """Return an undiscounted return of the described task in the units of the task as written."""
        return (value - self.offset_of(task) * task.steps) / self.reward_factor

    def offset_of(self, task: Task) -> float:
        """Return what is added to the reward of each step."""
        return 0.0 if task.terminates else self.reward_offset


def _at(rate: int) -> Description:
    return Description(
        f"{rate} steps per second; same seconds per episode and reward per second",
        applies=lambda task: task.rate != rate,
        rate=rate,
    )


def _angles(form: str, meaning: str, applies: Callable[[Task], bool]) -> Description:
    return Description(meaning, lambda env, task: Angles(env, task, form), applies)


def _units(name: str, factor: float) -> Description:
    meaning = f"all observations and rewards in {name} of their units"
    return Description(meaning, lambda env, task: Affine(env, factor, 0.0), reward_factor=factor)


DESCRIPTIONS = {
    "as-written": Description("as the author wrote it"),
    "thousandfold": _units("thousandths", 1e3),
    "thousandth": _units("thousands", 1e-3),
    "shifted": Description(
        "5 standard deviations added to each observation column, 1 to each reward unless episodes terminate",
        lambda env, task: Affine(env, 1.0, OFFSET * np.array(task.spread)),
        reward_offset=REWARD_OFFSET,
    ),
    **{f"{rate}-hz": _at(rate) for rate in RATES},
    "wrapped": _angles("wrapped", "angles within [-pi, pi]", lambda task: bool(task.cosines)),
    "unwrapped": _angles("unwrapped", "angles with their whole turns", _has_angles),
    "cosine-sine": _angles("cosine-sine", "cosines and sines of the angles", lambda task: bool(task.angles)),
    "degrees": _angles("degrees", "angles within [-180, 180], angular velocities in degrees per second", _has_angles),
    "constant": Description("a further column that is always 1", lambda env, task: ConstantColumn(env)),
    "duplicate": Description(
        "the first column a second time, as the last one",
        lambda env, task: Columns(env, [*range(len(task.spread)), 0]),
    ),
    "noise-column": Description(
        "a further column of independent N(0, 1) noise",
        lambda env, task: Random(env, np.zeros(len(task.spread)), 1),
    ),
    "wide-actions": Description(
        "action bounds twice as wide; actions beyond the true ones are clipped", lambda env, task: WideActions(env)
    ),
    "late": Description("each observation one step late", lambda env, task: Late(env)),
    "no-velocities": Description(
        "without the columns of velocities",
        lambda env, task: Columns(env, [c for c in range(len(task.spread)) if c not in task.velocities]),
    ),
    "float32": Description(
        "observations in single precision", lambda env, task: Single(env), lambda task: not task.is_single
    ),
    "noisy": Description(
        "N(0, 0.01^2) noise in standard deviations of each observation column",
        lambda env, task: Random(env, NOISE * np.array(task.spread), 0),
    ),
}


def described(task: str, description: str) -> AnyEnv:
    """Return the environment of a description of a task, without a time limit.

    Raises:
        ValueError: a name is unknown, or the description does not apply to the task.
    """
    of, how = pick(task, TASKS, "task"), pick(description, DESCRIPTIONS, "description")
    require(how.applies(of), description, f"a description that applies to {task}", "one that does not")
    env = how.wrap(of.make(how.rate or of.rate), of)
    factor, offset = how.reward_factor, how.offset_of(of)
    if (factor, offset) == (1.0, 0.0):
        return env
    return TransformReward(env, lambda reward: float(factor * reward + offset))


def environment_id(task: str, description: str) -> str:
    """Return the id under which the described task is registered, with its module."""
    return f"{__name__}:described/{task}-{description}-v0"


for _name, _task in TASKS.items():
    for _how, _description in DESCRIPTIONS.items():
        if _description.applies(_task):
            gymnasium.register(
                environment_id(_name, _how).partition(":")[2],
                partial(described, _name, _how),
                max_episode_steps=_task.steps_at(_description.rate or _task.rate),
            )
