"""All conversions between messages and the core's values; every message is checked here before it is used."""

from __future__ import annotations

import json
from array import array
from collections.abc import Iterable
from typing import Any

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

import rkhs_interfaces.msg as msg
from rkhs_interfaces.srv import DescribeTask, SetPolicy, StartEpisodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance, KernelVariance, Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Kernel, kernel_from_terms
from rkhs_ros.rkhs.validation import finite_array, require
from sim_nodes.simulation import Frame, Simulation

# Reliable, and the newest message is kept for a peer that is discovered late: so the first message of a batch
# cannot be lost, and none of the later ones comes before both ends know each other.
LOCKSTEP_QOS = QoSProfile(depth=16, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def doubles(values: Array) -> array[float]:
    """Return the values as what a float64[] field takes fastest."""
    return array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())


def matrix(values: Any, rows: int, columns: int, what: str) -> Array:
    """Return a float64[] field as a finite matrix of its own.

    Raises:
        ValueError: another number of values, or some that are not finite.
    """
    return finite_array(np.frombuffer(values, dtype=np.float64), (rows, columns), what)


def observation_message(identity: int, batch: Batch, step: int, frame: Frame) -> msg.Observation:
    """Return what the simulator publishes after ``step`` steps of a batch."""
    return msg.Observation(
        batch=identity,
        step=step,
        horizon=batch.horizon,
        seed=batch.seed,
        first_episode=batch.first_episode,
        explore=batch.explore,
        rows=batch.rows,
        observations=doubles(frame.observations),
        rewards=doubles(frame.rewards),
        active=frame.active.tolist(),
    )


def batch_of(message: msg.Observation | StartEpisodes.Request) -> Batch:
    """Return the batch that a message is of.

    Raises:
        ValueError: a number is out of range.
    """
    return Batch(
        seed=message.seed,
        first_episode=message.first_episode,
        rows=message.rows,
        horizon=message.horizon,
        explore=message.explore,
    )


def start_request(identity: int, batch: Batch) -> StartEpisodes.Request:
    """Return the request to start a batch."""
    return StartEpisodes.Request(
        batch=identity,
        seed=batch.seed,
        first_episode=batch.first_episode,
        rows=batch.rows,
        horizon=batch.horizon,
        explore=batch.explore,
    )


def frame_of(message: msg.Observation, observation_dim: int) -> Frame:
    """Return the rows that an observation carries.

    Raises:
        ValueError: sizes do not fit, or numbers are not finite.
    """
    rewarded = message.rows if message.step > 0 else 0
    require(len(message.active) == message.rows, "active", f"{message.rows} rows", len(message.active))
    return Frame(
        matrix(message.observations, message.rows, observation_dim, "observations"),
        matrix(message.rewards, rewarded, 1, "rewards")[:, 0],
        np.array(message.active, dtype=bool),
    )


def describe(simulation: Simulation, response: DescribeTask.Response) -> DescribeTask.Response:
    """Fill in what a simulation's task is."""
    response.environment = simulation.environment
    response.options = json.dumps(simulation.options)
    response.observation_dim = simulation.observation_dim
    response.action_dim = simulation.action_dim
    response.action_low = doubles(simulation.action_low)
    response.action_high = doubles(simulation.action_high)
    return response


def policy_message(policy: GaussianPolicy, version: int) -> msg.Policy:
    """Return the policy as a message."""
    mean = policy.mean
    return msg.Policy(
        version=version,
        observation_dim=mean.input_dim,
        action_dim=mean.output_dim,
        kernel=_terms(mean.kernel),
        centres=doubles(mean.centres),
        weights=doubles(mean.weights),
        variance=_variance_message(policy.variance),
    )


def policy_of(message: msg.Policy) -> GaussianPolicy:
    """Return the policy that a message carries.

    Raises:
        ValueError: it is not finite, misshapen or unknown; the message says what.
    """
    d, n = message.observation_dim, message.action_dim
    require(1 <= d <= 100_000 and 1 <= n <= 1_000, "dimensions", "at least 1 each, of a sensible size", f"{d} and {n}")
    require(len(message.centres) % d == 0, "centres", f"rows of {d} numbers", f"{len(message.centres)} numbers")
    m = len(message.centres) // d
    kernel = _kernel(message.kernel)
    kernel(np.zeros((1, d)), np.zeros((1, d)))  # refuses bandwidths of another dimension
    mean = Function(kernel, matrix(message.centres, m, d, "centres"), matrix(message.weights, m, n, "weights"))
    return GaussianPolicy(mean, _variance_of(message.variance, d, n))


def set_policy_request(policy: GaussianPolicy, version: int) -> SetPolicy.Request:
    """Return the request to serve a policy."""
    return SetPolicy.Request(policy=policy_message(policy, version))


def _terms(kernel: Kernel) -> list[msg.KernelTerm]:
    return [msg.KernelTerm(name=t.name, parameters=doubles(np.array(t.parameters))) for t in kernel.terms()]


def _kernel(terms: Iterable[msg.KernelTerm]) -> Kernel:
    return kernel_from_terms((term.name, term.parameters) for term in terms)


def _variance_message(variance: Variance) -> msg.Variance:
    if isinstance(variance, ConstantVariance):
        return msg.Variance(name="constant", values=doubles(variance.values))
    return msg.Variance(
        name="kernel",
        kernel=_terms(variance.kernel),
        **{name: doubles(getattr(variance, name)) for name in ("values", "centres", "mass", "minimum", "maximum")},
    )


def _variance_of(message: msg.Variance, d: int, n: int) -> Variance:
    require(message.name in ("constant", "kernel"), "variance", "'constant' or 'kernel'", f"'{message.name}'")
    if message.name == "constant":
        return ConstantVariance(matrix(message.values, 1, n, "variance values")[0])
    m = len(message.mass)
    kernel = _kernel(message.kernel)
    kernel(np.zeros((1, d)), np.zeros((1, d)))
    return KernelVariance(
        kernel,
        matrix(message.centres, m, d, "variance centres"),
        matrix(message.mass, m, 1, "variance mass")[:, 0],
        matrix(message.values, m, n, "variance values"),
        matrix(message.minimum, 1, n, "variance minimum")[0],
        matrix(message.maximum, 1, n, "variance maximum")[0],
    )
