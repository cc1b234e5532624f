"""Model-based training: between two real iterations, the algorithm trains the policy in a learnt model of the task.

Model rollouts replace costly real episodes. The algorithms are the same as without a model and do not depend on it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.learning.algorithms.algorithm import Algorithm, Experience, Metrics
from rkhs_ros.learning.algorithms.function_spaces import Grid
from rkhs_ros.learning.discovery.evidence import discover_inputs
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.model.dynamics_model import (
    DynamicsModel,
    PredictionTest,
    prediction_test,
)
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.learning.model.policy_refit import refit_policy
from rkhs_ros.learning.model.priors import Priors
from rkhs_ros.learning.model.real_experience import RealExperience
from rkhs_ros.learning.model.validation import Validation
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.noise import NOISES
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch, stream_seed
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.kernels import Array

DISCOVERIES = ("none", "angles", "all")
AS_NEEDED = "as_needed"
FINER = 100.0  # divisor of the ridges of an algorithm that trains a policy for one initial observation
FUNCTION = "MODULE:FUNCTION, or empty to learn the function; maps batches of"
FROM_THE_START = 2  # number of the first of three consecutive rollouts that start from initial observations
VALIDATE_EVERY = 5  # updates
MOST_ROUNDS = 4  # times the usual updates, as long as the policy improves
NEARLY = 0.05  # distance from the greatest reward that hardly matters, relative to the range of the rewards
HORIZONS_AHEAD = 3.0  # times 1 / (1 - discount); later steps contribute 5 % of the return


@dataclass(frozen=True)
class NoModel(Settings):
    """Model-free training: each update uses only real episodes."""


@dataclass(frozen=True)
class ModelBased(Settings):
    """Model-based training: each iteration fits a model to all real episodes and updates the policy in it."""

    updates: int = setting(30, "policy updates in the model per real iteration", minimum=1, maximum=1000)
    rollouts: int = setting(50, "model rollouts with exploration noise per update", minimum=1, maximum=10_000)
    validation_rollouts: int = setting(
        0,
        "number of model rollouts of the policy mean that measure a policy, with the same random numbers for all "
        "policies; an iteration selects its best policy, and its updates continue while they improve on it. "
        "0: a fixed number of updates, and the policy after the last one",
        minimum=0,
        maximum=10_000,
    )
    centres: int = setting(200, "maximum number of centres of the model", minimum=1, maximum=2000)
    exploration_noise: str = setting(
        AS_NEEDED,
        "exploration noise of real episodes: white; pink, which is correlated over time and reaches further; or "
        "as_needed: pink while the actions alone explain all rewards and the task has ended no episode, then white",
        choices=(*NOISES, AS_NEEDED),
    )
    discovery: str = setting(
        "none",
        "what to find in the data and add to the policy's inputs, unless these are monomials, the centres are on a "
        "grid or the kernel has one bandwidth per input: none; angles; or all, angles and a longer history. all also "
        "compares two metrics for the model of the changes, and uses the one with the greater evidence",
        choices=DISCOVERIES,
    )
    reward_margin: float = setting(
        0.0,
        "how far rewards of the model may lie outside the range of observed rewards, relative to that range. With 0, "
        "the model predicts no reward above the best observed one; with a margin, it can extrapolate, and policies "
        "seek greater rewards. It is divided by 1 plus the number of episodes since the greatest reward",
        minimum=0.0,
        maximum=100.0,
    )
    focus: str = setting(
        "none",
        "whether the policy is trained for the initial observations alone if they are almost the same. as_needed: all "
        "model rollouts then start there, instead of a quarter from visited observations, and the ridges of the "
        "algorithm are divided by 100, so that the policy can change faster between states. none: never",
        choices=("none", AS_NEEDED),
    )
    curiosity: str = setting(
        "none",
        "when the policy trains to reach states that the model does not know. none: never. as_needed: while a cost of "
        "the actions explains all rewards",
        choices=("none", AS_NEEDED),
    )
    evaluation_noise_scale: float = setting(
        0.3,
        "factor on the standard deviation in every second real iteration, to visit the states that the policy mean "
        "reaches",
        minimum=0.01,
        maximum=1.0,
    )
    exploration_decay: float = setting(
        0.93, "factor on the standard deviation of the model rollouts after each update", minimum=0.0, maximum=1.0
    )
    restart_decay: float = setting(
        1.0,
        "factor on the initial standard deviation of the model rollouts, applied k times; k is the number of earlier "
        "iterations with a lower return than the newest one",
        minimum=0.0,
        maximum=1.0,
    )
    exploration_minimum: float = setting(
        0.1, "minimum standard deviation of the model rollouts, relative to the initial one", minimum=1e-6, maximum=1.0
    )
    reward_fn: str = setting("", f"{FUNCTION} observations, actions and next observations to rewards")
    termination_fn: str = setting("", f"{FUNCTION} observations to whether they terminate the episode")
    dynamics_fn: str = setting(
        "", f"{FUNCTION} observations and actions to a known part of the change; the rest is learnt"
    )

    def exploration_policy(
        self, policy: GaussianPolicy, variance: Array, iteration: int, *, reward_depends_on_action_only: bool
    ) -> GaussianPolicy:
        """Return the policy with the exploration of the next real episodes.

        Wide and narrow exploration alternate; exploration stays wide while no state is known to be better than another.

        Args:
            policy: policy with the mean.
            variance: variance of wide exploration, shape (n,).
            iteration: number of previous real iterations.
            reward_depends_on_action_only: whether a cost of the actions explains all rewards so far.
        """
        as_needed = "pink" if reward_depends_on_action_only else "white"
        share = self.evaluation_noise_scale if iteration % 2 and not reward_depends_on_action_only else 1.0
        noise = as_needed if self.exploration_noise == AS_NEEDED else self.exploration_noise
        return replace(policy, variance=ConstantVariance(share**2 * variance), noise=noise)

    def margin_after(self, episodes: Episodes) -> float:
        """Return the reward margin of a model of these episodes; it shrinks while none has a greater reward."""
        rewards, mask = episodes.rewards, episodes.mask
        greatest = np.where(mask, rewards, -np.inf).max(axis=1)
        width = float(np.ptp(rewards[mask]))
        return self.reward_margin / (len(greatest) - int(np.argmax(greatest >= greatest.max() - NEARLY * width)))

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


@dataclass(frozen=True)
class ModelUpdate:
    """The result of model-based training.

    Attributes:
        policy: the new policy with the exploration of the next real episodes.
        metrics: metrics of the last update.
        model_return: mean return of the model rollouts before the last update; with validation, the validation return
            of the policy.
        model_error: error of the previous model on the newest real episodes; nan in the first iteration.
        curious: whether the model rollouts had rewards for unknown states instead of those of the task.
    """

    policy: GaussianPolicy
    metrics: Metrics
    model_return: float
    model_error: float
    curious: bool


def train_in_model(
    settings: ModelBased, algorithm: Algorithm, policy: GaussianPolicy, experience: RealExperience
) -> ModelUpdate:
    """Train a policy in a model of all real episodes so far.

    The newest episodes test a model of the earlier ones. If that model was overconfident, posterior samples of the
    new model deviate further from the posterior mean, and there are fewer updates.
    """
    episodes, spaces = experience.episodes, experience.spaces
    inputs = policy.inputs
    if settings.discovery != "none" and inputs_may_change(inputs, algorithm, experience.kernel):
        history = settings.discovery == "all"
        inputs = discover_inputs(inputs, episodes, spaces, history=history, given=experience.given_inputs)
    policy = refit_policy(policy, algorithm, experience, inputs)
    priors = settings.priors(spaces.observation_dim)
    test = _test_previous_model(settings, policy, experience, priors)
    model = fit_model(settings, inputs, episodes, spaces)
    nothing_known = experience.reward_depends_on_action_only
    curious = settings.curiosity == AS_NEEDED and nothing_known and priors.reward_fn is None
    focused = settings.focus == AS_NEEDED and not model.starts_vary
    if focused:
        algorithm = _finer(algorithm)
    runner = ModelRunner(
        model,
        test.overconfidence,
        curious=curious,
        reward_margin=settings.margin_after(episodes),
        visited_starts=not focused,
    )
    rounds = max(1, round(settings.updates / test.overconfidence))
    repeat = policy.action_repeat
    policy, metrics, expected = _optimise(
        settings, algorithm, replace(policy, noise="white", action_repeat=1), experience, runner, rounds
    )
    policy = settings.exploration_policy(
        replace(policy, action_repeat=repeat),
        experience.first_variance,
        experience.iteration + 1,
        reward_depends_on_action_only=nothing_known,
    )
    return ModelUpdate(policy, metrics, expected, test.error, curious)


def fit_model(settings: ModelBased, inputs: Inputs, episodes: Episodes, spaces: Spaces) -> DynamicsModel:
    """Fit the model of a run.

    Args:
        settings: settings of the model.
        inputs: inputs of the policy.
        episodes: at least one episode, with raw observations and one step per decision of the policy.
        spaces: spaces of the task.

    Raises:
        ValueError: a prior function does not exist.
        RunError: a prior function failed.
    """
    priors = settings.priors(spaces.observation_dim)
    return DynamicsModel.fit(episodes, inputs, spaces, settings.centres, priors, centred=settings.tries_centred_metric)


def _finer(algorithm: Algorithm) -> Algorithm:
    """Return the algorithm with smaller ridges."""
    ridges = {each.name for each in fields(algorithm)} & {"ridge", "value_ridge"}
    return replace(algorithm, **{name: getattr(algorithm, name) / FINER for name in ridges})


def inputs_may_change(inputs: Inputs, algorithm: Algorithm, kernel: KernelChoice) -> bool:
    """Return False if a setting depends on the inputs: monomials, a grid of centres, or one bandwidth per input."""
    return inputs.degree == 0 and not isinstance(algorithm.space, Grid) and not kernel.is_for_given_inputs


def _optimise(
    settings: ModelBased,
    algorithm: Algorithm,
    policy: GaussianPolicy,
    experience: RealExperience,
    runner: ModelRunner,
    rounds: int,
) -> tuple[GaussianPolicy, Metrics, float]:
    """Update the policy in the model; return it with the metrics of the last update and its return in the model."""
    validation = Validation(settings.validation_rollouts, runner, _validation_seed(experience), _horizon(experience))
    least = settings.exploration_minimum * np.sqrt(experience.first_variance)
    share = max(settings.restart_decay**experience.outperformed_iterations, settings.exploration_minimum)
    deviation = share * np.sqrt(experience.first_variance)
    validation.consider(policy, experience.discount)
    policy = replace(policy, variance=ConstantVariance(deviation**2))
    memory = Episodes.none(_horizon(experience), runner.spaces.observation_dim, runner.spaces.action_dim)
    memory, number = memory.with_inputs(policy.inputs), 0
    while number < rounds or (validation.improves and number < MOST_ROUNDS * rounds):
        rollouts = runner.collect(policy, _batch(settings, experience, number)).with_inputs(policy.inputs)
        update = Experience(
            rollouts, experience.discount, memory, _no_fresh_episodes, experience.first_variance, number
        )
        policy, metrics, memory = algorithm.update(policy, update)
        deviation = np.maximum(deviation * settings.exploration_decay, least)
        if not algorithm.learns_variance:
            policy = replace(policy, variance=ConstantVariance(deviation**2))
        number += 1
        if number % VALIDATE_EVERY == 0 or number == rounds:
            validation.consider(policy, experience.discount)
    if validation.best is None:
        return policy, metrics, float(rollouts.returns(experience.discount).mean())
    return validation.best, metrics, validation.highest


def model_rollouts_of(
    settings: ModelBased, policy: GaussianPolicy, episodes: Episodes, spaces: Spaces, discount: float, count: int
) -> Episodes:
    """Roll out a policy without exploration in a model, each rollout in functions drawn from the posterior.

    Args:
        settings: settings of the run.
        policy: the policy.
        episodes: all real episodes so far, with raw observations.
        spaces: spaces of the task.
        discount: discount factor per step.
        count: number of rollouts, at most 3.

    Raises:
        RunError: a prior function failed.
    """
    repeat = policy.action_repeat
    decisions = episodes.decisions(repeat, discount, spaces)
    model = fit_model(settings, policy.inputs, decisions, spaces)
    batch = Batch(0, FROM_THE_START, count, decisions.horizon, explore=False)
    runner = ModelRunner(model, reward_margin=settings.margin_after(decisions))
    return runner.collect(replace(policy, action_repeat=1), batch).held(repeat, episodes.horizon)


def _test_previous_model(
    settings: ModelBased, policy: GaussianPolicy, experience: RealExperience, priors: Priors
) -> PredictionTest:
    """Test a model of the earlier episodes on the newest ones."""
    old = len(experience.episodes) - experience.newest
    if old == 0:
        return PredictionTest(float("nan"), 1.0)
    before, newest = (experience.episodes.take(part) for part in (slice(old), slice(old, None)))
    return prediction_test(
        before,
        newest,
        policy.inputs,
        experience.spaces,
        settings.centres,
        priors,
        centred=settings.tries_centred_metric,
    )


def _horizon(experience: RealExperience) -> int:
    """Return the length of a model rollout in steps, limited by the discount."""
    horizon = experience.episodes.horizon
    if experience.discount == 1.0:
        return horizon
    return min(horizon, int(np.ceil(HORIZONS_AHEAD / (1.0 - experience.discount))))


def _batch(settings: ModelBased, experience: RealExperience, number: int) -> Batch:
    seed = stream_seed(experience.seed, "practice", experience.iteration)
    return Batch(seed, number * settings.rollouts, settings.rollouts, _horizon(experience), explore=True)


def _validation_seed(experience: RealExperience) -> int:
    return stream_seed(experience.seed, "validation", experience.iteration)


def _no_fresh_episodes(policy: GaussianPolicy, episodes: int) -> Episodes:
    raise ValueError("algorithm.step.rule: expected fixed or kl for model-based training, got line_search")
