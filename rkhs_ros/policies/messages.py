"""Convert policies and spaces to messages and back.

The message types may come from a ROS workspace or from the bare definitions. A message is any object with the
attributes that rkhs_interfaces defines; each attribute is checked before use.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.validation import require, require_finite
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import MOST_INPUTS, Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.variance import ConstantVariance, Variance, parts_of, variance_from
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Kernel, kernel_from_terms

MOST_ACTIONS = 1_000  # of a policy
FLOATS = ("float32", "float64")  # types of actions
PARTS = {  # of each kind of variance, see `parts_of`
    "constant": ("values",),
    "kernel": ("values", "centres", "mass", "minimum", "maximum"),
    "function": ("values", "centres", "minimum", "maximum"),
}


def doubles(values: NDArray[Any]) -> array[float]:
    """Return the values in the type that a float64[] field accepts fastest."""
    return array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())


def shaped(values: Any, shape: tuple[int, ...], what: str) -> Array:
    """Copy a float64[] field into a read-only array of finite numbers.

    Raises:
        ValueError: the number of values is wrong, or a value is not finite.
    """
    array = viewed(values, shape, what).copy()
    array.setflags(write=False)
    return array


def viewed(values: Any, shape: tuple[int, ...], what: str) -> Array:
    """Return a float64[] field as an array of finite numbers that shares its memory.

    Raises:
        ValueError: the number of values is wrong, or a value is not finite.
    """
    if len(values) != prod(shape):
        raise ValueError(f"{what}: expected {shape} values, got {len(values)}")
    array = np.frombuffer(values)
    require_finite(array, what)
    return array.reshape(shape)


def spaces_fields(spaces: Spaces) -> dict[str, Any]:
    """Return the message fields that describe a task's spaces."""
    return {
        "observation_shape": spaces.observation_shape,
        "action_shape": spaces.action_low.shape,
        "action_type": spaces.action_low.dtype.name,
        "action_low": doubles(spaces.action_low),
        "action_high": doubles(spaces.action_high),
        "observation_names": spaces.observation_names,
        "action_names": spaces.action_names,
    }


def spaces_of(message: Any) -> Spaces:
    """Read a task's spaces from a message.

    Raises:
        ValueError: the shapes, the type or the bounds do not match.
    """
    require(message.action_type in FLOATS, "action_type", f"one of {', '.join(FLOATS)}", message.action_type)
    shape = tuple(int(size) for size in message.action_shape)
    observation_shape = tuple(int(size) for size in message.observation_shape)
    sizes = (prod(observation_shape), prod(shape))
    good = 1 <= sizes[0] <= MOST_INPUTS and 1 <= sizes[1] <= MOST_ACTIONS
    require(good, "task", f"1 to {MOST_INPUTS} observed numbers and 1 to {MOST_ACTIONS} actions", sizes)
    bounds = (np.array(bound, dtype=message.action_type) for bound in (message.action_low, message.action_high))
    low, high = (bound.reshape(shape) if bound.size == sizes[1] else bound for bound in bounds)
    require(low.shape == shape, "action_low", f"{shape} values", low.shape)
    return Spaces(observation_shape, low, high, tuple(message.observation_names), tuple(message.action_names))


def policy_message(types: Any, policy: GaussianPolicy, version: int) -> Any:
    """Convert a policy to a message.

    Args:
        types: object with the message types as attributes: Policy, KernelTerm, Variance and Inputs.
        policy: the policy.
        version: its version.
    """
    mean, inputs = policy.mean, policy.inputs
    return types.Policy(
        version=version,
        input_dim=mean.input_dim,
        action_dim=mean.output_dim,
        kernel=_terms(types, mean.kernel),
        centres=doubles(mean.centres),
        weights=doubles(mean.weights),
        bias=doubles(np.array(mean.bias)),
        variance=types.Variance(**_variance_fields(types, policy.variance)),
        inputs=types.Inputs(
            history=inputs.history,
            angles=inputs.columns,
            turns=doubles(np.array(inputs.turns)),
            degree=inputs.degree,
            offset=inputs.offset,
            action_low=doubles(np.array(inputs.action_low)),
            action_high=doubles(np.array(inputs.action_high)),
        ),
        noise=policy.noise,
        action_repeat=policy.action_repeat,
    )


def policy_of(message: Any) -> GaussianPolicy:
    """Read a policy from a message.

    Raises:
        ValueError: a field is not finite, has the wrong shape, or names an unknown kind.
    """
    d, n = message.input_dim, message.action_dim
    good = 1 <= d <= MOST_INPUTS and 1 <= n <= MOST_ACTIONS
    require(good, "dimensions", f"at least 1 each, at most {MOST_INPUTS} and {MOST_ACTIONS}", f"{d} and {n}")
    require(len(message.centres) % d == 0, "centres", f"rows of {d} numbers", f"{len(message.centres)} numbers")
    m = len(message.centres) // d
    kernel = _kernel(message.kernel)
    centres, weights = shaped(message.centres, (m, d), "centres"), shaped(message.weights, (m, n), "weights")
    mean = Function(kernel, centres, weights, tuple(message.bias))
    variance, inputs = _variance_of(message.variance, d, n), _inputs_of(message.inputs, d)
    return GaussianPolicy(mean, variance, inputs, message.noise, int(message.action_repeat))


def _terms(types: Any, kernel: Kernel | None) -> list[Any]:
    terms = kernel.terms() if kernel else ()
    return [types.KernelTerm(name=t.name, parameters=doubles(np.array(t.parameters))) for t in terms]


def _kernel(terms: Iterable[Any]) -> Kernel:
    return kernel_from_terms((term.name, term.parameters) for term in terms)


def _inputs_of(message: Any, d: int) -> Inputs:
    require(len(message.angles) <= d, "inputs.angles", f"at most {d} columns, one per input", len(message.angles))
    return Inputs(
        history=message.history,
        angles=tuple(map(float, message.angles)) or "none",
        turns=tuple(message.turns),
        degree=message.degree,
        offset=message.offset,
        action_low=tuple(message.action_low),
        action_high=tuple(message.action_high),
    )


def _variance_fields(types: Any, variance: Variance) -> Mapping[str, Any]:
    kernel, parts = parts_of(variance)
    name = next(name for name, used in PARTS.items() if parts.keys() == set(used))
    return {"name": name, "kernel": _terms(types, kernel), **{part: doubles(parts[part]) for part in parts}}


def _variance_of(message: Any, d: int, n: int) -> Variance:
    require(message.name in PARTS, "variance", f"one of {', '.join(PARTS)}", f"'{message.name}'")
    if message.name == "constant":
        return ConstantVariance(shaped(message.values, (n,), "variance values"))
    m = len(message.centres) // d
    shapes = {"values": (m, n), "centres": (m, d), "mass": (m,), "minimum": (n,), "maximum": (n,)}
    parts = {part: shaped(getattr(message, part), shapes[part], f"variance {part}") for part in PARTS[message.name]}
    return variance_from(_kernel(message.kernel), parts)
