import numpy as np
import pytest
from scipy.stats import chi2

from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.rkhs.kernels import RBF, Linear, Polynomial, median_bandwidth


def test_median_bandwidths_are_medians_of_the_points(rng: np.random.Generator) -> None:
    x = rng.normal(size=(30, 2)) * [1.0, 5.0]
    expected = RBF(tuple(2.0 * b for b in median_bandwidth(x)))
    assert KernelChoice(bandwidth="median", bandwidth_scale=2.0).fit(x) == expected


@pytest.mark.parametrize("d", [1, 2, 10, 40])
def test_bandwidths_by_dimension_keep_the_kernel_of_typical_points(d: int, rng: np.random.Generator) -> None:
    x = rng.normal(size=(300, d)) * np.geomspace(1e-3, 1e3, d) + 7.0
    values = KernelChoice(bandwidth="dimension").fit(x)(x, x)[np.triu_indices(300, 1)]
    # A pair's squared distance is twice a chi-squared variable of d degrees, whose median over d goes from 0.45 to 1:
    # the kernel decreases from 0.40 to 0.25 in 2 dimensions and to 0.14. The margin is that of 300 points.
    median = np.exp(-2.0 * chi2(d).median() / d)
    assert np.median(values) == pytest.approx(median, rel=0.15)


@pytest.mark.parametrize("bandwidth", ["median", "dimension"])
def test_measured_bandwidths_scale_with_the_units_of_the_points(bandwidth: str, rng: np.random.Generator) -> None:
    x, units = rng.normal(size=(50, 4)), np.array([1.0, 1024.0, 1 / 1024, 1.0])
    choice = KernelChoice("rbf + linear", bandwidth=bandwidth)
    np.testing.assert_array_equal(choice.fit(x * units)(x * units, x * units), choice.fit(x)(x, x))
    moved = x + 3.0
    np.testing.assert_allclose(choice.fit(moved)(moved, moved), choice.fit(x)(x, x), rtol=1e-9)


def test_linear_uses_the_mean_and_deviations_of_the_points(rng: np.random.Generator) -> None:
    x = np.column_stack([rng.normal(size=(30, 2)) * [1.0, 5.0] + [3.0, 0.0], np.full(30, 0.1)])
    kernel = KernelChoice("linear").fit(x)
    assert isinstance(kernel, Linear)
    np.testing.assert_allclose(kernel.centre, x.mean(axis=0))
    np.testing.assert_allclose(kernel.scale, [*x[:, :2].std(axis=0), 1.0])


def test_bandwidths_of_one_time_step_apply_to_the_whole_window() -> None:
    choice = KernelChoice(bandwidth=(0.5, 2.0), bandwidth_scale=3.0)
    assert choice.fit(np.zeros((3, 6)), 3) == RBF((1.5, 6.0) * 3)
    assert KernelChoice(bandwidth=(0.5,)).fit(np.zeros((3, 6)), 3) == RBF((0.5,))
    assert KernelChoice(bandwidth=tuple(range(1, 7))).fit(np.zeros((3, 6)), 3) == RBF(tuple(range(1, 7)))
    assert KernelChoice(bandwidth=(0.5,)).fit(np.zeros((3, 3)), 3) == RBF((0.5,))


@pytest.mark.parametrize(("d", "ages", "expected"), [(4, 1, "1 or 4"), (6, 2, "1 or 3 or 6"), (5, 5, "1 or 5")])
def test_bandwidths_must_match_the_inputs_or_one_time_step(d: int, ages: int, expected: str) -> None:
    with pytest.raises(ValueError, match=f"kernel.bandwidth: expected {expected} numbers .*, got 2"):
        KernelChoice(bandwidth=(0.5, 2.0)).fit(np.zeros((3, d)), ages)


def test_products_take_precedence_over_sums_in_a_form() -> None:
    choice = KernelChoice("rbf + polynomial*rbf", bandwidth=(1.0,), offset=0.5, degree=2)
    rbf, polynomial = RBF((1.0,)), Polynomial(0.5, 2)
    assert choice.fit(np.zeros((3, 2))) == rbf + polynomial * rbf
