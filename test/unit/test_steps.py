import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rkhs_ros.learning.steps import FixedStep, KLStep
from rkhs_ros.policies.gaussian import GaussianPolicy, mean_kl
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF


@given(divergence=st.floats(1e-4, 1.0), scale=st.floats(1e-3, 1e3), seed=st.integers(0, 999))
def test_a_kl_step_makes_policies_of_that_divergence(divergence: float, scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kernel, x, variance = RBF((1.0,)), rng.normal(size=(20, 2)), rng.uniform(0.1, 4, 2)
    h, w = (Function(kernel, rng.normal(size=(4, 2)), scale * rng.normal(size=(4, 2))) for _ in range(2))
    old = GaussianPolicy(h, ConstantVariance(variance))
    size = KLStep(divergence, cap=1e6).step_size(w(x), old.variance(x))
    assert mean_kl(old, old.with_mean(h + w.scale(size)), x) == pytest.approx(divergence, rel=1e-6)


def test_the_step_is_never_above_the_cap() -> None:
    tiny, variance = np.full((5, 1), 1e-9), np.ones((5, 1))
    assert KLStep(0.02, cap=0.5).step_size(tiny, variance) == 0.5


def test_no_direction_gives_no_step() -> None:
    assert KLStep(0.02, cap=1.0).step_size(np.zeros((5, 2)), np.ones((5, 2))) == 0.0


def test_a_fixed_step_is_the_same_in_any_direction() -> None:
    assert FixedStep(0.3).step_size(np.full((5, 2), 7.0), np.ones((5, 2))) == 0.3
