"""Strategies that corrupt each field of each message, so that nodes must refuse the message."""

from array import array
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st

from rkhs_interfaces import msg
from rkhs_interfaces.srv import SetPolicy, StartEpisodes
from rkhs_ros.policies.noise import NOISES

Strategy = st.SearchStrategy[Any]
Spoiler = Callable[[Any], Strategy]  # from the message to malformed values of its field

UINT32, UINT64 = 2**32 - 1, 2**64 - 1
KERNELS, VARIANCES = ("rbf", "polynomial", "linear", "sum", "product"), ("constant", "kernel", "function")
NOT_FINITE = st.sampled_from([np.nan, np.inf, -np.inf])
MANY, SAMPLES = 200_000, 10**7
NAMES = st.one_of(
    st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=40),
    st.sampled_from(["RBF", "rbf ", "sum\nproduct", "[/red]", "\x1b[31m", "x" * 10**6, "rbf, " * 10**5]),
)


def several(numbers: Strategy, most: int = 5) -> Strategy:
    return st.lists(numbers, min_size=1, max_size=most).map(lambda values: array("d", values))


def outside(low: int, high: int, limit: int) -> Spoiler:
    """Integers of the type of the field outside the valid range."""
    below = [st.integers(0, low - 1)] if low > 0 else []
    return lambda message: st.one_of(*below, st.integers(high + 1, limit), st.just(limit))


def other(name: str, limit: int) -> Spoiler:
    """Integers other than the current one."""
    return lambda message: st.integers(0, limit).filter(lambda number: number != getattr(message, name))


def foreign(message: Any) -> Strategy:
    """Integers that no test uses."""
    return st.sampled_from([0, UINT64]) | st.integers(2**63, UINT64)


def far(message: Any) -> Strategy:
    """Steps beyond every horizon."""
    return st.just(UINT32) | st.integers(10_000, UINT32)


def put(values: array, place: int, value: float) -> array:
    return values[:place] + array(values.typecode, [value]) + values[place + 1 :]


