"""A simulator node as a Gymnasium environment: bit-identical steps, episode ends, and cleanup."""

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env

from rkhs_interfaces.msg import Observation
from rkhs_ros.base.endings import RunError, SilentError
from rkhs_ros.nodes.lockstep.remote_env import RemoteEnv
from sim_nodes.simulator_node import SimulatorNode
from test.ros.conftest import PATIENCE, Process
from test.unit.rollouts.test_env_batch import Countdown

Start = Callable[..., Process]
Make = Callable[..., Any]
Simulate = Callable[..., Any]
UNEVEN = "Uneven-v0"
STEPS = 1000


class Uneven(Countdown):
    """Ends or is cut off after some steps; its observations are noisy."""

    least = 2  # else Gymnasium's checker complains
    strict = False

    def observe(self) -> Any:
        return super().observe() + self.np_random.uniform(-1.0, 1.0, 2).astype(np.float32)


gymnasium.register(UNEVEN, Uneven, max_episode_steps=7)


@pytest.fixture
def simulator(run_node: Callable[..., Any]) -> Simulate:
    """Start a simulator node in this process, and wait until it answers."""

    def begin(task: str, **options: str) -> None:
        given = {"environment.id": task, **{f"environment.options.{name}": value for name, value in options.items()}}
        words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
        run_node(SimulatorNode, "simulator", *words)
        RemoteEnv(timeout=PATIENCE).close()

    return begin


@pytest.fixture
def make(domain: int) -> Iterator[Make]:
    """Make environments that are closed after the test."""
    made: list[Any] = []

    def remember(kind: Callable[..., Any], *given: Any, **options: Any) -> Any:
        made.append(kind(*given, **options))
        return made[-1]

    yield remember
    for each in made:
        each.close()


def assert_same(ours: Any, theirs: Any) -> None:
    """Compare observations and what came with them, except the info."""
    for one, other in zip(ours[:-1], theirs[:-1], strict=True):
        np.testing.assert_array_equal(one, other)
        assert np.asarray(one).dtype == np.asarray(other).dtype


def test_a_thousand_steps_equal_those_of_the_environment(simulator: Simulate, make: Make) -> None:
    simulator(UNEVEN)
    check_env(make(gymnasium.make, "rkhs/Remote-v0").unwrapped)
    remote, direct = make(gymnasium.make, "rkhs/Remote-v0"), make(gymnasium.make, UNEVEN)
    assert remote.observation_space == direct.observation_space
    assert remote.action_space == direct.action_space
    remote.action_space.seed(5)
    for seed in (7, 7, 8):
        assert_same(remote.reset(seed=seed), direct.reset(seed=seed))
    over = 0
    for _ in range(STEPS):
        action = remote.action_space.sample()
        ours, theirs = remote.step(action), direct.step(action)
        assert_same(ours, theirs)
        if ours[2] or ours[3]:
            over += 1
            assert_same(*(each.reset(seed=over) for each in (remote, direct)))
    assert over >= STEPS // 100


def test_invalid_input_is_refused_and_the_episode_continues(simulator: Simulate, make: Make) -> None:
    simulator("rkhs/Toy-v0")
    remote = make(RemoteEnv, horizon=2)
    with pytest.raises(RunError, match="step: expected a reset first"):
        remote.step([0.0])
    with pytest.raises(ValueError, match=r"seed: expected a number in \[0, 2\^63\), got -1"):
        remote.reset(seed=-1)
    remote.reset(seed=1)
    for bad, reason in (([np.nan], "finite"), ([0.0, 1.0], "values"), (["left"], "real numbers")):
        with pytest.raises(ValueError, match=f"action: expected .*{reason}"):
            remote.step(bad)
    with pytest.raises(ValueError, match=r"options: expected none, .*, got low"):
        remote.reset(options={"low": 1.0})
    assert not any(remote.step([0.1])[2:4])
    assert remote.step([0.1])[2:4] == (False, True)
    with pytest.raises(RunError, match="step: expected a reset first"):
        remote.step([0.0])
    for name, value in {"domain": 400, "timeout": 0, "horizon": -1, "namespace": "no name"}.items():
        with pytest.raises(ValueError, match=f"{name}: expected"):
            make(RemoteEnv, **{name: value})


def play(remote: Any) -> None:
    """Make steps until one fails, beginning anew when an episode is over."""
    while True:
        if any(remote.step([0.0])[2:4]):
            remote.reset()


def test_a_failing_environment_is_named_and_can_be_reset(simulator: Simulate, make: Make) -> None:
    simulator("test.faults.bad_tasks:Bad-v0", fault="nan reward")
    remote = make(RemoteEnv)
    remote.reset(seed=1)
    reason = r"^test\.faults\.bad_tasks:Bad-v0: reward of environment 0 in step \d+: expected finite numbers"
    with pytest.raises(RunError, match=reason):
        play(remote)
    remote.reset(seed=1)


def test_a_missing_simulator_is_named(make: Make) -> None:
    with pytest.raises(SilentError, match=r"the /nowhere/simulator node did not answer within 0\.5 s"):
        make(RemoteEnv, namespace="nowhere", timeout=0.5)


def test_an_interrupt_while_a_message_is_converted_reaches_the_caller(
    simulator: Simulate, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator("rkhs/Toy-v0")
    remote, convert = make(RemoteEnv), Observation.__init__
    remote.reset()

    def interrupted(message: Observation, **fields: object) -> None:
        monkeypatch.setattr(Observation, "__init__", convert)
        signal.raise_signal(signal.SIGINT)
        convert(message, **fields)

    monkeypatch.setattr(Observation, "__init__", interrupted)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            remote.step([0.0])
    finally:
        signal.signal(signal.SIGINT, handler)
    remote.reset()


@pytest.mark.clock
def test_a_remote_robot_is_stepped_in_real_time_and_reports_discarded_episodes(start: Start, make: Make) -> None:
    period, patient = 0.05, "robot.learner_timeout=60"
    start("rkhs", "simulate", Path(__file__).parents[2] / "config" / "robot_pendulum.yaml", "--set", patient)
    remote = make(gymnasium.make, "rkhs/Remote-v0", horizon=20, timeout=60.0)
    assert remote.action_space == Box(-3.0, 3.0, (1,), np.float64)
    first, _ = remote.reset(seed=1)
    np.testing.assert_allclose(first, [-np.pi, 0.0], atol=0.2)
    began, steps = time.monotonic(), [remote.step([3.0])]
    while not steps[-1][3]:
        steps.append(remote.step([3.0]))
    assert (len(steps), steps[-1][4]) == (20, {})
    assert time.monotonic() - began > 19 * period
    assert max(step[0][1] for step in steps) > 1.0  # it was pushed
    remote.reset()
    remote.step([0.0])
    time.sleep(0.5)
    late = remote.step([0.0])
    while not late[3]:
        late = remote.step([0.0])
    assert late[1:4] == (0.0, False, True)
    assert late[4]["discard_reason"]
