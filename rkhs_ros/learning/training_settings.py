"""The learner's settings."""

from dataclasses import dataclass, replace
from pathlib import Path

from rkhs_ros.base.settings import Settings, setting, variant
from rkhs_ros.base.validation import require
from rkhs_ros.learning.algorithms.algorithm import Algorithm
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.algorithms.step_rules import LineSearch
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.model.priors import Priors
from rkhs_ros.policies.gaussian import MOST_REPEAT
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.streams import MAX_BATCH_SAMPLES

AUTO = "auto"
DISCOVERIES = ("none", "angles", "all")
FUNCTION = "MODULE:FUNCTION, or empty to learn the function; maps batches of"


@dataclass(frozen=True)
class NoModel(Settings):
    """Model-free training: each update uses only real episodes."""


@dataclass(frozen=True)
class ModelBased(Settings):
    """Model-based training: each iteration fits a model to all real episodes and updates the policy in it."""

    updates: int = setting(
        240,
        "maximum number of policy updates in the model per real iteration; they end when validation does not improve",
        minimum=1,
        maximum=1000,
    )
    rollouts: int = setting(
        50,
        "model rollouts with exploration noise per update, and of the policy mean per validation",
        minimum=2,
        maximum=10_000,
    )
    centres: int = setting(200, "maximum number of centres of the model", minimum=1, maximum=2000)
    discovery: str = setting(
        "all",
        "what to find in the data and add to the policy's inputs, unless these are monomials, the centres are on a "
        "grid or the kernel has one bandwidth per input: none; angles; or all, angles and a longer history. all also "
        "compares two metrics for the model of the changes, and uses the one with the greater evidence",
        choices=DISCOVERIES,
    )
    reward_fn: str = setting("", f"{FUNCTION} observations, actions and next observations to rewards")
    termination_fn: str = setting("", f"{FUNCTION} observations to whether they terminate the episode")
    dynamics_fn: str = setting(
        "", f"{FUNCTION} observations and actions to a known part of the change; the rest is learnt"
    )

    @property
    def tries_centred_metric(self) -> bool:
        """Whether the model of the changes also tries the centred metric; see `rkhs_ros.rkhs.metric_learning`."""
        return self.discovery == "all"

    def priors(self, observation_dim: int, action_repeat: int = 1, discount: float = 1.0) -> Priors:
        """Import the functions of the settings, for decisions of a number of steps and a discount factor per step.

        Raises:
            ValueError: a function does not exist.
        """
        priors = Priors.named(self.reward_fn, self.termination_fn, self.dynamics_fn, observation_dim)
        return replace(priors, action_repeat=action_repeat, discount=discount)


ModelSettings = NoModel | ModelBased
MODELS: dict[str, type] = {"none": NoModel, "gaussian_process": ModelBased}


@dataclass(frozen=True)
class Training(Settings):
    """The learner's settings."""

    name: str = setting("run", "name of the run and of its results folder")
    seed: int = setting(0, "seed of all random numbers", minimum=0, maximum=2**63 - 1)
    iterations: int = setting(20, "number of training iterations", minimum=1, maximum=10**6)
    episodes_per_iteration: int = setting(1, "exploration episodes per iteration", minimum=1, maximum=10_000)
    evaluation_episodes: int = setting(10, "episodes per evaluation", minimum=1, maximum=10_000)
    evaluate_every: int = setting(1, "number of iterations per evaluation; 0: no evaluation", minimum=0, maximum=10**6)
    horizon: int = setting(100, "maximum number of steps per episode", minimum=1, maximum=10**6)
    discount: float = setting(0.99, "discount factor of the return, per step", minimum=0.0, maximum=1.0)
    action_repeat: str | int = setting(
        AUTO,
        "number of steps for which the policy holds an action; or 'auto': chosen from the first iteration's episodes, "
        "such that the observation changes by 0.3 standard deviations between decisions",
        minimum=1,
        maximum=MOST_REPEAT,
        choices=(AUTO,),
    )
    exploration_sd: str | tuple[float, ...] = setting(
        "range",
        "initial standard deviation of the actions, one number or one per dimension; or 'range': half the range of "
        "each action, 1 if the action is unbounded",
        minimum=1e-6,
        maximum=1e6,
        choices=("range",),
    )
    timeout: float = setting(20.0, "seconds without a message after which the run fails", minimum=0.1, maximum=3600.0)
    inputs: Inputs = Inputs()
    kernel: KernelChoice = KernelChoice()
    algorithm: Algorithm = variant(RKHSNAC(), ALGORITHMS, "name")
    model: ModelSettings = variant(ModelBased(), MODELS, "form")

    def __post_init__(self) -> None:
        """Raise ValueError if a value is invalid, or a line search would need real episodes in the model."""
        super().__post_init__()
        object.__setattr__(self, "inputs", self.kernel.inputs_of(self.inputs))
        searches = isinstance(getattr(self.algorithm, "step", None), LineSearch)
        good = not (searches and isinstance(self.model, ModelBased))
        require(good, "algorithm.step.rule", "fixed or kl for model.form=gaussian_process", "line_search")
        steps, most = self.num_envs * self.horizon, f"at most {MAX_BATCH_SAMPLES} steps in the episodes of an iteration"
        require(steps <= MAX_BATCH_SAMPLES, "horizon", most, steps)
        plain = self.name.isprintable() and self.name not in ("", "..") and Path(self.name).name == self.name
        require(plain, "name", "a valid folder name", repr(self.name))

    @property
    def num_envs(self) -> int:
        """Maximum number of parallel episodes: those of an evaluation, or the exploring ones."""
        return max(self.episodes_per_iteration, self.evaluation_episodes)
