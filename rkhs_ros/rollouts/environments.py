"""Batches of Gymnasium environments from an id, an environment or a function."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import gymnasium
from gymnasium import Env
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import VectorEnv, VectorWrapper

from rkhs_ros.base.user_code import is_interrupt, isolated_from_user_code, user_module
from rkhs_ros.base.validation import hint, prefixed, require, truncated
from rkhs_ros.rollouts.env_batch import AnyEnv, AnyVectorEnv, EnvBatch, SeparateEnvs, VectorEnvBatch

Source = str | AnyEnv | AnyVectorEnv | Callable[[], AnyEnv | AnyVectorEnv]
OF_MAKE_VEC = {"num_envs", "vectorization_mode", "vector_kwargs", "wrappers", "max_episode_steps"}  # its arguments


def spec_of(environment: str) -> EnvSpec:
    """Return Gymnasium's specification of an id; ``module:Id-v0`` imports the module that registers it.

    Raises:
        ValueError: the id is unknown, or its module cannot be imported.
    """
    module, _, name = environment.rpartition(":")
    if module:
        with prefixed(f"unknown environment '{truncated(environment)}'"):
            user_module(module, f"add --env {truncated(environment)}")
    try:
        return gymnasium.spec(name)
    except gymnasium.error.Error as error:
        meant = hint(name, gymnasium.registry, f"{module}:" if module else "")
        registers = f". Module {truncated(module)} does not register it: call gymnasium.register in it"
        remedy = registers if module else f". For a custom module, use MODULE:{truncated(name)}"
        raise ValueError(
            f"unknown environment '{truncated(environment)}', {meant}{remedy * ('?' not in meant)}"
        ) from error


def env_batch_of(source: Source, options: Mapping[str, Any] | None = None, num_envs: int = 0) -> EnvBatch:
    """Return a batch of environments.

    Args:
        source: an id, an environment, a vector environment, or a function or class that returns one.
        options: keyword arguments of the environment; only with an id.
        num_envs: maximum number of environments in a batch; 0 for as many as are useful.

    Raises:
        ValueError: the id is unknown, or the environment cannot be created.
    """
    if isinstance(source, str):
        return _registered(source, dict(options or {}), num_envs)
    require(not options, "options", "none, since only an id takes options", options)
    if isinstance(source, VectorEnv):
        return VectorEnvBatch(source, num_envs)
    if isinstance(source, Env):
        return SeparateEnvs(lambda: source, name_of(source), most=1)
    require(callable(source), "environment", "an id, an environment, or a function that returns one", source)
    made = source()
    require(isinstance(made, Env | VectorEnv), f"{name_of(source)}", "a function that returns an environment", made)
    if isinstance(made, VectorEnv):
        return VectorEnvBatch(made, num_envs)
    return SeparateEnvs(partial(next, _copies(made, source)), name_of(made), num_envs)


def name_of(source: Source) -> str:
    """Return the id of an environment, or the name of its class or function if the id does not reproduce it."""
    if isinstance(source, str):
        return source
    spec = getattr(source, "spec", None)
    unwrapped = getattr(source, "unwrapped", source)
    is_wrapped = isinstance(source, VectorWrapper) or (spec is not None and spec.kwargs.get("wrappers"))
    if spec is not None and not is_wrapped and not spec.additional_wrappers:
        return str(spec.id)
    return str(getattr(source, "__name__", type(unwrapped).__name__))


def options_of(source: Source) -> dict[str, Any]:
    """Return the options with which an environment was created from its id."""
    spec = getattr(source, "spec", None)
    kwargs = {} if spec is None else dict(spec.kwargs)
    others = {"render_mode"} | (OF_MAKE_VEC if isinstance(source, VectorEnv) else set())
    return {name: value for name, value in kwargs.items() if name not in others}


def time_limit(source: Source, options: Mapping[str, Any] | None = None) -> int | None:
    """Return the time limit of an environment in steps; None if it has none.

    Raises:
        ValueError: the id is unknown, or an option that changes the time limit is invalid.
    """
    if isinstance(source, str):
        return limit_of(spec_of(source), options or {})
    spec = getattr(source, "spec", None)
    if spec is None:
        return None
    given: int | None = spec.kwargs.get("max_episode_steps") if isinstance(source, VectorEnv) else None
    return given or limit_of(spec, options_of(source))


def limit_of(spec: EnvSpec, options: Mapping[str, Any]) -> int | None:
    """Return the registered time limit, or that of a task whose options change it (``time_limit(options)``)."""
    own = getattr(spec.vector_entry_point, "time_limit", None)
    if spec.max_episode_steps is not None or own is None:
        return spec.max_episode_steps
    steps: int | None = own(options)
    return steps


def _copies(first: AnyEnv, make: Callable[[], Any]) -> Iterator[AnyEnv]:
    yield first
    while True:
        yield make()


def _registered(environment: str, options: dict[str, Any], num_envs: int) -> EnvBatch:
    spec = spec_of(environment)

    @isolated_from_user_code()
    def vector(num_envs: int, horizon: int) -> AnyVectorEnv:
        return gymnasium.make_vec(
            spec, num_envs, max_episode_steps=horizon, vectorization_mode="vector_entry_point", **options
        )

    @isolated_from_user_code()
    def single() -> AnyEnv:  # without a time limit, since the horizon of a batch is the limit
        return gymnasium.make(spec, max_episode_steps=-1, disable_env_checker=True, **options)

    try:
        if spec.vector_entry_point is not None:
            return VectorEnvBatch(vector, num_envs)
        return SeparateEnvs(single, environment, num_envs)
    except (TypeError, LookupError) as error:
        raise ValueError(
            f"environment.options: expected options of {environment}, got {truncated(options)} ({truncated(error)}). "
            "Use environment.options={} for none"
        ) from error
    except BaseException as error:  # user code may raise anything
        if is_interrupt(error):
            raise
        got = f"{type(error).__name__}: {truncated(error)}"
        raise ValueError(f"{environment}: expected an environment that can be created, got {got}") from error
