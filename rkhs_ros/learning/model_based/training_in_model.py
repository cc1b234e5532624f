"""Model-based training: between two real iterations, the algorithm trains the policy in a learnt model of the task.

Model rollouts replace costly real episodes. The algorithms are the same as without a model and do not depend on it.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from rkhs_ros.learning.algorithms.algorithm import Algorithm, Experience, Metrics
from rkhs_ros.learning.algorithms.function_spaces import Grid
from rkhs_ros.learning.discovery import discover_inputs
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.model.dynamics_model import DynamicsModel, prediction_error
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.learning.model.priors import Priors
from rkhs_ros.learning.model_based.real_experience import RealExperience
from rkhs_ros.learning.model_based.validation import Earned, Validation, recommended
from rkhs_ros.learning.training_settings import ModelBased
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch, stream, stream_seed
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array

EXPLORATION_DECAY = 0.97  # factor on the standard deviation of the model rollouts after each update
NARROW = 0.3  # their least one relative to the first one, and that of real episodes after the first iteration
FINE = 0.1  # the least one for varying starts: 0.3 is less precise, but needed to reach rewards that are rare
WORLDS = 5  # that model rollouts share if initial observations vary
FINER = 100.0  # divisor of the ridges of an algorithm that trains a policy for one initial observation
FROM_THE_START = 2  # number of the first of three consecutive rollouts that start from initial observations
VALIDATE_EVERY = 5  # updates
HORIZONS_AHEAD = 3.0  # times 1 / (1 - discount); later steps contribute 5 % of the return


def exploration_policy(
    policy: GaussianPolicy, variance: Array, *, is_one_step: bool, reward_depends_on_action_only: bool
) -> GaussianPolicy:
    """Return the policy with the exploration of real episodes after the first iteration, which is narrow.

    Episodes of one step reach no further states, so they explore widely. While no state is known to be better than
    another, exploration stays wide, too, and its noise is pink, which reaches further. The variance of wide exploration
    has shape (n,).
    """
    if reward_depends_on_action_only:
        return replace(policy, variance=ConstantVariance(variance), noise="pink")
    share = 1.0 if is_one_step else NARROW
    return replace(policy, variance=ConstantVariance(share**2 * variance), noise="white")


@dataclass(frozen=True)
class Trained:
    """The result of training between two iterations.

    Attributes:
        policy: the policy that is expected to be the best.
        explorer: the policy of the next real episodes, with their exploration; the same without a model.
        metrics: metrics of the last update.
        model_return: expected return of the policy; nan without a model.
        model_error: error of the previous model on the newest real episodes; nan in the first iteration.
    """

    policy: GaussianPolicy
    explorer: GaussianPolicy
    metrics: Metrics
    model_return: float = float("nan")
    model_error: float = float("nan")


def train_in_model(settings: ModelBased, policy: GaussianPolicy, experience: RealExperience) -> Trained:
    """Train a policy in a model of all real episodes so far; the newest ones also test a model of the earlier ones.

    The rollouts of a run that explores share a world, that is, functions drawn from the model's posterior (Thompson
    sampling; Strens, 2000). The next real episode shows whether the task is like that, so exploration follows the
    model's own uncertainty. If the initial observations vary, a few worlds keep the policy from relying on one of them
    where the next episode does not start. New worlds need a new policy: training starts from a constant mean, and goes
    on from the best of the earlier policies only if that finds nothing better. Without new episodes, rollouts draw
    their own functions, and training goes on. The policy gives inputs and action repeat.
    """
    training, episodes, spaces = experience.training, experience.episodes, experience.spaces
    algorithm, inputs = training.algorithm, policy.inputs
    if settings.discovery != "none" and inputs_may_change(inputs, algorithm, training.kernel):
        history = settings.discovery == "all"
        inputs = discover_inputs(inputs, episodes, spaces, history=history, given=training.inputs)
    if experience.may_explore or inputs != policy.inputs or not policy.mean.weights.any():
        start = _fresh_policy(policy, experience, inputs)
    else:
        start = policy
    priors = settings.priors(spaces.observation_dim, experience.action_repeat, training.discount)
    error = _error_of_previous_model(settings, inputs, experience, priors)
    model = fit_model(settings, inputs, episodes, spaces, priors)
    optimistic = experience.seeks_novelty and priors.reward_fn is None
    focused = not model.starts_vary
    if focused:
        algorithm = _finer(algorithm)
    count = 0 if not experience.may_explore else 1 if focused else WORLDS
    runner = ModelRunner(
        model,
        optimism=experience.reward_width if optimistic else 0.0,
        visited_starts=not focused,
        worlds=[stream(training.seed, f"world {world}", experience.iteration) for world in range(count)],
    )
    earned = _earned(experience, inputs, comparable=focused and experience.may_explore)
    are_rare = model.rewards is not None and model.rewards.are_rare
    least = FINE if model.starts_vary and len(episodes) > 1 and not are_rare else NARROW
    policy, metrics, expected = _optimise(settings, algorithm, start, list(earned.values()), experience, runner, least)
    explorer = exploration_policy(
        replace(policy, action_repeat=experience.action_repeat),
        experience.first_variance,
        is_one_step=episodes.horizon == 1,
        reward_depends_on_action_only=experience.reward_depends_on_action_only,
    )
    if not experience.may_explore:  # the rollouts that chose this policy draw their own functions
        return Trained(explorer, explorer, metrics, expected, error)
    seed = stream_seed(training.seed, "recommendation", experience.iteration)
    batch = Batch(seed, 0, settings.rollouts, _horizon(experience), explore=False)
    earned.setdefault(_key(explorer), (explorer, np.zeros(0)))
    runner = ModelRunner(model, visited_starts=False, reward_margin=0.0)
    best = recommended(list(earned.values()), runner, batch, experience.discount)
    return Trained(replace(best.policy, action_repeat=experience.action_repeat), explorer, metrics, best.mean, error)


def _earned(experience: RealExperience, inputs: Inputs, *, comparable: bool) -> dict[bytes, Earned]:
    """Return the trained policies with these inputs, and their returns at the present action repeat if comparable."""
    earned: dict[bytes, Earned] = {}
    rewards, unknown = experience.episodes.rewards[:, : _horizon(experience)], np.zeros(0)
    returns = rewards @ experience.discount ** np.arange(rewards.shape[1])
    for ago, each in enumerate((*experience.explorers, experience.best)):
        if each is not None and each.inputs == inputs and each.mean.weights.any():
            counts = comparable and ago < len(experience.explorers) and each.action_repeat == experience.action_repeat
            its = returns[::-1][ago * experience.newest :][: experience.newest] if counts else unknown
            first, others = earned.get(_key(each), (each, unknown))
            earned[_key(each)] = first, np.append(others, its)
    return earned


def _key(policy: GaussianPolicy) -> bytes:
    """Return what is equal for policies with the same mean."""
    return policy.mean.weights.tobytes()


def fit_model(
    settings: ModelBased, inputs: Inputs, episodes: Episodes, spaces: Spaces, priors: Priors
) -> DynamicsModel:
    """Fit the model of a run.

    Args:
        settings: settings of the model.
        inputs: inputs of the policy.
        episodes: at least one episode, with raw observations and one step per decision of the policy.
        spaces: spaces of the task.
        priors: functions that replace learnt parts, for these decisions.

    Raises:
        RunError: a prior function failed.
    """
    return DynamicsModel.fit(episodes, inputs, spaces, settings.centres, priors, centred=settings.tries_centred_metric)


def _finer(algorithm: Algorithm) -> Algorithm:
    ridges = {each.name for each in fields(algorithm)} & {"ridge", "value_ridge"}
    return replace(algorithm, **{name: getattr(algorithm, name) / FINER for name in ridges})


def inputs_may_change(inputs: Inputs, algorithm: Algorithm, kernel: KernelChoice) -> bool:
    """Return False if a setting depends on the inputs: monomials, a grid of centres, or one bandwidth per input."""
    return inputs.degree == 0 and not isinstance(algorithm, Grid) and not kernel.is_for_given_inputs


def _optimise(
    settings: ModelBased,
    algorithm: Algorithm,
    start: GaussianPolicy,
    earlier: list[Earned],
    experience: RealExperience,
    runner: ModelRunner,
    least: float,
) -> tuple[GaussianPolicy, Metrics, float]:
    """Update a policy in the model; return the best of all with the metrics of the last update and its return there.

    Exploration decays to the least one, relative to the first. If training from the start finds nothing better than the
    earlier policies, it goes on from the best of these.
    """
    horizon, discount = _horizon(experience), experience.discount
    seed, iteration = experience.training.seed, experience.iteration
    practice = stream_seed(seed, "practice", iteration)
    validation = Validation(settings.rollouts, runner, stream_seed(seed, "validation", iteration), horizon, discount)
    for each, _ in earlier:
        validation.consider_earlier(each)
    first = np.sqrt(experience.first_variance)
    number = 0
    for deviation in (first, NARROW * first):
        policy = replace(start, variance=ConstantVariance(deviation**2), noise="white", action_repeat=1)
        memory = Episodes.none(horizon, runner.spaces.observation_dim, runner.spaces.action_dim)
        memory = memory.with_inputs(policy.inputs)
        while validation.improves and number < settings.updates:
            batch = Batch(practice, number * settings.rollouts, settings.rollouts, horizon, explore=True)
            rollouts = runner.collect(policy, batch).with_inputs(policy.inputs)
            update = Experience(rollouts, discount, memory, _no_fresh_episodes, experience.first_variance, number)
            policy, metrics = algorithm.update(policy, update)
            memory = algorithm.remembered(rollouts + memory, discount)
            deviation = np.maximum(deviation * EXPLORATION_DECAY, least * first)
            if not algorithm.learns_variance:
                policy = replace(policy, variance=ConstantVariance(deviation**2))
            number += 1
            if number % VALIDATE_EVERY == 0 or number == settings.updates:
                validation.consider(policy)
        if validation.kept is None or validation.best is not validation.kept:
            break
        start = validation.kept.policy  # nothing new is better, so improve this one
        validation.resume()
    if validation.best is None:  # the updates had no direction
        return policy, metrics, float(rollouts.returns(discount).mean())
    return validation.best.policy, metrics, validation.best.mean


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
    priors = settings.priors(spaces.observation_dim, repeat, discount)
    model = fit_model(settings, policy.inputs, decisions, spaces, priors)
    batch = Batch(0, FROM_THE_START, count, decisions.horizon, explore=False)
    return ModelRunner(model).collect(replace(policy, action_repeat=1), batch).held(repeat, episodes.horizon)


def _error_of_previous_model(settings: ModelBased, inputs: Inputs, experience: RealExperience, priors: Priors) -> float:
    """Test a model of the earlier episodes on the newest ones; nan in the first iteration."""
    old = len(experience.episodes) - experience.newest
    if old == 0:
        return float("nan")
    before, newest = (experience.episodes.take(part) for part in (slice(old), slice(old, None)))
    return prediction_error(
        before, newest, inputs, experience.spaces, settings.centres, priors, centred=settings.tries_centred_metric
    )


def _horizon(experience: RealExperience) -> int:
    """Return the length of a model rollout: the whole decisions of a real episode, limited by the discount."""
    horizon = max(experience.recorded.horizon // experience.action_repeat, 1)
    if experience.discount == 1.0:
        return horizon
    return min(horizon, int(np.ceil(HORIZONS_AHEAD / (1.0 - experience.discount))))


def _no_fresh_episodes(policy: GaussianPolicy, episodes: int) -> Episodes:
    raise ValueError("algorithm.step.rule: expected fixed or kl for model-based training, got line_search")


def _fresh_policy(policy: GaussianPolicy, experience: RealExperience, inputs: Inputs) -> GaussianPolicy:
    """Return the policy with the inputs, a kernel fitted to all episodes so far, and a mean that is its bias."""
    episodes = experience.episodes.with_inputs(inputs)
    points = episodes.flat(episodes.observations)
    kernel = experience.training.kernel.fit(points, inputs.ages)
    mean = Function.constant(kernel, points.shape[1], policy.mean.output_dim, policy.mean.bias)
    return replace(policy, mean=mean, inputs=inputs)