def missized(values: array) -> Strategy:
    size = st.one_of(st.integers(0, 3 * len(values) + 3), st.just(MANY)).filter(lambda size: size != len(values))
    filled = values or array("d", [1.0])
    return size.map(lambda size: (filled * (size // len(filled) + 1))[:size])


def numbers(name: str, bad: Strategy = NOT_FINITE) -> Spoiler:
    """Arrays of the wrong length, or with an invalid element."""

    def spoilt(message: Any) -> Strategy:
        values = getattr(message, name)
        if not values:
            return missized(values)
        places = st.integers(0, len(values) - 1)
        return st.one_of(missized(values), st.builds(put, st.just(values), places, bad))

    return spoilt


def strange(name: str, known: tuple[str, ...] = ()) -> Spoiler:
    """Texts other than the current one and all known ones."""
    return lambda message: NAMES.filter(lambda text: text not in (*known, getattr(message, name)))


def terms(name: str = "kernel") -> Spoiler:
    """Lists of terms that do not form a single kernel of allowed size."""
    leaf = msg.KernelTerm(name="rbf", parameters=[1.0])
    join = [msg.KernelTerm(name=name) for name in ("sum", "product")]
    deep = [[leaf] * n + join[:1] * (n - 1) for n in (200, 2000, 20_000)]
    chain = [leaf, *[leaf, join[1]] * 5000]

    def spoilt(message: Any) -> Strategy:
        good = list(getattr(message, name))
        lists = [[leaf] * 2, join, [leaf, join[0]], [leaf, leaf, *join], [*good, leaf], [*good, join[0]], chain, *deep]
        return st.sampled_from([*lists, *([[], good[:2], good[::-1]] if good else [])])

    return spoilt


def term_name(term: Any) -> Strategy:
    wrong = ("sum", "product") if term.parameters else ("rbf", "polynomial")
    return st.one_of(strange("name", KERNELS)(term), st.sampled_from(wrong))


def parameters(term: Any) -> Strategy:
    if term.name in ("sum", "product"):
        return several(st.floats())
    if term.name == "rbf":
        positive = st.sampled_from([0.0, -1.0, 5e-324, 1e-310]) | NOT_FINITE
        return numbers("parameters", positive)(term).filter(lambda values: len(values) != 1 or not values[0] > 1e-300)
    if term.name == "linear":  # as many centres as scales
        return numbers("parameters")(term).filter(lambda values: len(values) % 2 or not np.isfinite(values).all())
    offset, degree = term.parameters
    offsets = st.one_of(NOT_FINITE, st.floats(max_value=-1e-300), st.just(1e308))
    degrees = st.one_of(NOT_FINITE, st.sampled_from([0.0, -1.0, 1.5, 21.0, 1e300]))
    return st.one_of(
        missized(term.parameters),
        offsets.map(lambda bad: array("d", [bad, degree])),
        degrees.map(lambda bad: array("d", [offset, bad])),
    )


def unless(names: str, name: str, spoiler: Spoiler) -> Spoiler:
    """Arrays for variances that must be empty, or corrupted ones for the others."""
    full = several(st.floats(0.1, 10.0))
    return lambda variance: full if variance.name in names.split() else spoiler(variance)


def variance_kernel(variance: Any) -> Strategy:
    return st.just([msg.KernelTerm(name="rbf", parameters=[1.0])]) if variance.name == "constant" else terms()(variance)


NOT_POSITIVE = NOT_FINITE | st.sampled_from([0.0, -1.0])
NEGATIVE = NOT_FINITE | st.just(-1.0)
POLICY: dict[str, Spoiler] = {
    "input_dim": other("input_dim", UINT32),
    "action_dim": other("action_dim", UINT32),
    "kernel": terms(),
    "kernel.name": term_name,
    "kernel.parameters": parameters,
    "centres": numbers("centres"),
    "weights": numbers("weights"),
    "variance.name": lambda v: strange("name", VARIANCES)(v) | st.sampled_from([n for n in VARIANCES if n != v.name]),
    "variance.values": lambda v: numbers(
        "values", {"constant": NOT_POSITIVE, "kernel": NEGATIVE}.get(v.name, NOT_FINITE)
    )(v),
    "variance.kernel": variance_kernel,
    "variance.kernel.name": term_name,
    "variance.kernel.parameters": parameters,
    "variance.centres": unless("constant", "centres", numbers("centres")),
    "variance.mass": unless("constant function", "mass", numbers("mass", NOT_POSITIVE)),
    "variance.minimum": unless("constant", "minimum", numbers("minimum", NOT_POSITIVE | st.just(1e300))),
    "variance.maximum": unless("constant", "maximum", numbers("maximum", NOT_POSITIVE | st.just(1e-300))),
    "noise": strange("noise", NOISES),
    "inputs.history": outside(1, 1000, UINT32),
    "inputs.angles": lambda inputs: st.one_of(
        st.integers(10_001, UINT32).map(lambda column: [column]),
        st.sampled_from([[0, 0], [0, 1, 0], [UINT32], list(range(MANY)), [1] * MANY]),
    ).map(lambda columns: array("I", columns)),
    "inputs.degree": outside(0, 20, UINT32),
    "inputs.offset": lambda inputs: NOT_FINITE | st.floats(max_value=0.0) | st.floats(1.1e6, 1e308),
}

# Fields where every value is valid: a batch may end or restart at any time, the policy node ignores which episodes are
# over, and a simulation has no executions.
FREE: dict[Any, set[str]] = {
    SetPolicy.Request: set(),
    msg.Observation: {"over", "terminated", "truncated"},
    msg.Action: set(),
    msg.Episodes: {f"executions.{name}" for name in msg.Execution.get_fields_and_field_types()},
    StartEpisodes.Request: {"anew"},
}

# Malformed in every state.
ALWAYS: dict[Any, dict[str, Spoiler]] = {
    SetPolicy.Request: {f"policy.{name}": spoiler for name, spoiler in POLICY.items()},
    msg.Observation: {
        "step": far,
        "policy_version": foreign,
        "horizon": lambda message: outside(1, min(1_000_000, SAMPLES // message.num_envs), UINT32)(message),
        "first_episode": outside(0, 2**63 - 1, UINT64),
        "num_evaluation": lambda message: outside(0, message.num_envs - 1, UINT32)(message),
        "first_evaluation": outside(0, 2**63 - 1, UINT64),
        "num_envs": lambda message: outside(1, min(10_000, SAMPLES // message.horizon), UINT32)(message),
        "observations": numbers("observations"),
        "rewards": numbers("rewards"),
    },
    msg.Action: {
        "batch": foreign,
        "step": far,
        "policy_version": foreign,
        "actions": numbers("actions"),
    },
    msg.Episodes: {
        "batch": foreign,
        "policy_version": foreign,
        "num_envs": other("num_envs", UINT32),
        "horizon": other("horizon", UINT32),
        "lengths": lambda message: st.one_of(
            missized(message.lengths),
            st.sampled_from([0, message.horizon + 1, UINT32]).map(lambda bad: put(message.lengths, 0, bad)),
        ),
        "observations": numbers("observations"),
        "actions": numbers("actions"),
        "rewards": numbers("rewards"),
        "final_observations": numbers("final_observations"),
        "terminated": lambda message: (
            st.integers(0, 50).filter(lambda n: n != message.num_envs).map(lambda n: [True] * n)
        ),
        "executions": lambda message: st.sampled_from([[msg.Execution(discard_reason=reason)] for reason in ("", "a")]),
    },
    StartEpisodes.Request: {
        "environment": strange("environment"),
        "options": strange("options"),
        "first_episode": outside(0, 2**63 - 1, UINT64),
        "environment_seeds": lambda message: st.one_of(
            st.integers(1, 50).filter(lambda n: n != message.num_envs).map(lambda n: array("q", [1] * n)),
            st.integers(-(2**63), -3).map(lambda seed: array("q", [seed] * message.num_envs)),
        ),
        "num_evaluation": lambda message: outside(0, message.num_envs - 1, UINT32)(message),
        "first_evaluation": outside(0, 2**63 - 1, UINT64),
        "num_envs": lambda message: outside(1, min(10_000, SAMPLES // message.horizon), UINT32)(message),
        "horizon": lambda message: outside(1, min(1_000_000, SAMPLES // message.num_envs), UINT32)(message),
        "clock": lambda message: st.integers(2**40, UINT64) | st.just(UINT64),
    },
}

# Malformed because it contradicts the current policy or batch; at the start, every number is valid.
THEN: dict[Any, dict[str, Spoiler]] = {
    SetPolicy.Request: {"policy.version": lambda policy: st.just(1)},
    msg.Observation: {
        "batch": foreign,
        "step": lambda message: st.integers(message.step + 1, UINT32),
        "horizon": other("horizon", UINT32),
        "seed": other("seed", UINT64),
        "first_episode": other("first_episode", UINT64),
        "num_evaluation": other("num_evaluation", UINT32),
        "first_evaluation": other("first_evaluation", UINT64),
        "explore": lambda message: st.just(not message.explore),
        "num_envs": other("num_envs", UINT32),
    },
    msg.Action: {"step": other("step", UINT32)},
    StartEpisodes.Request: {
        "batch": lambda message: st.just(message.batch - 1),
        "policy_version": other("policy_version", UINT64),
        "seed": other("seed", UINT64),
        "first_episode": other("first_episode", UINT64),
        "num_evaluation": other("num_evaluation", UINT32),
        "first_evaluation": other("first_evaluation", UINT64),
        "num_envs": other("num_envs", UINT32),
        "horizon": other("horizon", UINT32),
        "explore": lambda message: st.just(not message.explore),
    },
}


def spoil(data: st.DataObject, message: Any, path: str, spoiler: Spoiler) -> None:
    """Corrupt one field of a message."""
    *way, name = path.split(".")
    for step in way:
        message = getattr(message, step)
        if isinstance(message, list):
            assume(message)
            message = data.draw(st.sampled_from(message))
    value = data.draw(spoiler(message))
    setattr(message, name, value)


def paths(kind: Any) -> Iterator[str]:
    """Return the fields of a message, including those of nested messages and lists of messages."""
    for name, type_name in kind.get_fields_and_field_types().items():
        inner = getattr(msg, type_name.removeprefix("sequence<").removesuffix(">").rpartition("/")[2], None)
        if inner is None or type_name.startswith("sequence<"):
            yield name
        if inner is not None:
            yield from (f"{name}.{path}" for path in paths(inner))
