"""A policy as an ONNX graph in float64: raw observation in, clipped mean action out; checked before it is written.

A policy with memory has another input, ``state``, and output, ``next_state``, whose columns docs/export.md lists.
"""

from dataclasses import replace
from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require, require_extra
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.policy import Policy
from rkhs_ros.policies.storage import NAMES
from rkhs_ros.rkhs.kernels import RBF, Array, Kernel, Linear, Polynomial, Product, Sum, deviations

OPSET, IR_VERSION = 17, 8  # versions of 2022, which ONNX Runtime 1.20 and later support
STATE = "state"
Shapes = dict[str, tuple[int, ...]]
TOLERANCE = 1e-6  # of the actions, relative to the greatest one
COUNT = 1000  # minimum number of observations of a check
SPREAD = 2.0  # of the observations, in standard deviations of the centres


class Graph:
    """The nodes and constants of a graph under construction; values are known by name."""

    def __init__(self) -> None:
        require_extra("onnx", "export", "export")
        import onnx

        self._onnx = onnx
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, operator: str, *values: str | NDArray[Any], name: str = "", **attributes: Any) -> str:
        """Add a node of an ONNX operator; return the name of its output, a new one if empty.

        Each input is the name of a value or a constant.
        """
        name = name or f"{operator}_{len(self._nodes)}"
        inputs = [value if isinstance(value, str) else self._constant(value) for value in values]
        self._nodes.append(self._onnx.helper.make_node(operator, inputs, [name], **attributes))
        return name

    def columns(self, value: str, start: int, end: int) -> str:
        """Return the columns from ``start`` up to ``end`` of a matrix."""
        return self.add("Slice", value, np.array([start]), np.array([end]), np.array([1]))

    def model(self, inputs: Shapes, outputs: Shapes, about: dict[str, str]) -> bytes:
        """Return the graph with metadata as the content of a file, checked by ONNX; shapes lack the batch."""
        helper, number = self._onnx.helper, self._onnx.TensorProto.DOUBLE
        declared = (
            [helper.make_tensor_value_info(name, number, ["batch", *shape]) for name, shape in values.items()]
            for values in (inputs, outputs)
        )
        graph = helper.make_graph(self._nodes, "policy", *declared, initializer=self._constants)
        opset = helper.make_opsetid("", OPSET)
        model = helper.make_model(graph, opset_imports=[opset], ir_version=IR_VERSION, producer_name="rkhs_ros")
        helper.set_model_props(model, about)
        self._onnx.checker.check_model(model, full_check=True)
        content: bytes = model.SerializeToString()
        return content

    def _constant(self, value: NDArray[Any]) -> str:
        name = f"constant_{len(self._constants)}"
        self._constants.append(self._onnx.numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name


@singledispatch
def kernel_values(kernel: Kernel, graph: Graph, points: str, centres: Array) -> str:
    """Add the nodes of a kernel to a graph; return the name of the kernel's values, shape (batch, m).

    Use ``kernel_values.register`` to add an implementation for another class of kernels.

    Args:
        kernel: the kernel.
        graph: the graph to add nodes to.
        points: name of the points, shape (batch, d).
        centres: shape (m, d).

    Raises:
        ValueError: the kernel has no ONNX implementation.
    """
    known = ", ".join(each.__name__ for each in kernel_values.registry if each is not object)
    raise ValueError(f"kernel: expected one with an ONNX implementation ({known}), got {type(kernel).__name__}")


@kernel_values.register
def _(kernel: RBF, graph: Graph, points: str, centres: Array) -> str:
    scale = np.broadcast_to(1.0 / np.array(kernel.bandwidth), centres.shape[1:])
    scaled = graph.add("Unsqueeze", graph.add("Mul", points, scale), np.array([1]))
    # differences instead of a matrix product, which would lose digits far from the origin
    differences = graph.add("Sub", scaled, centres * scale)
    squares = graph.add("ReduceSum", graph.add("Mul", differences, differences), np.array([2]), keepdims=0)
    return graph.add("Exp", graph.add("Mul", squares, np.array(-0.5)))


@kernel_values.register
def _(kernel: Polynomial, graph: Graph, points: str, centres: Array) -> str:
    products = graph.add("MatMul", points, centres.T)
    return graph.add("Pow", graph.add("Add", products, np.array(kernel.offset)), np.array(float(kernel.degree)))


@kernel_values.register
def _(kernel: Linear, graph: Graph, points: str, centres: Array) -> str:
    centre, scale = np.array(kernel.centre), np.array(kernel.scale)
    standardised = graph.add("Div", graph.add("Sub", points, centre), scale)
    return graph.add("Add", graph.add("MatMul", standardised, ((centres - centre) / scale).T), np.array(1.0))


@kernel_values.register(Sum)
@kernel_values.register(Product)
def _(kernel: Sum | Product, graph: Graph, points: str, centres: Array) -> str:
    parts = (kernel_values(part, graph, points, centres) for part in (kernel.left, kernel.right))
    return graph.add("Add" if isinstance(kernel, Sum) else "Mul", *parts)


def state_dim(policy: Policy) -> int:
    """Return the number of columns of the state; 0 if the policy has no memory."""
    inputs, n = policy.gaussian.inputs, policy.spaces.action_dim
    entries = _window_dim(policy) // inputs.history * (inputs.history - 1)
    return 1 + n + entries if policy.gaussian.has_memory else 0


def onnx_model(policy: Policy) -> bytes:
    """Return a policy as the content of an ONNX file.

    Raises:
        ValueError: onnx is not installed, or the policy's kernel has no ONNX implementation.
    """
    graph, spaces, d = Graph(), policy.spaces, policy.spaces.observation_dim
    inputs: Shapes = {"observation": spaces.observation_shape}
    outputs: Shapes = {"action": spaces.action_low.shape}
    observed = _angles(graph, policy.gaussian.inputs, graph.add("Reshape", "observation", np.array([-1, d])), d)
    if size := state_dim(policy):
        inputs[STATE] = outputs[f"next_{STATE}"] = (size,)
        action = _with_state(graph, policy, observed)
    else:
        action = _mean(graph, policy, observed)
    low, high = (bound.ravel().astype(np.float64) for bound in (spaces.action_low, spaces.action_high))
    shape = np.array([-1, *spaces.action_low.shape])
    graph.add("Reshape", _clipped(graph, action, low, high), shape, name="action")
    names = {name: ", ".join(getattr(spaces, name)) for name in NAMES if getattr(spaces, name)}
    return graph.model(inputs, outputs, {"environment": policy.task.environment, **names})


def _clipped(graph: Graph, action: str, low: Array, high: Array) -> str:
    return graph.add("Min", graph.add("Max", action, low), high)


def _angles(graph: Graph, inputs: Inputs, observed: str, count: int) -> str:
    """Replace angles by their sine and cosine, as in `Inputs`."""
    if not inputs.columns:
        return observed
    angles = graph.add("Gather", observed, np.array(inputs.columns), axis=1)
    turned = graph.add("Mul", angles, 2.0 * np.pi / inputs.full_turns)
    quarter = graph.add("Add", turned, np.array(0.5 * np.pi))  # ONNX Runtime 1.20 has no Cos in float64
    parts = [graph.add("Sin", turned), graph.add("Sin", quarter)]
    if rest := [column for column in range(count) if column not in inputs.columns]:
        parts.append(graph.add("Gather", observed, np.array(rest), axis=1))
    return graph.add("Concat", *parts, axis=1)


def _mean(graph: Graph, policy: Policy, window: str) -> str:
    mean = policy.gaussian.mean
    if not len(mean.centres):  # some versions of ONNX Runtime cannot multiply empty matrices
        value = graph.add("MatMul", window, np.zeros((_window_dim(policy), mean.output_dim)))
    else:
        near = kernel_values(mean.kernel, graph, _monomials(graph, policy, window), mean.centres)
        value = graph.add("MatMul", near, mean.weights)
    return graph.add("Add", value, np.array(mean.bias)) if mean.bias else value


def _window_dim(policy: Policy) -> int:
    spaces = policy.spaces
    return replace(policy.gaussian.inputs, degree=0).dimension(spaces.observation_dim, spaces.action_dim)


def _monomials(graph: Graph, policy: Policy, window: str) -> str:
    """Replace a window by its monomials, as in `Inputs`."""
    inputs = policy.gaussian.inputs
    if not inputs.degree:
        return window
    choices, scale, constant = inputs.monomials(_window_dim(policy))
    factors = graph.add("Pad", window, np.array([0, 0, 0, 1]), np.array(constant))
    product = graph.add("Gather", factors, choices[:, 0], axis=1)
    for column in choices.T[1:]:
        product = graph.add("Mul", product, graph.add("Gather", factors, column, axis=1))
    return graph.add("Mul", product, scale)


def _with_state(graph: Graph, policy: Policy, observed: str) -> str:
    """Add the decision of a policy with memory, and its next state; return the unclipped action."""
    n, history = policy.spaces.action_dim, policy.gaussian.inputs.history
    entry = _window_dim(policy) // history
    steps, held = graph.columns(STATE, 0, 1), graph.columns(STATE, 1, 1 + n)
    begins = graph.add("Equal", steps, np.array(0.0))
    expired = graph.add("GreaterOrEqual", steps, np.array(float(policy.gaussian.action_repeat)))
    decides = graph.add("Or", begins, expired)
    window, kept = observed, []
    if history > 1:
        bounds = (policy.gaussian.inputs.action_low, policy.gaussian.inputs.action_high)
        done = _clipped(graph, held, *map(np.array, bounds)) if bounds[0] else held  # zeros in a state of zeros
        newest = graph.add("Concat", observed, done, axis=1)
        earlier = graph.columns(STATE, 1 + n, 1 + n + (history - 1) * entry)
        first = graph.add("Tile", newest, np.array([1, history - 1]))
        window = graph.add("Concat", graph.add("Where", begins, first, earlier), newest, axis=1)
        later = graph.columns(window, entry, history * entry)
        kept.append(graph.add("Where", decides, later, earlier))
    action = graph.add("Where", decides, _mean(graph, policy, window), held)
    counted = graph.add("Where", decides, np.array(1.0), graph.add("Add", steps, np.array(1.0)))
    graph.add("Concat", counted, action, *kept, axis=1, name=f"next_{STATE}")
    return action


def export_onnx(policy: Policy, file: Path) -> tuple[int, float]:
    """Write a policy to an ONNX file if the graph acts like the policy; return the result of `check_onnx`.

    Raises:
        ValueError: onnx or onnxruntime is not installed, the kernel has no ONNX implementation, or the check fails.
        OSError: the file cannot be written.
    """
    content = onnx_model(policy)
    check = check_onnx(policy, content)
    write_whole(file, content)
    return check


def exported_actions(content: bytes, observations: Array) -> Array:
    """Return the actions of an exported policy in a batch of episodes, shape (steps, batch, ...).

    Args:
        content: content of the ONNX file.
        observations: finite, shape (steps, batch, ...).
    """
    require_extra("onnxruntime", "export", "export")
    import onnxruntime

    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    sizes = [value.shape[1] for value in session.get_inputs() if value.name == STATE]
    state, actions = [np.zeros((observations.shape[1], size)) for size in sizes], []
    for step in observations:
        action, *state = session.run(None, {"observation": step, **dict(zip([STATE], state, strict=False))})
        actions.append(action)
    return np.stack(actions)


def check_onnx(policy: Policy, content: bytes) -> tuple[int, float]:
    """Compare an exported policy with the original in random episodes.

    The episodes are just long enough to fill the window. In longer ones, rounding errors could grow, because the window
    feeds actions back. Steps are ignored if the action of the original is not finite.

    Returns:
        The number of observations, and the greatest difference between the actions, relative to the greatest action.

    Raises:
        ValueError: onnxruntime is not installed, or the actions differ by more than the tolerance.
    """
    low, high = (bound.astype(np.float64) for bound in (policy.spaces.action_low, policy.spaces.action_high))
    exact = Policy(policy.gaussian, policy.task, replace(policy.spaces, action_low=low, action_high=high))
    observations = random_observations(policy)
    with np.errstate(over="ignore", invalid="ignore"):
        expected, got = np.stack([exact(step) for step in observations]), exported_actions(content, observations)
        error = np.abs(got - expected)[finite := np.isfinite(expected)].max(initial=0.0)
    greatest = np.abs(expected[finite]).max(initial=0.0)
    relative = float(error / greatest) if greatest else float(error)
    what = f"the actions of the policy within {TOLERANCE:g}"
    require(relative <= TOLERANCE, "policy.onnx", what, f"a difference of {relative:g}")
    return observations.shape[0] * observations.shape[1], relative


def random_observations(policy: Policy) -> Array:
    """Return at least ``COUNT`` observations around the centres, shape (steps, episodes, ...).

    Angles are uniformly distributed over a full turn. The other columns are normally distributed: with the mean of the
    centres' column and ``SPREAD`` times its standard deviation, or, if the inputs are monomials or there are no
    centres, with mean 0 and standard deviation ``SPREAD``.
    """
    rng, spaces, inputs = np.random.default_rng(0), policy.spaces, policy.gaussian.inputs
    d, centres = spaces.observation_dim, policy.gaussian.mean.centres
    steps = inputs.history * policy.gaussian.action_repeat + 1
    shape = (steps, -(-COUNT // steps))
    rest = [column for column in range(d) if column not in inputs.columns]
    observations = SPREAD * rng.normal(size=(*shape, d))
    if len(centres) and rest and not inputs.degree:
        end = centres.shape[1] - (spaces.action_dim if inputs.history > 1 else 0)
        near = centres[:, end - len(rest) : end]  # of the newest observation
        observations[..., rest] = near.mean(axis=0) + observations[..., rest] * deviations(near)
    observations[..., inputs.columns] = rng.uniform(-0.5, 0.5, (*shape, len(inputs.columns))) * inputs.full_turns
    return observations.reshape(*shape, *spaces.observation_shape)
