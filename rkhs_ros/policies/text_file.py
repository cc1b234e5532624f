"""A policy as a text file for the C++ header ``rkhs_policy.hpp``.

The file contains words and numbers separated by white space. Each list of numbers follows its length.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from rkhs_ros.base.validation import require
from rkhs_ros.policies.policy import Policy
from rkhs_ros.rkhs.kernels import Array

HEADER = Path(__file__).with_name("rkhs_policy.hpp")
FIRST_LINE = "rkhs_policy 1"  # with the version of the format
KERNELS = {"rbf", "polynomial", "linear", "sum", "product"}


def policy_text(policy: Policy) -> str:
    """Return a policy as text.

    Raises:
        ValueError: the header does not implement the policy's kernel.
    """
    inputs, mean, spaces = policy.gaussian.inputs, policy.gaussian.mean, policy.spaces
    terms = mean.kernel.terms()
    for term in terms:
        require(term.name in KERNELS, "kernel", f"one of {', '.join(sorted(KERNELS))}", term.name)
    size = inputs.history * (spaces.observation_dim + len(inputs.columns) + spaces.action_dim * (inputs.history > 1))
    none: tuple[Array, Array, float] = np.zeros((0, 0)), np.zeros(0), 0.0
    factors, scales, constant = inputs.monomials(size) if inputs.degree else none
    lines = [
        FIRST_LINE,
        f"{spaces.observation_dim} {inputs.history} {policy.gaussian.action_repeat}",
        *(_listed(bound.ravel().astype(np.float64)) for bound in (spaces.action_low, spaces.action_high)),
        *(_listed(values) for values in (inputs.columns, inputs.full_turns)),
        f"{inputs.degree}\n{_listed(factors.ravel())}\n{_listed(scales)}\n{constant!r}",
        f"{len(terms)}",
        *(f"{term.name} {_listed(term.parameters)}" for term in terms),
        *(_listed(matrix.ravel()) for matrix in (mean.centres, mean.weights)),
    ]
    return "".join(f"{line}\n" for line in lines)


def _listed(values: Iterable[float]) -> str:
    """Return the length of a list and its numbers, with enough digits to read back the same values."""
    numbers = [float(value) for value in values]
    return " ".join([str(len(numbers)), *map(repr, numbers)])
