import numpy as np
import pytest

from rkhs_ros.rkhs.kernels import RBF, Polynomial
from test.unit.conftest import kl_between, random_policy

over_variances = pytest.mark.parametrize("learnt", [False, True], ids=["constant variance", "learnt variance"])


@over_variances
def test_mean_kl_is_the_closed_form_of_each_dimension(rng: np.random.Generator, learnt: bool) -> None:
    old, new, x = random_policy(rng, learnt=learnt), random_policy(rng, learnt=learnt), rng.normal(size=(6, 2))
    total = 0.0
    for row in x:
        m0, m1, v0, v1 = (f(row[None])[0] for f in (old.mean, new.mean, old.variance, new.variance))
        for j in range(2):
            total += np.log(np.sqrt(v1[j] / v0[j])) + (v0[j] + (m0[j] - m1[j]) ** 2) / (2 * v1[j]) - 0.5
    assert kl_between(old, new, x) == pytest.approx(total / 6, rel=1e-12)
    assert kl_between(old, old, x) == pytest.approx(0.0, abs=1e-12)


@over_variances
def test_actions_have_the_policys_mean_and_variance(rng: np.random.Generator, learnt: bool) -> None:
    policy, x = random_policy(rng, learnt=learnt), rng.normal(size=(1, 2))
    actions = policy.act(np.repeat(x, 40_000, axis=0), rng.standard_normal((40_000, 2)))
    sd = np.sqrt(policy.variance(x)[0])
    assert np.all(np.abs(actions.mean(axis=0) - policy.mean(x)[0]) < 5 * sd / 200)  # five standard errors
    np.testing.assert_allclose(actions.std(axis=0), sd, rtol=0.02)  # five standard errors of 0.35 %


@over_variances
@pytest.mark.parametrize("kernel", [RBF((0.7,)), Polynomial(1.0, 2)], ids=str)
def test_an_action_does_not_depend_on_other_environments(rng: np.random.Generator, learnt: bool, kernel: RBF) -> None:
    policy = random_policy(rng, d=3, n=2, m=23, kernel=kernel, learnt=learnt)
    x, exploration = rng.normal(size=(31, 3)), rng.standard_normal((31, 2))
    rows = [policy.act(x[i : i + 1], exploration[i : i + 1]) for i in range(31)]
    assert np.array_equal(np.concatenate(rows), policy.act(x, exploration))
