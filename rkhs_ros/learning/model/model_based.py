"""Practice: between two real iterations the algorithm learns in a model of the task, from the policy so far.

Real episodes cost; imagined ones do not. The algorithms are those that learn without a model, and know of none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.learning.algorithms.algorithm import Algorithm, Experience, Metrics
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.model.dynamics_model import (
    DynamicsModel,
    PredictionTest,
    prediction_test,
    reward_depends_on_action_only,
)
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.learning.model.priors import Priors
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.noise import NOISES
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch, stream_seed
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.kernels import Array, evenly

MOST_COMPARED = 300  # points at which two kernels are compared
SAME_KERNEL = 0.95  # alignment above which two kernels are as good as one
AS_NEEDED = "as_needed"
FUNCTION = "MODULE:FUNCTION in place of what is learnt, empty for none: from rows of"
FROM_THE_START = 2  # the first of three episodes in a row that all begin as real ones do
HORIZONS_AHEAD = 3.0  # times 1 / (1 - discount): beyond that 5 % of the return is left


@dataclass(frozen=True)
class NoModel(Settings):
    """Each update learns from its real episodes alone."""


@dataclass(frozen=True)
class ModelBased(Settings):
    """Each iteration fits a model to all real episodes so far, and its updates are made in that."""

    updates: int = setting(30, "updates of the policy in the model for each real iteration", minimum=1, maximum=1000)
    rollouts: int = setting(50, "exploring model rollouts before each of them", minimum=1, maximum=10_000)
    centres: int = setting(200, "kernel functions of the model at most", minimum=1, maximum=2000)
    exploration_noise: str = setting(
        AS_NEEDED,
        "exploration of the real episodes: white; pink, correlated over time, which gets farther; or as_needed, pink "
        "as long as no place was better than another",
        choices=(*NOISES, AS_NEEDED),
    )
    evaluation_noise_scale: float = setting(
        0.3,
        "factor on the standard deviation of every other real iteration, which sees where the policy itself leads",
        minimum=0.01,
        maximum=1.0,
    )
    exploration_decay: float = setting(
        0.93, "factor on the standard deviation of the model rollouts at each update", minimum=0.0, maximum=1.0
    )
    restart_decay: float = setting(
        1.0,
        "factor on the standard deviation that practice begins with, for each iteration that the newest one surpassed",
        minimum=0.0,
        maximum=1.0,
    )
    exploration_minimum: float = setting(
        0.1, "least standard deviation, as a part of the first one", minimum=1e-6, maximum=1.0
    )
    reward_fn: str = setting("", f"{FUNCTION} (observations, actions, observations after them) to the rewards")
    termination_fn: str = setting("", f"{FUNCTION} observations to whether they end an episode")
    dynamics_fn: str = setting("", f"{FUNCTION} (observations, actions) to a part of the changes; the rest is learnt")

    def exploration_policy(
        self, policy: GaussianPolicy, variance: Array, iteration: int, *, reward_depends_on_action_only: bool
    ) -> GaussianPolicy:
        """Return the policy as it explores in real episodes: wide and narrow by turns, wide as long as it must.

        Args:
            policy: with the mean.
            variance: of wide exploration, shape (n,).
            iteration: number of real iterations before.
            reward_depends_on_action_only: whether none of these told one place from another.
        """
        as_needed = "pink" if reward_depends_on_action_only else "white"
        share = self.evaluation_noise_scale if iteration % 2 and not reward_depends_on_action_only else 1.0
        noise = as_needed if self.exploration_noise == AS_NEEDED else self.exploration_noise
        return replace(policy, variance=ConstantVariance(share**2 * variance), noise=noise)

    def priors(self, observation_dim: int) -> Priors:
        """Return the functions that are named.

        Raises:
            ValueError: there is no such function.
        """
        return Priors.named(self.reward_fn, self.termination_fn, self.dynamics_fn, observation_dim)


ModelSettings = NoModel | ModelBased
MODELS: dict[str, type] = {"none": NoModel, "gaussian_process": ModelBased}


@dataclass(frozen=True)
class RealExperience:
    """All that practice follows from, beside its settings and the policy.

    Attributes:
        episodes: all real episodes so far, their observations as they were seen.
        newest: how many of them are the last iteration's.
        discount: of the return.
        spaces: of the task.
        kernel: how the policy's kernel is chosen.
        first_variance: of the first policy, shape (n,).
        seed: of all that is drawn.
        iteration: number of real iterations before this one.
        outperformed_iterations: how many of them the newest episodes earned more than.
    """

    episodes: Episodes
    newest: int
    discount: float
    spaces: Spaces
    kernel: KernelChoice
    first_variance: Array
    seed: int
    iteration: int
    outperformed_iterations: float


@dataclass(frozen=True)
class ModelUpdate:
    """What came of practice.

    Attributes:
        policy: the policy after it, as it explores in the next real episodes.
        metrics: of its last update.
        model_return: mean return of the exploring episodes before that, in the model.
        model_error: of the model before the newest real episodes, at their steps; nan at first.
    """

    policy: GaussianPolicy
    metrics: Metrics
    model_return: float
    model_error: float


def train_in_model(
    settings: ModelBased, algorithm: Algorithm, policy: GaussianPolicy, experience: RealExperience
) -> ModelUpdate:
    """Return what becomes of a policy that trains in a model of all episodes so far.

    The model before the newest episodes is asked to predict them. Where it was surer than it ought to have been, the
    functions drawn now stray further from their mean, and practice is shorter.
    """
    episodes, inputs, spaces = experience.episodes, policy.inputs, experience.spaces
    policy = _refit_policy_kernel(policy, algorithm, experience)
    known = settings.priors(spaces.observation_dim)
    test = _test_before(settings, policy, experience, known)
    model = DynamicsModel.fit(episodes, inputs, spaces, settings.centres, known)
    runner = ModelRunner(model, test.overconfidence)
    rounds = max(1, round(settings.updates / test.overconfidence))
    least = settings.exploration_minimum * np.sqrt(experience.first_variance)
    share = max(settings.restart_decay**experience.outperformed_iterations, settings.exploration_minimum)
    deviation = share * np.sqrt(experience.first_variance)
    policy = replace(policy, variance=ConstantVariance(deviation**2), noise="white")
    memory = Episodes.none(_horizon(experience), spaces.observation_dim, spaces.action_dim).seen_through(inputs)
    for number in range(rounds):
        imagined = runner.collect(policy, _batch(settings, experience, number)).seen_through(inputs)
        update = Experience(
            imagined, experience.discount, memory, _no_fresh_episodes, experience.first_variance, number
        )
        policy, metrics, memory = algorithm.update(policy, update)
        deviation = np.maximum(deviation * settings.exploration_decay, least)
        if not algorithm.learns_variance:
            policy = replace(policy, variance=ConstantVariance(deviation**2))
    last = float(imagined.returns(experience.discount).mean())
    alike = reward_depends_on_action_only(episodes, spaces)
    policy = settings.exploration_policy(
        policy, experience.first_variance, experience.iteration + 1, reward_depends_on_action_only=alike
    )
    return ModelUpdate(policy, metrics, last, test.error)


def model_rollouts_of(
    settings: ModelBased, policy: GaussianPolicy, episodes: Episodes, spaces: Spaces, count: int
) -> Episodes:
    """Return evaluation episodes of a policy as the model expects them, each in functions drawn from it.

    Args:
        settings: of the run.
        policy: who acts.
        episodes: all real ones so far, their observations as they were seen.
        spaces: of the task.
        count: number of episodes, below four.

    Raises:
        RunError: a function of what is known failed.
    """
    model = DynamicsModel.fit(
        episodes, policy.inputs, spaces, settings.centres, settings.priors(spaces.observation_dim)
    )
    return ModelRunner(model).collect(policy, Batch(0, FROM_THE_START, count, episodes.horizon, explore=False))


def _refit_policy_kernel(policy: GaussianPolicy, algorithm: Algorithm, experience: RealExperience) -> GaussianPolicy:
    """Return the policy with the kernel that all episodes so far settle, and a mean not far beyond the actions' bounds.

    The first episodes may have seen little, and another kernel fits now. Where the mean strayed far beyond a bound
    exploration changes no action, so nothing could be learnt any more: it comes back to one first standard deviation
    beyond, at all points seen. To the bound itself it need not, and the kink there would cost what was learnt.
    """
    seen = experience.episodes.seen_through(policy.inputs)
    points = seen.flat(seen.observations)
    few = evenly(points, MOST_COMPARED)
    own, kernel = policy.mean.kernel, experience.kernel.fit(points, policy.inputs.ages)
    if len(policy.mean.centres) == 0:
        return policy.with_mean(replace(policy.mean, kernel=kernel))
    if _alignment(kernel(few, few), own(few, few)) > SAME_KERNEL:
        kernel = own
    means = policy.mean(points)
    values = experience.spaces.clip_with_margin(means, np.sqrt(experience.first_variance))
    if kernel is own and np.array_equal(values, means):
        return policy
    return policy.with_mean(algorithm.space.fit(kernel, points, values))


def _alignment(gram: Array, other: Array) -> float:
    r"""Return :math:`\langle K, K' \rangle_F / (\|K\|_F \|K'\|_F)` of two Gram matrices, 1 where they agree."""
    norms = np.linalg.norm(gram) * np.linalg.norm(other)
    return float(np.sum(gram * other) / norms) if norms > 0 else float(np.array_equal(gram, other))


def _test_before(
    settings: ModelBased, policy: GaussianPolicy, experience: RealExperience, known: Priors
) -> PredictionTest:
    """Return how the model of the episodes before the newest ones predicts these."""
    old = len(experience.episodes) - experience.newest
    if old == 0:
        return PredictionTest(float("nan"), 1.0)
    before, newest = (experience.episodes.take(part) for part in (slice(old), slice(old, None)))
    return prediction_test(before, newest, policy.inputs, experience.spaces, settings.centres, known)


def _horizon(experience: RealExperience) -> int:
    """Return the steps of an model rollout: as many as the discount lets count."""
    horizon = experience.episodes.horizon
    if experience.discount == 1.0:
        return horizon
    return min(horizon, int(np.ceil(HORIZONS_AHEAD / (1.0 - experience.discount))))


def _batch(settings: ModelBased, experience: RealExperience, number: int) -> Batch:
    seed = stream_seed(experience.seed, "practice", experience.iteration)
    return Batch(seed, number * settings.rollouts, settings.rollouts, _horizon(experience), explore=True)


def _no_fresh_episodes(policy: GaussianPolicy, episodes: int) -> Episodes:
    raise ValueError("algorithm.step.rule: expected one that tries no steps out, for model-based training")
