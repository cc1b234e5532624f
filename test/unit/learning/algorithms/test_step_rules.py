import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.learning.algorithms.step_rules import KLStep, LineSearch
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from test.unit.conftest import kl_between


def never(size: float, episodes: int) -> float:
    raise AssertionError(f"tried out a step of {size} in {episodes} episodes")


@given(
    divergence=st.floats(1e-4, 1.0),
    scale=st.floats(1e-3, 1e3),
    seed=st.integers(0, 999),
    annealing=st.floats(0, 10),
    iteration=st.integers(0, 1000),
)
def test_a_kl_step_has_the_given_divergence_which_annealing_decreases(
    divergence: float, scale: float, seed: int, annealing: float, iteration: int
) -> None:
    rng = np.random.default_rng(seed)
    kernel, x, variance = RBF((1.0,)), rng.normal(size=(20, 2)), rng.uniform(0.1, 4, 2)
    h, w = (Function(kernel, rng.normal(size=(4, 2)), scale * rng.normal(size=(4, 2))) for _ in range(2))
    old = GaussianPolicy(h, ConstantVariance(variance))
    size = KLStep(divergence, annealing=annealing).step_size(w(x), old.variance(x), never, iteration)
    expected = divergence / (1 + annealing * iteration)
    assert kl_between(old, old.with_mean(h + w.scale(size)), x) == pytest.approx(expected, rel=1e-5)


def test_the_cap_limits_the_step() -> None:
    tiny, variance = np.full((5, 1), 1e-9), np.ones((5, 1))
    assert KLStep(0.02, size=0.5).step_size(tiny, variance, never) == 0.5


@pytest.mark.parametrize("rule", [KLStep(0.02, size=1.0), LineSearch()], ids=["kl", "line search"])
def test_a_zero_direction_gives_no_step(rule: KLStep | LineSearch) -> None:
    assert rule.step_size(np.zeros((5, 2)), np.ones((5, 2)), never) == 0.0
