"""Repeatable property tests, small policies and episodes to test with, and the command line in this process."""

import os
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import settings

from rkhs_ros.app.cli import main
from rkhs_ros.learning.algorithms.algorithm import Algorithm, Experience, Update
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.training_settings import NoModel, Training
from rkhs_ros.policies.gaussian import GaussianPolicy, mean_kl
from rkhs_ros.policies.variance import ConstantVariance, KernelVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Kernel

settings.register_profile("repeatable", max_examples=25, deadline=None, derandomize=True, database=None)
settings.load_profile("repeatable")


def model_free(**settings: Any) -> Training:
    """Return settings of fast training without a model, in which nothing is chosen from the data but the bandwidth."""
    plain: dict[str, Any] = {"model": NoModel(), "kernel": KernelChoice(bandwidth="median"), "action_repeat": 1}
    few: dict[str, Any] = {"exploration_sd": (1.0,), "iterations": 40, "episodes_per_iteration": 10}
    return Training(**plain | few | settings)


def kl_between(old: GaussianPolicy, new: GaussianPolicy, x: np.ndarray) -> float:
    return mean_kl(old.mean(x), old.variance(x), new, x)


def inner(h: Function, g: Function) -> float:
    r"""Return :math:`\langle h, g \rangle_{H_K} = \mathrm{tr}(\alpha^\top \kappa(c, c') \beta)`."""
    return float(np.sum(h.weights * (h.kernel(h.centres, g.centres) @ g.weights)))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def random_policy(
    rng: np.random.Generator, d: int = 2, n: int = 2, m: int = 5, *, kernel: Kernel | None = None, learnt: bool = False
) -> GaussianPolicy:
    kernel = kernel or RBF((1.0,))
    mean = Function(kernel, rng.normal(size=(m, d)), rng.normal(size=(m, n)), tuple(np.linspace(0.1, 0.5, n)))
    if not learnt:
        return GaussianPolicy(mean, ConstantVariance(rng.uniform(0.5, 2.0, n)))
    centres, mass, values = rng.normal(size=(m, d)), rng.uniform(0.1, 1, m), rng.uniform(0, 2, (m, n))
    return GaussianPolicy(mean, KernelVariance(kernel, centres, mass, values, np.full(n, 0.1), np.full(n, 1.5)))


def random_episodes(
    rng: np.random.Generator, policy: GaussianPolicy, n: int = 6, horizon: int = 8, *, masked: bool = False
) -> Episodes:
    """Return episodes under a policy; masked ones end at random steps, with zeros after it."""
    observations = rng.normal(size=(n, horizon, policy.mean.input_dim))
    flat = observations.reshape(n * horizon, -1)
    actions = policy.act(flat, rng.standard_normal((len(flat), policy.mean.output_dim))).reshape(n, horizon, -1)
    ends = rng.integers(1, horizon + 1, n) if masked else np.full(n, horizon)
    mask = np.arange(horizon) < ends[:, None]
    return Episodes.without_ends(observations, actions, np.where(mask, rng.uniform(size=(n, horizon)), 0.0), mask)


def refuse(policy: GaussianPolicy, episodes: int) -> Episodes:
    raise AssertionError(f"asked for {episodes} episodes")


def learn(
    algorithm: Algorithm,
    policy: GaussianPolicy,
    episodes: Episodes,
    discount: float = 0.99,
    *,
    memory: Episodes | None = None,
    collect: Callable[[GaussianPolicy, int], Episodes] = refuse,
) -> Update:
    """Update from episodes; nothing is remembered, and there are no fresh episodes, unless they are given."""
    remembered = episodes.take(slice(0)) if memory is None else memory
    first_variance = np.ones(policy.mean.output_dim)
    return algorithm.update(policy, Experience(episodes, discount, remembered, collect, first_variance, 0))


@pytest.fixture
def quick_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing waits for the disk: for tests of what it holds, not of when."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


def arrays_of(value: Any, path: str = "") -> dict[str, np.ndarray]:
    """Return all arrays inside nested dataclasses, by dotted name."""
    if isinstance(value, np.ndarray):
        return {path: value}
    if isinstance(value, tuple):
        return {k: v for i, each in enumerate(value) for k, v in arrays_of(each, f"{path}.{i}").items()}
    if not is_dataclass(value):
        return {}
    return {k: v for f in fields(value) for k, v in arrays_of(getattr(value, f.name), f"{path}.{f.name}").items()}


class Result(NamedTuple):
    """What a command ended with."""

    code: object
    out: str
    err: str


def command_line(captured: pytest.CaptureFixture[str]) -> Callable[..., Result]:
    """Return what runs the command line in this process."""

    def run(*arguments: object) -> Result:
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        return Result(end.value.code, *captured.readouterr())

    return run


@pytest.fixture
def rkhs(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Run the command line in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return command_line(capsys)


def assert_refused(result: Result, message: str, code: int = 2) -> None:
    """One line says what is wrong, and nothing else is said."""
    assert (result.code, result.out) == (code, "")
    assert result.err.startswith("error: ")
    assert result.err.count("\n") == 1
    assert result.err.endswith("\n")
    assert message in result.err
