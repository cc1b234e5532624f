"""A policy as an ONNX graph in float64: raw observation in, clipped mean action out.

A policy with a history or held actions has a second input, ``state``, and a second output, ``next_state``. A state of
zeros starts an episode. The caller passes each ``next_state`` as the ``state`` of the next step. A row contains

- the number of steps since the last decision, including the step of the decision; 0 before the first step,
- the unclipped action of the last decision,
- the newest ``history - 1`` entries of the window, from the oldest on.
"""

from functools import singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.policy import Policy
from rkhs_ros.policies.storage import NAMES
from rkhs_ros.rkhs.kernels import RBF, Array, Kernel, Linear, Polynomial, Product, Sum

OPSET, IR_VERSION = 17, 8  # versions of 2022, which ONNX Runtime 1.20 and later support
STATE = "state"
Shapes = dict[str, tuple[int, ...]]


def missing(package: str) -> ValueError:
    """Return the error for an extra that is not installed."""
    return ValueError(f"{package}: expected an installed package, got none. Run pip install onnx onnxruntime")


class Graph:
    """The nodes and constants of a graph under construction; values are known by name.

    Raises:
        ValueError: onnx is not installed.
    """

    def __init__(self) -> None:
        try:
            import onnx
        except ImportError as error:
            raise missing("onnx") from error
        self._onnx = onnx
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, operator: str, *values: str | NDArray[Any], name: str = "", **attributes: Any) -> str:
        """Add a node; return the name of its output.

        Args:
            operator: ONNX operator.
            values: inputs, each the name of a value or a constant.
            name: name of the output; empty for a new one.
            attributes: attributes of the operator.
        """
        name = name or f"{operator}_{len(self._nodes)}"
        inputs = [value if isinstance(value, str) else self._constant(value) for value in values]
        self._nodes.append(self._onnx.helper.make_node(operator, inputs, [name], **attributes))
        return name

    def columns(self, value: str, start: int, end: int) -> str:
        """Return the columns from ``start`` up to ``end`` of a matrix."""
        return self.add("Slice", value, np.array([start]), np.array([end]), np.array([1]))

    def concatenated(self, *values: str, name: str = "") -> str:
        """Return the columns of matrices side by side."""
        return self.add("Concat", *values, name=name, axis=1)

    def model(self, inputs: Shapes, outputs: Shapes, about: dict[str, str]) -> bytes:
        """Return the graph as the content of a file, checked by ONNX.

        Args:
            inputs: shape of each input, without the dimension of the batch.
            outputs: shape of each output, likewise.
            about: metadata.
        """
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


@kernel_values.register
def _(kernel: Sum, graph: Graph, points: str, centres: Array) -> str:
    return graph.add("Add", *(kernel_values(part, graph, points, centres) for part in (kernel.left, kernel.right)))


@kernel_values.register
def _(kernel: Product, graph: Graph, points: str, centres: Array) -> str:
    return graph.add("Mul", *(kernel_values(part, graph, points, centres) for part in (kernel.left, kernel.right)))


def state_dim(policy: Policy) -> int:
    """Return the number of columns of the state; 0 if the policy has no memory."""
    if not policy.gaussian.has_memory:
        return 0
    return 1 + policy.spaces.action_dim + (policy.gaussian.inputs.history - 1) * _entry_dim(policy)


def onnx_model(policy: Policy) -> bytes:
    """Return a policy as the content of an ONNX file.

    Raises:
        ValueError: onnx is not installed, or the policy's kernel has no ONNX implementation.
    """
    graph, spaces, d = Graph(), policy.spaces, policy.spaces.observation_dim
    inputs: Shapes = {"observation": spaces.observation_shape}
    outputs: Shapes = {"action": spaces.action_low.shape}
    observed = _angles(graph, policy.gaussian.inputs, _rows(graph, "observation", (d,)), d)
    if size := state_dim(policy):
        inputs[STATE] = outputs[f"next_{STATE}"] = (size,)
        action = _with_state(graph, policy, observed)
    else:
        action = _mean(graph, policy, observed)
    low, high = (bound.ravel().astype(np.float64) for bound in (spaces.action_low, spaces.action_high))
    _rows(graph, _clipped(graph, action, low, high), spaces.action_low.shape, name="action")
    names = {name: ", ".join(getattr(spaces, name)) for name in NAMES if getattr(spaces, name)}
    return graph.model(inputs, outputs, {"environment": policy.task.environment, **names})


def _rows(graph: Graph, value: str, shape: tuple[int, ...], name: str = "") -> str:
    """Reshape each element of a batch; return the name of the value."""
    return graph.add("Reshape", value, np.array([-1, *shape]), name=name)


def _clipped(graph: Graph, action: str, low: Array, high: Array) -> str:
    """Clip actions to bounds."""
    return graph.add("Min", graph.add("Max", action, low), high)


def _entry_dim(policy: Policy) -> int:
    """Return the number of columns of one entry of the window."""
    return policy.spaces.observation_dim + len(policy.gaussian.inputs.columns) + policy.spaces.action_dim


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
    return graph.concatenated(*parts)


def _mean(graph: Graph, policy: Policy, window: str) -> str:
    """Return the unclipped mean action for a window, flattened and with angles replaced."""
    mean = policy.gaussian.mean
    if not len(mean.centres):  # some versions of ONNX Runtime cannot multiply empty matrices
        value = graph.add("MatMul", window, np.zeros((_window_dim(policy), mean.output_dim)))
    else:
        near = kernel_values(mean.kernel, graph, _monomials(graph, policy, window), mean.centres)
        value = graph.add("MatMul", near, mean.weights)
    return graph.add("Add", value, np.array(mean.bias)) if mean.bias else value


def _window_dim(policy: Policy) -> int:
    history, entry = policy.gaussian.inputs.history, _entry_dim(policy)
    return entry * history if history > 1 else entry - policy.spaces.action_dim


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
    n, history, entry = policy.spaces.action_dim, policy.gaussian.inputs.history, _entry_dim(policy)
    steps, held = graph.columns(STATE, 0, 1), graph.columns(STATE, 1, 1 + n)
    begins = graph.add("Equal", steps, np.array(0.0))
    expired = graph.add("GreaterOrEqual", steps, np.array(float(policy.gaussian.action_repeat)))
    decides = graph.add("Or", begins, expired)
    window, kept = observed, []
    if history > 1:
        bounds = (policy.gaussian.inputs.action_low, policy.gaussian.inputs.action_high)
        done = _clipped(graph, held, *map(np.array, bounds)) if bounds[0] else held  # zeros in a state of zeros
        newest = graph.concatenated(observed, done)
        earlier = graph.columns(STATE, 1 + n, 1 + n + (history - 1) * entry)
        first = graph.add("Tile", newest, np.array([1, history - 1]))
        window = graph.concatenated(graph.add("Where", begins, first, earlier), newest)
        later = graph.columns(window, entry, history * entry)
        kept.append(graph.add("Where", decides, later, earlier))
    action = graph.add("Where", decides, _mean(graph, policy, window), held)
    counted = graph.add("Where", decides, np.array(1.0), graph.add("Add", steps, np.array(1.0)))
    graph.concatenated(counted, action, *kept, name=f"next_{STATE}")
    return action
