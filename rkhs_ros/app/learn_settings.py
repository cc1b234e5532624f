"""The keywords of `rkhs_ros.train` and `rkhs_ros.learn`, with their types, checks and defaults."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypedDict

from rkhs_ros.base.settings import build
from rkhs_ros.base.validation import hint, nearest, pick, require
from rkhs_ros.learning.algorithms.algorithm import Algorithm
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.training_settings import MODELS, ModelSettings, NoModel, Training
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.policy import Policy
from rkhs_ros.rkhs.kernels import Array, Kernel
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import name_of_run
from rkhs_ros.runs.defaults import settings_for


class LearnSettings(TypedDict, total=False):
    """Keywords of ``train`` and `learn`; those that are not given have the defaults of `Training`.

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
        inputs: what the policy observes: history and angles.
        kernel: the kernel, how it is chosen, or its form such as "rbf + linear".
        model: model-based training: a `ModelBased`, "gaussian_process" or "none".
        policy: the initial policy, or its file.
        options: keyword arguments of the environment, for an id.
        num_envs: the largest number of copies of the environment that run side by side; 0 for no limit.
        out: new or empty folder for the files of a run, those of ``rkhs train --out``; without it, nothing is written.
        resume: resume the run in ``out``, which needs equal settings except for ``iterations``; start it if there is
            none.
        tensorboard: log each iteration for TensorBoard, in ``out``.
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
    out: str | Path
    resume: bool
    tensorboard: bool


OF_TRAIN = ("environment", "algorithm", "progress", "callback")  # arguments of `train` besides its settings


@dataclass(frozen=True)
class GivenKernel(KernelChoice):
    """Kernel choice that always returns the given kernel."""

    kernel: Kernel | None = None

    @property
    def is_for_given_inputs(self) -> bool:
        """Whether the kernel does not fit other inputs; assumed of a given kernel."""
        return self.kernel is not None or super().is_for_given_inputs

    def fit(self, points: Array, ages: int = 1) -> Kernel:
        """Return the kernel."""
        return self.kernel if self.kernel is not None else super().fit(points, ages)


def training_in(simulation: Simulation, algorithm: Algorithm | str | None, settings: Mapping[str, Any]) -> Training:
    """Return the checked settings of a run in a simulation, with the defaults of `defaults`."""
    known = {f.name: f for f in fields(Training)}
    for name in settings:
        if name in OF_TRAIN:
            raise ValueError(f"unknown setting '{name}' of learn, which is one of train")
        if name not in known:
            raise ValueError(f"unknown setting '{name}', {_meant(name, known)}")
    horizon = simulation.time_limit or Training.horizon
    given = {"name": name_of_run(simulation.environment), "horizon": horizon, **settings}
    if isinstance(algorithm, str):
        pick(algorithm, ALGORITHMS, "algorithm")
    if isinstance(given.get("model"), str):
        given["model"] = pick(given["model"], MODELS, "model")()
    name = algorithm if isinstance(algorithm, str) else "rkhs_nac"  # an object replaces it below
    form = "none" if isinstance(given.get("model"), NoModel) else "gaussian_process"
    untuned = build(Training, settings_for(name, form, given["horizon"]))
    kernel = given.get("kernel", untuned.kernel)
    if isinstance(kernel, str):
        kernel = replace(untuned.kernel, form=kernel)
    given["kernel"] = GivenKernel(kernel=kernel) if isinstance(kernel, Kernel) else kernel
    require(not isinstance(algorithm, type), "algorithm", "an instance such as RKHSNAC()", algorithm)
    if not isinstance(algorithm, str | None):
        given["algorithm"] = algorithm
    training = replace(untuned, **given)
    degree, expected = given.get("inputs", training.inputs).degree, "0, since the kernel `monomials` sets it"
    require(degree in (0, training.inputs.degree), "inputs.degree", expected, degree)
    return training


def _meant(name: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown setting: the nearest setting of a run, or of an algorithm."""
    algorithms: list[type[Algorithm]] = [*reversed(ALGORITHMS.values()), ALGORITHMS["rkhs_nac"]]
    owners = {f.name: each.__name__ for each in algorithms for f in fields(each)}
    of_run = dict.fromkeys([*LearnSettings.__annotations__, *known, *OF_TRAIN])
    near = [] if name not in owners and nearest(name, of_run) else nearest(name, owners)
    return f"did you mean {owners[near[0]]}({near[0]}=...)?" if near else hint(name, of_run)
