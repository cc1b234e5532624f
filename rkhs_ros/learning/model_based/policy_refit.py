"""Fit the policy again when its inputs or its kernel change between two real iterations."""

from dataclasses import replace

import numpy as np

from rkhs_ros.learning.algorithms.algorithm import Algorithm
from rkhs_ros.learning.model_based.real_experience import RealExperience
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, subsample

MOST_COMPARED = 300  # maximum number of points at which two kernels are compared
SAME_KERNEL = 0.95  # alignment above which the policy keeps its kernel


def refit_policy(
    policy: GaussianPolicy, algorithm: Algorithm, experience: RealExperience, inputs: Inputs
) -> GaussianPolicy:
    """Return the policy with the inputs, a kernel fitted to all episodes so far, and a mean near the action bounds.

    The first episodes may have visited few states, so that another kernel fits now. If the mean is far beyond a bound,
    exploration does not change the clipped action, and nothing can be learnt. The mean is therefore clipped to the
    bounds plus one initial standard deviation at all visited points. Clipping to the bounds themselves is not needed,
    and its kink would distort the learnt mean.
    """
    episodes = experience.episodes.with_inputs(policy.inputs)
    old_points = points = episodes.flat(episodes.observations)
    if inputs != policy.inputs:
        episodes = experience.episodes.with_inputs(inputs)
        points = episodes.flat(episodes.observations)
    few = subsample(points, MOST_COMPARED)
    own, kernel = policy.mean.kernel, experience.kernel.fit(points, inputs.ages)
    if len(policy.mean.centres) == 0:
        mean = Function.constant(kernel, points.shape[1], policy.mean.output_dim, policy.mean.bias)
        return replace(policy, mean=mean, inputs=inputs)
    if inputs == policy.inputs and _alignment(kernel(few, few), own(few, few)) > SAME_KERNEL:
        kernel = own
    means = policy.mean(old_points)
    values = experience.spaces.clip_with_margin(means, np.sqrt(experience.first_variance))
    if kernel is own and np.array_equal(values, means):
        return policy
    bias = policy.mean.bias
    mean = algorithm.space.fit(kernel, points, values - np.array(bias or 0.0))
    return replace(policy, mean=replace(mean, bias=bias), inputs=inputs)


def _alignment(gram: Array, other: Array) -> float:
    r"""Return :math:`\langle K, K' \rangle_F / (\|K\|_F \|K'\|_F)` of two Gram matrices, 1 if they are equal."""
    norms = np.linalg.norm(gram) * np.linalg.norm(other)
    return float(np.sum(gram * other) / norms) if norms > 0 else float(np.array_equal(gram, other))
