"""Policies in files: plain arrays in npz, no pickle, written aside and renamed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.variance import ConstantVariance, FunctionVariance, KernelVariance, Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Kernel, Term, kernel_from_terms
from rkhs_ros.rkhs.settings import build
from rkhs_ros.rkhs.validation import require

SCHEMA = 2
Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Task:
    """What a policy was learnt on.

    Attributes:
        environment: Gymnasium id.
        options: keyword options of the environment.
        horizon: steps of an episode.
        discount: discount factor of the return.
    """

    environment: str
    options: dict[str, Any]
    horizon: int
    discount: float


def save_policy(path: Path, policy: GaussianPolicy, task: Task) -> None:
    """Write a policy and its task; an existing file is replaced whole or not at all."""
    arrays = {
        "schema": np.array(SCHEMA),
        "task": np.array(json.dumps(asdict(task), sort_keys=True)),
        **_kernel_arrays("kernel", policy.mean.kernel),
        "centres": policy.mean.centres,
        "weights": policy.mean.weights,
        **_variance_arrays(policy.variance),
        "inputs": np.array(json.dumps(asdict(policy.inputs))),
    }
    aside = path.with_name(path.name + ".part")
    with aside.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
        file.flush()
        os.fsync(file.fileno())
    aside.replace(path)


def load_policy(path: Path) -> tuple[GaussianPolicy, Task]:
    """Read a policy and its task.

    Raises:
        ValueError: the file is cut short, of another kind or schema, or holds what is no policy.
        FileNotFoundError: there is no such file.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        schema = int(arrays["schema"])
        require(schema == SCHEMA, f"{path}", f"a policy of schema {SCHEMA}", f"schema {schema}")
        kernel = _kernel(arrays, "kernel")
        mean = Function(kernel, arrays["centres"], arrays["weights"])
        inputs = build(Inputs, json.loads(str(arrays["inputs"])), "inputs.")
        return GaussianPolicy(mean, _variance(arrays), inputs), Task(**json.loads(str(arrays["task"])))
    except FileNotFoundError:
        raise
    except KeyError as error:
        raise ValueError(f"{path}: expected a policy file, got one without {error}") from error
    except Exception as error:  # a damaged archive raises almost anything
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: expected a whole policy file (npz), got an unreadable one ({reason})") from error


def _kernel_arrays(prefix: str, kernel: Kernel) -> Arrays:
    terms = kernel.terms()
    return {
        prefix: np.array([term.name for term in terms]),
        f"{prefix}_parameters": np.concatenate([np.asarray(term.parameters, dtype=float) for term in terms]),
        f"{prefix}_sizes": np.array([len(term.parameters) for term in terms]),
    }


def _kernel(arrays: Arrays, prefix: str) -> Kernel:
    ends = np.cumsum([0, *arrays[f"{prefix}_sizes"]])
    parameters: Sequence[Iterable[float]] = [arrays[f"{prefix}_parameters"][a:b] for a, b in pairwise(ends)]
    return kernel_from_terms(Term(str(n), tuple(p)) for n, p in zip(arrays[prefix], parameters, strict=True))


def _variance_arrays(variance: Variance) -> Arrays:
    if isinstance(variance, ConstantVariance):
        return {"variance": variance.values}
    if isinstance(variance, FunctionVariance):
        function, mass = variance.function, {}
        kernel, centres, values = function.kernel, function.centres, function.weights
    else:
        kernel, centres, values, mass = (
            variance.kernel,
            variance.centres,
            variance.values,
            {"variance_mass": variance.mass},
        )
    return {
        "variance": values,
        **_kernel_arrays("variance_kernel", kernel),
        "variance_centres": centres,
        **mass,
        "variance_minimum": variance.minimum,
        "variance_maximum": variance.maximum,
    }


def _variance(arrays: Arrays) -> Variance:
    if "variance_kernel" not in arrays:
        return ConstantVariance(arrays["variance"])
    kernel, centres, values = _kernel(arrays, "variance_kernel"), arrays["variance_centres"], arrays["variance"]
    bounds = (arrays["variance_minimum"], arrays["variance_maximum"])
    if "variance_mass" not in arrays:
        return FunctionVariance(Function(kernel, centres, values), *bounds)
    return KernelVariance(kernel, centres, arrays["variance_mass"], values, *bounds)
