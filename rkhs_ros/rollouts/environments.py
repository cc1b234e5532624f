"""Environments of Gymnasium, by id or as they are, as rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import gymnasium
from gymnasium import Env
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import VectorEnv

from rkhs_ros.base.user_code import isolated_from_user_code, user_module
from rkhs_ros.base.validation import hint, require, truncated
from rkhs_ros.rollouts.env_batch import AnyEnv, AnyVectorEnv, EnvBatch, SeparateEnvs, VectorEnvBatch

Source = str | AnyEnv | AnyVectorEnv | Callable[[], AnyEnv | AnyVectorEnv]


def spec_of(environment: str) -> EnvSpec:
    """Return what Gymnasium knows of an id; ``module:Id-v0`` imports the module that registers it.

    The module is found beside what is installed in the folder that the process was started in, too.

    Raises:
        ValueError: the id is unknown, or its module cannot be imported.
    """
    module, _, name = environment.rpartition(":")
    if module:
        _import_named_in(environment, module)
    try:
        return gymnasium.spec(name)
    except gymnasium.error.Error as error:
        meant = hint(name, gymnasium.registry, f"{module}:" if module else "")
        remedy = "" if module else f"; one of a module of your own is named MODULE:{truncated(name)}"
        raise ValueError(
            f"unknown environment '{truncated(environment)}', {meant}{remedy * ('?' not in meant)}"
        ) from error


def env_batch_of(source: Source, options: Mapping[str, Any] | None = None, num_envs: int = 0) -> EnvBatch:
    """Return the rows of an environment.

    Args:
        source: an id, an environment, a vector environment, or a function (a class, too) that makes one.
        options: keyword options of an id.
        num_envs: rows side by side at most; 0 for any number.

    Raises:
        ValueError: the id is unknown, or the environment cannot be made.
    """
    if isinstance(source, str):
        return _registered(source, dict(options or {}), num_envs)
    require(not options, "options", "them with an id, or given to the environment where it is made", options)
    if isinstance(source, VectorEnv):
        return VectorEnvBatch(source)
    if isinstance(source, Env):
        return SeparateEnvs(lambda: source, name_of(source), most=1)
    require(callable(source), "environment", "an id, an environment, or a function that makes one", source)
    made = source()
    require(isinstance(made, Env | VectorEnv), f"{name_of(source)}", "a function that makes an environment", made)
    if isinstance(made, VectorEnv):
        return env_batch_of(made)
    return SeparateEnvs(partial(next, _copies(made, source)), name_of(made), num_envs)


def name_of(source: Source) -> str:
    """Return an environment's id, or the name of its class or function where that does not make it."""
    if isinstance(source, str):
        return source
    spec = getattr(source, "spec", None)
    unwrapped = getattr(source, "unwrapped", source)
    if spec is not None and not spec.additional_wrappers:
        return str(spec.id)
    return str(getattr(source, "__name__", type(unwrapped).__name__))


def options_of(source: Source) -> dict[str, Any]:
    """Return the options with which an environment was made from its id."""
    spec = getattr(source, "spec", None)
    kwargs = {} if spec is None else dict(spec.kwargs)
    return {name: value for name, value in kwargs.items() if name != "render_mode"}


def own_horizon(source: Source) -> int | None:
    """Return the steps after which an environment cuts its episodes off itself; None where it does not say."""
    spec = spec_of(source) if isinstance(source, str) else getattr(source, "spec", None)
    return None if spec is None else spec.max_episode_steps


def _copies(first: AnyEnv, make: Callable[[], Any]) -> Iterator[AnyEnv]:
    yield first
    while True:
        yield make()


def _registered(environment: str, options: dict[str, Any], num_envs: int) -> EnvBatch:
    spec = spec_of(environment)

    @isolated_from_user_code()
    def vector(rows: int, horizon: int) -> AnyVectorEnv:
        return gymnasium.make_vec(
            spec, rows, max_episode_steps=horizon, vectorization_mode="vector_entry_point", **options
        )

    @isolated_from_user_code()
    def single() -> AnyEnv:  # without a time limit: the horizon of a batch is the limit
        return gymnasium.make(spec, max_episode_steps=-1, disable_env_checker=True, **options)

    try:
        if spec.vector_entry_point is not None:
            return VectorEnvBatch(vector, num_envs)
        return SeparateEnvs(single, environment, num_envs)
    except (TypeError, LookupError) as error:
        raise ValueError(
            f"environment.options: expected what {environment} takes, got {truncated(options)} ({truncated(error)}); "
            "environment.options={} leaves all of them out"
        ) from error
    except KeyboardInterrupt:
        raise
    except (gymnasium.error.DependencyNotInstalled, ImportError) as error:
        raise ValueError(f"{environment}: expected its packages to be installed, got: {truncated(error)}") from error
    except BaseException as error:  # it is somebody's code
        raise ValueError(
            f"{environment}: expected an environment that can be made, got {type(error).__name__}: {truncated(error)}"
        ) from error


def _import_named_in(environment: str, module: str) -> None:
    try:
        user_module(module)
    except ValueError as error:
        raise ValueError(f"unknown environment '{truncated(environment)}': {error}") from error
