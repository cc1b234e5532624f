"""Small policies over all kernels and kinds of inputs, and random episodes, to compare exports with."""

from collections.abc import Callable

import numpy as np

from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.policy import Policy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import COMPOSITIONS, RBF, Kernel, Linear, Polynomial, kernel_from_terms

TASK = Task("Pendulum-v1", {}, 20, 0.99)
OBSERVED, STEPS = 4, 12
# A kernel for each entry of LEAVES, made for points of a dimension.
EACH_LEAF: dict[str, Callable[[int], Kernel]] = {
    "rbf": lambda d: RBF(tuple(np.linspace(0.8, 2.0, d))),
    "polynomial": lambda d: Polynomial(0.5, 3),
    "linear": lambda d: Linear(tuple(np.linspace(-1, 1, d)), tuple(np.linspace(1, 2, d))),
}
SHORT: Callable[[int], Kernel] = lambda d: RBF((1.5,))  # noqa: E731
KERNELS: dict[str, Callable[[int], Kernel]] = {
    **EACH_LEAF,
    "one bandwidth": SHORT,
    **{
        name: lambda d, name=name: kernel_from_terms(  # type: ignore[misc]
            [*SHORT(d).terms(), *EACH_LEAF["linear"](d).terms(), *SHORT(d).terms(), (name, ()), ("sum", ())]
        )
        for name in COMPOSITIONS
    },
}
INPUTS = {
    "plain": Inputs(),
    "angles": Inputs(angles=(2.0, 0.0), turns=(360.0, 1.0)),
    "only angles": Inputs(angles=(0.0, 1.0, 2.0, 3.0)),
    "monomials": Inputs(degree=2, offset=0.7),
    "window": Inputs(history=3),
    "window of angles": Inputs(history=2, angles=(1.0,)),
    "monomials of a window": Inputs(history=2, degree=2, angles=(3.0,)),
}


def small_policy(kernel: str, inputs: str, repeat: int = 1, centres: int = 6, *, scalar: bool = False) -> Policy:
    """Return a random policy, with observations of shape (2, 2) and actions of shape (2, 1), or () if scalar."""
    rng, n = np.random.default_rng(0), 1 if scalar else 2
    points = INPUTS[inputs].unfold(rng.uniform(-1.5, 1.5, (50, 4, OBSERVED)), rng.uniform(-0.5, 0.5, (50, 4, n)))
    points = points.reshape(200, -1)
    mean = Function(KERNELS[kernel](points.shape[1]), points[:centres], rng.normal(size=(centres, n)), (0.3,) * n)
    mean = mean.scale(0.7 / max(np.abs(mean(points)).max(), 0.1))  # beyond some bounds
    shape = () if scalar else (2, 1)
    spaces = Spaces((2, 2), np.full(shape, -np.inf) if scalar else np.array([[-0.4], [-np.inf]]), np.full(shape, 0.5))
    within = INPUTS[inputs].within(spaces)
    gaussian = GaussianPolicy(mean, ConstantVariance(np.ones(n)), within, action_repeat=repeat)
    return Policy(gaussian, TASK, spaces)


def random_episode() -> np.ndarray:
    """Return the observations of an episode, shape (STEPS, 2, 2)."""
    return np.random.default_rng(1).uniform(-1.5, 1.5, (STEPS, 2, 2))


def acted(policy: Policy, observations: np.ndarray) -> np.ndarray:
    """Return the actions of a policy in an episode, shape (STEPS, *action_shape)."""
    policy.reset()
    return np.stack([policy(observation) for observation in observations])
