"""Define the learners of the table of tasks.

CMA-ES searches for a linear policy by whole episodes. A candidate is the weights of a policy. Its inputs are
standardised by the observations of earlier generations. Its actions are in units of half their range, relative to its
middle, and clipped to it. One real episode scores it.

SAC of Stable-Baselines3 and CrossQ of sb3-contrib have default settings, and the inputs of our policies. Both are
imported on first use, since the import is slow and they may not be installed.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import gymnasium
import numpy as np

import sim_nodes.envs  # noqa: F401  # registers the project's tasks
from rkhs_ros.learning.training import train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs, Window
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Linear
from rkhs_ros.rollouts.env_batch import reset_to
from trial import Meter, MeteredRunner, Point, Trial

FIRST_SD = 0.5  # initial standard deviation of the weights in CMA-ES
NEGLIGIBLE_VARIANCE = 1e-18  # of a deterministic policy
CONSTANT = 1e-8  # standard deviation below which an input is ignored
MODULES = {"SAC": "stable_baselines3", "CrossQ": "sb3_contrib"}
EVALUATED_EVERY = 5  # episodes


def linear(weights: Array, seen: Array, spaces: Spaces) -> Function:
    """Return a linear function of standardised inputs.

    Args:
        weights: the constant and the slopes of each action in turn, shape (n (d + 1),).
        seen: inputs by which to standardise, shape (samples, d); without samples they are not standardised.
        spaces: spaces of the task.
    """
    d = seen.shape[1]
    centre, scale = (seen.mean(axis=0), seen.std(axis=0)) if len(seen) else (np.zeros(d), np.ones(d))
    scale = np.where(scale > CONSTANT, scale, 1.0)
    constant, *slopes = weights.reshape(-1, d + 1).T * spaces.half_ranges
    # The kernel is 1 at the first centre, and 1 plus the input j at the centre j.
    centres = centre + np.concatenate([np.zeros((1, d)), np.diag(scale)])
    coefficients = np.array([constant - np.sum(slopes, axis=0), *slopes])
    return Function(Linear(tuple(centre), tuple(scale)), centres, coefficients, spaces.middle)


def linear_cma_es(trial: Trial) -> Iterator[Point]:
    """Run CMA-ES of the package ``cmaes`` with its default population, and evaluate its mean after each generation."""
    from cmaes import CMA  # here, since only this learner needs it

    training, runner = trial.config.training, MeteredRunner(trial)
    spaces = runner.spaces
    inputs = training.inputs.within(spaces)
    seen = np.zeros((0, inputs.dimension(spaces.observation_dim, spaces.action_dim)))
    search = CMA(np.zeros(spaces.action_dim * (seen.shape[1] + 1)), FIRST_SD, seed=training.seed)
    variance = ConstantVariance(np.full(spaces.action_dim, NEGLIGIBLE_VARIANCE))
    while runner.meter.episodes < trial.episodes:
        generation, scored = [seen], []
        for _ in range(search.population_size):
            weights = search.ask()
            policy = GaussianPolicy(linear(weights, seen, spaces), variance, inputs)
            batch = Batch(training.seed, runner.meter.episodes, 1, training.horizon, explore=True)
            episode = runner.collect(policy, batch).with_inputs(inputs)
            scored.append((weights, -float(episode.returns(trial.judged_by)[0])))
            generation.append(episode.flat(episode.observations))
        search.tell(scored)
        seen = np.concatenate(generation)
        yield runner.evaluated(GaussianPolicy(linear(search.mean, seen, spaces), variance, inputs))


def policy_search(trial: Trial) -> Iterator[Point]:
    """Train by the configuration."""
    runner = MeteredRunner(trial)
    for iteration in train(replace(trial.config.training, evaluate_every=0), runner):
        yield runner.evaluated(iteration.policy)
        if runner.meter.episodes >= trial.episodes:
            return


class SeenThrough(gymnasium.Wrapper[Array, Array, Any, Any]):
    """An environment whose observations are the inputs of a policy, which holds its actions. Owns the episode.

    Args:
        env: an environment with flat observations and actions.
        inputs: the inputs to compute from its observations and actions.
        horizon: steps of an episode.
        repeat: steps for which an action is held; its reward is the sum of theirs.

    Attributes:
        observations: raw observations before each step of the episode, shape (horizon, d).
        rewards: rewards of the steps, shape (horizon,), 0 after the end.
        total: number of steps of all episodes so far.
    """

    def __init__(self, env: Any, inputs: Inputs, horizon: int, repeat: int) -> None:
        super().__init__(env)
        self._inputs, self._horizon, self._repeat = inputs, horizon, repeat
        self.total = 0
        size = inputs.dimension(env.observation_space.shape[0], env.action_space.shape[0])
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def reset(self, **options: Any) -> tuple[Array, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(**options)
        self._steps = 0
        self.rewards = np.zeros(self._horizon)
        self.observations = np.zeros((self._horizon, len(observation)))
        self._window = Window(self._inputs, self.env.action_space.shape[0])
        self._now = observation
        return self._shown(), info

    def step(self, action: Array) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Run the steps of a decision."""
        self._window.acted(action[None])
        earned = 0.0
        for _ in range(self._repeat):
            self.observations[self._steps] = self._now
            self._now, reward, terminated, truncated, info = self.env.step(action)
            self.rewards[self._steps] = reward
            earned += float(reward)
            self._steps, self.total = self._steps + 1, self.total + 1
            if terminated or truncated:
                break
        return self._shown(), earned, terminated, truncated, info

    def _shown(self) -> Array:
        return self._window.observed(np.asarray(self._now, dtype=np.float64)[None])[0]


