"""The keywords of `rkhs_ros.train` and `rkhs_ros.learn`, with their types."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict

from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.model.model_based import ModelSettings
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.policy import Policy
from rkhs_ros.rkhs.kernels import Kernel


class LearnSettings(TypedDict, total=False):
    """Keywords of ``train`` and `learn`; those that are not given have the defaults of `rkhs_ros.runs.defaults`.

    Attributes:
        name: name of the run.
        seed: seed of all randomness.
        iterations: number of policy updates.
        episodes_per_iteration: exploration episodes before each update.
        evaluation_episodes: episodes of an evaluation.
        evaluate_every: iterations from one evaluation to the next; 0 for none.
        horizon: steps of an episode; by default the environment's time limit, or 100 if it has none.
        discount: discount factor of the return, per step.
        action_repeat: number of steps for which the policy holds an action, or "auto".
        exploration_sd: first standard deviation of the actions, one or one per dimension, in units of the action; or
            "range" for half the range of each action.
        inputs: what the policy observes: history, angles, polynomial features.
        kernel: the kernel, how it is chosen, or its form such as "rbf + linear".
        model: model-based training: a `ModelBased`, "gaussian_process" or "none".
        policy: the initial policy, or its file.
        options: keyword arguments of the environment, for an id.
        num_envs: the largest number of copies of the environment that run side by side; 0 for no limit.
    """

    name: str
    seed: int
    iterations: int
    episodes_per_iteration: int
    evaluation_episodes: int
    evaluate_every: int
    horizon: int
    discount: float
    action_repeat: str | int
    exploration_sd: str | Sequence[float]
    inputs: Inputs
    kernel: Kernel | KernelChoice | str
    model: ModelSettings | str
    policy: Policy | str | Path
    options: Mapping[str, Any]
    num_envs: int
