import numpy as np
import pytest

from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.rkhs.kernels import RBF, Polynomial, median_bandwidth


def test_the_median_of_the_points_makes_the_bandwidths(rng: np.random.Generator) -> None:
    x = rng.normal(size=(30, 2)) * [1.0, 5.0]
    expected = RBF(tuple(2.0 * b for b in median_bandwidth(x)))
    assert KernelChoice(bandwidth_scale=2.0).fit(x) == expected


def test_given_bandwidths_take_no_notice_of_the_points() -> None:
    assert KernelChoice(bandwidth=(0.5, 2.0)).fit(np.zeros((3, 2))) == RBF((0.5, 2.0))


def test_the_bandwidths_of_one_entry_serve_every_age_of_a_window() -> None:
    choice = KernelChoice(bandwidth=(0.5, 2.0), bandwidth_scale=3.0)
    assert choice.fit(np.zeros((3, 6)), 3) == RBF((1.5, 6.0) * 3)
    assert KernelChoice(bandwidth=(0.5,)).fit(np.zeros((3, 6)), 3) == RBF((0.5,))
    assert KernelChoice(bandwidth=tuple(range(1, 7))).fit(np.zeros((3, 6)), 3) == RBF(tuple(range(1, 7)))
    assert KernelChoice(bandwidth=(0.5,)).fit(np.zeros((3, 3)), 3) == RBF((0.5,))


@pytest.mark.parametrize(("d", "ages", "expected"), [(4, 1, "1 or 4"), (6, 2, "1 or 3 or 6"), (5, 5, "1 or 5")])
def test_bandwidths_that_fit_neither_a_point_nor_an_entry_of_a_window_are_refused(
    d: int, ages: int, expected: str
) -> None:
    with pytest.raises(ValueError, match=f"kernel.bandwidth: expected {expected} numbers, .* got 2"):
        KernelChoice(bandwidth=(0.5, 2.0)).fit(np.zeros((3, d)), ages)


def test_a_form_composes_kernels_with_times_before_plus() -> None:
    choice = KernelChoice("rbf + polynomial*rbf", bandwidth=(1.0,), offset=0.5, degree=2)
    rbf, polynomial = RBF((1.0,)), Polynomial(0.5, 2)
    assert choice.fit(np.zeros((3, 2))) == rbf + polynomial * rbf


@pytest.mark.parametrize(
    ("form", "message"),
    [("rbff", r"unknown kernel 'rbff', did you mean 'rbf'\?"), ("rbf +", "unknown kernel ''"), ("", "unknown kernel")],
)
def test_a_form_with_an_unknown_kernel_is_refused(form: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        KernelChoice(form)
