"""Store policies as plain arrays in npz files, without pickle."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import finite_array, require, truncated
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.variance import parts_of, variance_from
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Kernel, Term, kernel_from_terms

SCHEMA = 3
INPUTS = ("history", "angles", "degree", "offset", "turns")
NAMES = ("observation_names", "action_names")  # optional arrays of a file
# Parts of the variance by their names in a file.
VARIANCE = {"values": "variance"} | {part: f"variance_{part}" for part in ("centres", "mass", "minimum", "maximum")}
Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Task:
    """The task that a policy was trained on.

    Attributes:
        environment: Gymnasium id.
        options: keyword options of the environment.
        horizon: maximum number of steps per episode.
        discount: discount factor of the return.
    """

    environment: str
    options: dict[str, Any]
    horizon: int
    discount: float

    def __post_init__(self) -> None:
        """Raise ValueError if a value from an untrusted file has the wrong type or is out of range."""
        require(isinstance(self.environment, str), "task: environment", "text", repr(self.environment))
        require(isinstance(self.options, Mapping), "task: options", "a section of keys", repr(self.options))
        require(type(self.horizon) is int and self.horizon >= 1, "task: horizon", "a whole number >= 1", self.horizon)
        good = type(self.discount) in (int, float) and 0.0 <= self.discount <= 1.0
        require(good, "task: discount", "a number in [0, 1]", repr(self.discount))


def save_policy(path: Path, policy: GaussianPolicy, task: Task, spaces: Spaces | None = None) -> None:
    """Write a policy, its task and, if known, the task's spaces atomically to a file.

    Raises:
        ValueError: an option of the task is no value of JSON.
        OSError: the file cannot be written.
    """
    try:
        text = json.dumps(vars(task), sort_keys=True)
    except TypeError as error:
        raise ValueError(f"task: options: expected values of JSON, got {truncated(repr(task.options))}") from error
    arrays = {
        "schema": np.array(SCHEMA),
        "task": np.array(text),
        **policy_arrays(policy),
    }
    if spaces:
        arrays |= {"observation_shape": np.array(spaces.observation_shape, dtype=np.int64)}
        arrays |= {"action_low": spaces.action_low, "action_high": spaces.action_high}
        arrays |= {name: np.array(known) for name in NAMES if (known := getattr(spaces, name))}
    write_whole(path, packed(arrays))


def load_policy(path: Path) -> tuple[GaussianPolicy, Task]:
    """Read a policy and its task; raises the same errors as `read_policy`."""
    return read_policy(path)[:2]


def read_policy(path: Path) -> tuple[GaussianPolicy, Task, Spaces | None]:
    """Read a policy, the task that it was trained on, and the task's spaces, None if the file lacks them.

    Raises:
        ValueError: the file is truncated, has another type or schema, or contains no valid policy.
        FileNotFoundError: the file does not exist.
    """
    try:
        arrays = unpacked(path.read_bytes())
        (schema,) = whole_numbers(arrays["schema"].reshape(1), "schema")
        require(schema == SCHEMA, f"{path}", f"a policy of schema {SCHEMA}", f"schema {schema}")
        return policy_of(arrays), Task(**json.loads(str(arrays["task"]))), _spaces(arrays)
    except FileNotFoundError:
        raise
    except KeyError as error:
        raise ValueError(f"{path}: expected a policy file, got one without {error}") from error
    except Exception as error:  # a damaged archive raises almost anything
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: expected a complete policy file (npz), got an unreadable one ({reason})") from error


def _spaces(arrays: Arrays) -> Spaces | None:
    if "observation_shape" not in arrays:
        return None
    shape = whole_numbers(arrays["observation_shape"], "observation_shape")
    names = (tuple(map(str, arrays.get(name, ()))) for name in NAMES)
    return Spaces(tuple(shape), arrays["action_low"], arrays["action_high"], *names)


def packed(arrays: Arrays) -> bytes:
    """Return the content of an npz file without pickled objects."""
    buffer, plain = BytesIO(), dict[str, Any](arrays)
    np.savez(buffer, **plain)
    return buffer.getvalue()


def unpacked(content: bytes) -> Arrays:
    """Return the arrays of an npz file; a damaged file may raise almost any exception.

    Each member is read to its end, because only then its checksum is verified; numpy alone stops at the length in the
    array's header.
    """
    with ZipFile(BytesIO(content)) as archive:
        members = {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}
    return {name: np.lib.format.read_array(BytesIO(member), allow_pickle=False) for name, member in members.items()}


def whole_numbers(values: np.ndarray, what: str) -> list[int]:
    """Return the elements of a one-dimensional array of whole numbers >= 0.

    Raises:
        ValueError: the array has another shape or other values.
    """
    good = values.ndim == 1 and values.dtype.kind in "iu" and bool((values >= 0).all())
    require(good, what, "a one-dimensional array of whole numbers >= 0", values)
    return [int(value) for value in values]


def policy_arrays(policy: GaussianPolicy) -> Arrays:
    """Return the arrays that represent a policy, by name."""
    kernel, parts = parts_of(policy.variance)
    return {
        **_kernel_arrays("kernel", policy.mean.kernel),
        "centres": policy.mean.centres,
        "weights": policy.mean.weights,
        "bias": np.array(policy.mean.bias),
        **{name: parts[part] for part, name in VARIANCE.items() if part in parts},
        **(_kernel_arrays("variance_kernel", kernel) if kernel else {}),
        "inputs": np.array(json.dumps({name: getattr(policy.inputs, name) for name in INPUTS})),
        "window_bounds": np.array([policy.inputs.action_low, policy.inputs.action_high]),
        "noise": np.array(policy.noise),
        "action_repeat": np.array(policy.action_repeat),
    }


def policy_of(arrays: Arrays) -> GaussianPolicy:
    """Rebuild a policy from its arrays; further arrays are ignored.

    Raises:
        KeyError: an array is missing.
        ValueError: the arrays do not form a valid policy.
    """
    mean = Function(_kernel(arrays, "kernel"), arrays["centres"], arrays["weights"], tuple(arrays["bias"].tolist()))
    low, high = (tuple(bound.tolist()) for bound in arrays["window_bounds"])
    inputs = Inputs(**json.loads(str(arrays["inputs"])), action_low=low, action_high=high)
    (action_repeat,) = whole_numbers(arrays["action_repeat"].reshape(1), "action_repeat")
    kernel = _kernel(arrays, "variance_kernel") if "variance_kernel" in arrays else None
    variance = variance_from(kernel, {part: arrays[name] for part, name in VARIANCE.items() if name in arrays})
    return GaussianPolicy(mean, variance, inputs, str(arrays["noise"]), action_repeat)


def _kernel_arrays(prefix: str, kernel: Kernel) -> Arrays:
    terms = kernel.terms()
    return {
        prefix: np.array([term.name for term in terms]),
        f"{prefix}_parameters": np.concatenate([np.asarray(term.parameters, dtype=float) for term in terms]),
        f"{prefix}_sizes": np.array([len(term.parameters) for term in terms]),
    }


def _kernel(arrays: Arrays, prefix: str) -> Kernel:
    ends = np.cumsum([0, *whole_numbers(arrays[f"{prefix}_sizes"], f"{prefix}_sizes")])
    flat = finite_array(arrays[f"{prefix}_parameters"], (int(ends[-1]),), f"{prefix}_parameters")
    parameters = [tuple(flat[a:b]) for a, b in pairwise(ends)]
    return kernel_from_terms(Term(str(n), p) for n, p in zip(arrays[prefix], parameters, strict=True))