def world(trial: Trial) -> SeenThrough:
    """Return the environment of a trial, flattened and truncated at the horizon."""
    environment, training = trial.config.environment, trial.config.training
    env: Any = gymnasium.make(environment.id, max_episode_steps=training.horizon, **environment.options)
    if not isinstance(env.observation_space, gymnasium.spaces.Box):
        env = gymnasium.wrappers.FlattenObservation(env)
    return SeenThrough(env, training.inputs, training.horizon, trial.repeat)


def deep_learning(name: str, trial: Trial) -> list[Point]:
    """Return the learning curve of a learner, given by the name of its class."""
    import_module("torch").set_num_threads(1)
    learner = getattr(import_module(MODULES[name]), name)  # now, since the import is no part of its time
    training, budget = trial.config.training, trial.episodes
    meter, evaluated, points, env = Meter(trial), world(trial), list[Point](), world(trial)
    model = learner("MlpPolicy", env, seed=training.seed, device="cpu")

    def after_step(variables: dict[str, Any], _: dict[str, Any]) -> bool:
        if variables["dones"][0]:
            meter.episodes, meter.steps = meter.episodes + 1, env.total
            if meter.episodes % EVALUATED_EVERY == 0 or meter.episodes == budget:
                with meter.paused():
                    episodes = [_episode(model, evaluated, seed) for seed in trial.evaluation.environment_seeds()]
                rewards, observations = (np.array(each) for each in zip(*episodes, strict=True))
                points.append(meter.point(rewards, observations, trial.repeat))
        return meter.episodes < budget

    model.learn(budget * training.horizon, callback=after_step)
    return points


def _episode(model: Any, env: SeenThrough, seed: int) -> tuple[Array, Array]:
    """Return the rewards and observations of an evaluation episode, shapes (horizon,) and (horizon, d)."""
    over, observation = False, reset_to(env, seed)
    while not over:
        action, _ = model.predict(observation, deterministic=True)
        observation, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
    return env.rewards, env.observations


@dataclass(frozen=True)
class Learner:
    """A learner of the table.

    Attributes:
        learn: function from a trial to the points of its curve.
        changes: changes of the default settings.
        has_model: whether its budget is that of learners with a model.
        holds_actions: whether it uses the action repeat that ours chose.
        packages: packages that must be installed.
        waits: steps before its first update.
    """

    learn: Callable[[Trial], Iterable[Point]]
    changes: tuple[str, ...] = ()
    has_model: bool = False
    holds_actions: bool = False
    packages: tuple[str, ...] = ()
    waits: int = 0


Deep = partial(Learner, waits=100)  # the default of Stable-Baselines3
SAC, CROSSQ = (partial(deep_learning, name) for name in ("SAC", "CrossQ"))
OF_SAC, OF_CROSSQ = ("stable-baselines3", "torch"), ("stable-baselines3", "sb3-contrib", "torch")
LEARNERS = {
    "ours": Learner(policy_search, has_model=True),
    "no-model": Learner(policy_search, ("model.form=none",)),
    "linear-cma-es": Learner(linear_cma_es, packages=("cmaes",)),
    "sac": Deep(SAC, packages=OF_SAC),
    "sac-held": Deep(SAC, holds_actions=True, packages=OF_SAC),
    "crossq": Deep(CROSSQ, packages=OF_CROSSQ),
    "crossq-held": Deep(CROSSQ, holds_actions=True, packages=OF_CROSSQ),
}


def missing(packages: Iterable[str]) -> list[str]:
    """Return the packages that are not installed."""
    return [name for name in packages if not _is_installed(name)]


def _is_installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True
