"""Model-based training with every algorithm, on degenerate tasks, with interruptions and invalid settings."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import count, product
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

from rkhs_ros.base.settings import build
from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.function_spaces import Grid
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.algorithms.rkhs_power import RKHSPoWER
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model_based.validation import Validation
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.posterior import Posterior
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from test.unit.conftest import Result, assert_refused

ITERATIONS, EPISODES, HORIZON = 3, 2, 10
MODEL = {"form": "gaussian_process", "discovery": "none", "updates": 3, "rollouts": 5, "centres": 30}
WIDE = {"grid": [-4.0, 4.0, 2]}
PENDULUM = "rkhs/Pendulum-v0"


def settings(name: str = "rkhs_nac", **changes: Any) -> Training:
    on_grid = issubclass(ALGORITHMS[name], Grid)
    size = WIDE if on_grid else {"centres": 12}
    tree: dict[str, Any] = {
        "iterations": ITERATIONS,
        "episodes_per_iteration": EPISODES,
        "evaluation_episodes": 1,
        "horizon": HORIZON,
        "exploration_sd": "range",
        "algorithm": {"name": name, **size, **changes.pop("algorithm", {})},
        "kernel": {"bandwidth_scale": 200.0 if on_grid else 1.0},
        "model": MODEL,
    }
    return build(Training, {**tree, **changes})


def learn(training: Training, task: Any = PENDULUM) -> list[Iteration]:
    return list(train(training, InlineRunner(Simulation(task))))


def assert_sound(iterations: list[Iteration]) -> None:
    assert [iteration.number for iteration in iterations] == [1, 2, 3]
    assert np.isnan(iterations[0].model_error)  # there is no earlier model
    for iteration in iterations:
        policy, episodes = iteration.policy, iteration.exploration.with_inputs(iteration.policy.inputs)
        points = episodes.flat(episodes.observations)
        assert np.isfinite(policy.mean(points)).all()
        assert (policy.variance(points) > 0).all()
        assert np.isfinite([iteration.model_return, iteration.exploration_return, iteration.evaluation_return]).all()
        assert np.isfinite([getattr(iteration.metrics, f.name) for f in fields(iteration.metrics)]).all()
        assert len(iteration.state.memory) == iteration.episodes_used == EPISODES * iteration.number
    assert np.isfinite([iteration.model_error for iteration in iterations[1:]]).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("algorithm", "changes"),
    [
        *((name, {}) for name in ALGORITHMS),
        ("rkhs_nac", {"variance": "learnt", "reuse": 4}),
        ("rkhs_power", {"variance": "as_published", "weighting": "as_published"}),
    ],
)
def test_every_algorithm_trains_in_a_model(algorithm: str, changes: dict[str, Any]) -> None:
    iterations = learn(settings(algorithm, algorithm=changes, inputs={"angles": [0], "history": 2}))
    assert_sound(iterations)
    assert iterations[-1].policy.mean.weights.any()


class Odd(gymnasium.Env[Any, Any]):
    """A degenerate task: an action changes two numbers in a way that the test selects.

    Args:
        lengths: lengths of consecutive episodes, repeated; 0 for episodes without an end.
        constant: "observations" or "rewards" if these are constant.
        bounded: whether the action has bounds.
        clock: whether the second number is a step counter, with an increment that rounds.
    """

    def __init__(
        self, lengths: tuple[int, ...] = (0,), constant: str = "", *, bounded: bool = True, clock: bool = False
    ) -> None:
        self._lengths, self._constant, self._clock, self._episode = lengths, constant, clock, 0
        self.observation_space = Box(-np.inf, np.inf, (2,), np.float64)
        high = 1.0 if bounded else np.inf
        self.action_space = Box(-high, high, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self._length = self._lengths[self._episode % len(self._lengths)]
        self._episode += 1
        self._steps, self._state = 0, np.array([0.3, 0.0 if self._clock else 0.7])
        return self._state.copy(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._steps += 1
        if self._constant != "observations":
            noise = 0.1 * self.np_random.standard_normal(2)
            self._state = self._state + 0.2 * action[0] + noise if not self._clock else self._ticked(action[0], noise)
        reward = 0.1 if self._constant == "rewards" else float(np.tanh(self._state[0] + action[0]))
        return self._state.copy(), reward, self._steps == self._length, False, {}

    def _ticked(self, push: float, noise: np.ndarray) -> np.ndarray:
        return np.array([self._state[0] + 0.2 * push + noise[0], self._state[1] + 0.1])


ODD = {
    "first episodes of one step": {"lengths": (1, 1, 0)},
    "episodes of one step": {"lengths": (1,)},
    "all terminated": {"lengths": (3, 5)},
    "constant rewards": {"constant": "rewards"},
    "constant observations": {"constant": "observations"},
    "no bounds": {"bounded": False},
    "a clock": {"clock": True},
}


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("algorithm", "odd"),
    sorted({*product(["rkhs_nac"], ODD), *product(ALGORITHMS, ["episodes of one step", "constant rewards"])}),
)
def test_degenerate_tasks_train_in_a_model_without_warnings(algorithm: str, odd: str) -> None:
    assert_sound(learn(settings(algorithm), partial(Odd, **ODD[odd])))


@pytest.mark.filterwarnings("error")
def test_model_based_training_works_with_one_episode_of_one_step() -> None:
    training = replace(settings(), horizon=1, episodes_per_iteration=1)
    assert len(learn(training)) == ITERATIONS


def test_rollouts_terminate_at_once_if_all_real_episodes_did() -> None:
    _, second, _ = learn(settings(), partial(Odd, (1,)))
    real = second.state.memory
    model = DynamicsModel.fit(real, Inputs(), Spaces((2,), np.array([-1.0]), np.array([1.0])), 20)
    assert isinstance(model.termination, Posterior)
    assert (model.termination.mean(real.final_observations) > 0).all()
    rewards = real.flat(real.rewards)
    margin = 0.3 * np.ptp(rewards)
    assert rewards.min() - margin <= second.model_return <= rewards.max() + margin  # of one step


def test_a_line_search_is_rejected_before_the_run(rkhs: Callable[..., Result]) -> None:
    changes = ("algorithm.step={rule: line_search}", "--iterations", 1, "--out", "run")
    result = rkhs("train", "--env", PENDULUM, "--runner", "inline", "--set", *changes)
    assert_refused(result, "algorithm.step.rule: expected fixed or kl for model.form=gaussian_process, got line_search")
    assert not Path("run").exists()
    search = {"step": {"rule": "line_search"}}
    assert len(learn(settings(algorithm=search, model={"form": "none"}))) == ITERATIONS


def test_the_state_contains_all_real_episodes_with_raw_observations() -> None:
    collected = []
    for iteration in learn(settings(inputs={"angles": [0]})):
        collected.append(iteration.exploration)
        whole = sum(collected[1:], start=collected[0])
        for f in fields(whole):
            np.testing.assert_array_equal(getattr(iteration.state.memory, f.name), getattr(whole, f.name))


def test_exploration_in_episodes_of_one_step_is_always_wide() -> None:
    for iteration in learn(settings(horizon=1), Odd):
        np.testing.assert_allclose(iteration.policy.variance(np.zeros((1, 2))), 1.0)


@pytest.mark.parametrize("constant", ["", "rewards"])
def test_exploration_is_narrow_after_the_first_iteration_unless_rewards_are_uninformative(constant: str) -> None:
    for iteration in learn(settings(iterations=4), Odd(constant=constant)):
        assert iteration.policy.noise == ("pink" if constant else "white")
        share = 1.0 if constant else 0.3  # of the next episodes
        np.testing.assert_allclose(iteration.policy.variance(np.zeros((1, 2))), share**2)


@pytest.mark.parametrize(("discount", "repeat", "steps"), [(0.92, 1, 38), (1.0, 1, 100), (1.0, 40, 2)])
def test_model_rollouts_last_whole_decisions_up_to_a_limit_by_the_discount(
    discount: float, repeat: int, steps: int
) -> None:
    lasted = []

    @dataclass(frozen=True)
    class Watched(RKHSNAC):
        def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
            lasted.append((len(experience.episodes), experience.episodes.horizon, experience.discount))
            return super().update(policy, experience)

    training = settings(iterations=1, horizon=100, discount=discount, action_repeat=repeat)
    learn(replace(training, algorithm=Watched(centres=12)))
    assert set(lasted) == {(MODEL["rollouts"], steps, discount)}
    assert discount**steps < 0.05 or steps == 100 // repeat


def test_updates_in_the_model_explore_by_white_noise_and_keep_the_best_rollouts_in_memory() -> None:
    noises, best = set(), []

    @dataclass(frozen=True)
    class Watched(RKHSPoWER):
        def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
            noises.add(policy.noise)
            best.append(experience.memory.returns(experience.discount).max(initial=-np.inf))
            return super().update(policy, experience)

    pendulum = settings(iterations=1, model={**MODEL, "updates": 12})
    learn(replace(pendulum, algorithm=Watched(centres=12, reuse=4)))
    assert best == sorted(best)
    assert len(set(best)) < len(best)  # the rollouts of some updates are worse than those remembered
    learn(replace(settings(), algorithm=Watched(centres=12)), Odd(constant="rewards"))  # whose real episodes are pink
    assert noises == {"white"}


def rarely_rewarded() -> gymnasium.Env[Any, Any]:
    steps = count()
    return gymnasium.wrappers.TransformReward(gymnasium.make("Pendulum-v1"), lambda _: float(next(steps) % 4 == 0))


@pytest.mark.parametrize(("task", "later"), [(PENDULUM, 0.3), ("Pendulum-v1", 0.1), (rarely_rewarded, 0.3)])
def test_exploration_in_the_model_decays_to_its_minimum(
    task: Any, later: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    deviations: list[float] = []  # before each update

    @dataclass(frozen=True)
    class Watched(RKHSNAC):
        def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
            deviations.append(float(np.sqrt(policy.variance(np.zeros((1, 2))))[0, 0]))
            return super().update(policy, experience)

    training = settings(iterations=2, episodes_per_iteration=1, exploration_sd=[2.0], model={**MODEL, "updates": 80})
    monkeypatch.setattr(Validation, "improves", True)
    learn(replace(training, algorithm=Watched(centres=12)), task)
    expected = [2.0 * np.maximum(0.97 ** np.arange(80), least) for least in (0.3, later)]
    np.testing.assert_allclose(deviations, np.concatenate(expected))
