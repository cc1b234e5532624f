"""Settings of training with and without a model."""

from dataclasses import dataclass

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.learning.model.priors import Priors

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

    def priors(self, observation_dim: int) -> Priors:
        """Import the functions of the settings.

        Raises:
            ValueError: a function does not exist.
        """
        return Priors.named(self.reward_fn, self.termination_fn, self.dynamics_fn, observation_dim)


ModelSettings = NoModel | ModelBased
MODELS: dict[str, type] = {"none": NoModel, "gaussian_process": ModelBased}
