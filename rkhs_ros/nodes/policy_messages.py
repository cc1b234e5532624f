"""Conversions between messages and policies; each message is checked here before it is used."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

import rkhs_interfaces.msg as msg
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.base.settings import build
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.messages import MOST_ACTIONS, MOST_INPUTS, doubles, matrix
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.variance import ConstantVariance, FunctionVariance, KernelVariance, Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Kernel, kernel_from_terms

# What a variance of each name has no use for.
UNUSED = {"constant": ("kernel", "centres", "mass", "minimum", "maximum"), "kernel": (), "function": ("mass",)}


def policy_message(policy: GaussianPolicy, version: int) -> msg.Policy:
    """Return the policy as a message."""
    mean = policy.mean
    return msg.Policy(
        version=version,
        input_dim=mean.input_dim,
        action_dim=mean.output_dim,
        kernel=_terms(mean.kernel),
        centres=doubles(mean.centres),
        weights=doubles(mean.weights),
        variance=_variance_message(policy.variance),
        inputs=msg.Inputs(
            history=policy.inputs.history,
            angles=policy.inputs.columns,
            degree=policy.inputs.degree,
            offset=policy.inputs.offset,
        ),
        noise=policy.noise,
    )


def policy_of(message: msg.Policy) -> GaussianPolicy:
    """Return the policy that a message carries.

    Raises:
        ValueError: it is not finite, misshapen or unknown; the message says what.
    """
    d, n = message.input_dim, message.action_dim
    good = 1 <= d <= MOST_INPUTS and 1 <= n <= MOST_ACTIONS
    require(good, "dimensions", f"at least 1 each, at most {MOST_INPUTS} and {MOST_ACTIONS}", f"{d} and {n}")
    require(len(message.centres) % d == 0, "centres", f"rows of {d} numbers", f"{len(message.centres)} numbers")
    m = len(message.centres) // d
    kernel = _kernel(message.kernel, d)
    mean = Function(kernel, matrix(message.centres, m, d, "centres"), matrix(message.weights, m, n, "weights"))
    return GaussianPolicy(mean, _variance_of(message.variance, d, n), _inputs_of(message.inputs, d), message.noise)


def set_policy_request(policy: GaussianPolicy, version: int) -> SetPolicy.Request:
    """Return the request to serve a policy."""
    return SetPolicy.Request(policy=policy_message(policy, version))


def _terms(kernel: Kernel) -> list[msg.KernelTerm]:
    return [msg.KernelTerm(name=t.name, parameters=doubles(np.array(t.parameters))) for t in kernel.terms()]


def _kernel(terms: Iterable[msg.KernelTerm], d: int) -> Kernel:
    """Return a kernel that has been seen to be one of d-dimensional points."""
    most = max((len(term.parameters) for term in terms), default=0)
    require(most <= MOST_INPUTS, "kernel parameters", f"at most {MOST_INPUTS} a term", most)
    kernel = kernel_from_terms((term.name, term.parameters) for term in terms)
    origin = np.zeros((1, d))
    with np.errstate(all="ignore"):
        good = bool(np.isfinite(kernel(origin, origin)).all())
    require(good, "kernel", "parameters that give finite values", "nan or infinity at the origin")
    return kernel


def _inputs_of(message: msg.Inputs, d: int) -> Inputs:
    require(len(message.angles) <= d, "inputs.angles", f"at most {d} columns, one for each input", len(message.angles))
    numbers = {"history": message.history, "degree": message.degree, "offset": message.offset}
    angles = {"angles": list(message.angles)} if len(message.angles) else {}
    return build(Inputs, {**numbers, **angles}, "inputs.")


def _variance_message(variance: Variance) -> msg.Variance:
    if isinstance(variance, ConstantVariance):
        return msg.Variance(name="constant", values=doubles(variance.values))
    bounds = {"minimum": doubles(variance.minimum), "maximum": doubles(variance.maximum)}
    if isinstance(variance, FunctionVariance):
        g = variance.function
        values, centres, kernel = doubles(g.weights), doubles(g.centres), _terms(g.kernel)
        return msg.Variance(name="function", kernel=kernel, values=values, centres=centres, **bounds)
    return msg.Variance(
        name="kernel",
        kernel=_terms(variance.kernel),
        **{name: doubles(getattr(variance, name)) for name in ("values", "centres", "mass")},
        **bounds,
    )


def _variance_of(message: msg.Variance, d: int, n: int) -> Variance:
    require(message.name in UNUSED, "variance", f"one of {', '.join(UNUSED)}", f"'{message.name}'")
    for name in UNUSED[message.name]:
        size = len(getattr(message, name))
        require(size == 0, f"variance {name}", f"none where the variance is '{message.name}'", f"{size} entries")
    if message.name == "constant":
        return ConstantVariance(matrix(message.values, 1, n, "variance values")[0])
    m = len(message.centres) // d
    kernel = _kernel(message.kernel, d)
    centres, values = matrix(message.centres, m, d, "variance centres"), matrix(message.values, m, n, "variance values")
    bounds = [matrix(getattr(message, name), 1, n, f"variance {name}")[0] for name in ("minimum", "maximum")]
    if message.name == "function":
        return FunctionVariance(Function(kernel, centres, values), *bounds)
    return KernelVariance(kernel, centres, matrix(message.mass, m, 1, "variance mass")[:, 0], values, *bounds)
