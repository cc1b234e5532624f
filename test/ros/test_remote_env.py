"""A simulator node as a Gymnasium environment: bit-identical steps, episode ends, and cleanup."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import rclpy
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env

import rkhs_ros
import test.ros.uneven  # noqa: F401  # registers the environment
from rkhs_interfaces.msg import Observation
from rkhs_ros.base.endings import RunError, SilentError
from rkhs_ros.nodes.lockstep.remote_env import RemoteEnv
from test.ros.conftest import PATIENCE, Process, kill, nodes_of

Start = Callable[..., Process]
Make = Callable[..., Any]
Simulate = Callable[..., Process]
UNEVEN = "test.ros.uneven:Uneven-v0"
STEPS = 1000


@pytest.fixture
def simulator(start: Start) -> Simulate:
    """Start a simulator node, and wait until it answers."""

    def begin(task: str, **options: str) -> Process:
        given = {"environment.id": task, **{f"environment.options.{name}": value for name, value in options.items()}}
        process = start("simulator", "--ros-args", *(w for name, v in given.items() for w in ("-p", f"{name}:={v}")))
        RemoteEnv(timeout=PATIENCE).close()
        return process

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


@pytest.mark.parametrize("task", ["rkhs/Pendulum-v0", pytest.param(UNEVEN, marks=pytest.mark.nightly)])
def test_a_thousand_steps_equal_those_of_the_environment(simulator: Simulate, make: Make, task: str) -> None:
    simulator(task)
    check_env(make(gymnasium.make, "rkhs/Remote-v0").unwrapped)
    remote, direct = make(gymnasium.make, "rkhs/Remote-v0"), make(gymnasium.make, task)
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


def test_a_policy_that_holds_its_actions_is_trained_and_acts_alike(simulator: Simulate, make: Make) -> None:
    task = "rkhs/Pendulum-v0"
    simulator(task)
    settings = {"iterations": 2, "episodes_per_iteration": 2, "evaluation_episodes": 1, "horizon": 30}
    results = [
        rkhs_ros.train(make(gymnasium.make, name), model="none", action_repeat=3, progress=False, **settings)
        for name in ("rkhs/Remote-v0", task)
    ]
    for name in results[0].curve.keys() - {"seconds"}:
        np.testing.assert_array_equal(*(result.curve[name] for result in results))
    assert results[0].curve["steps"].tolist() == [60, 120]
    policy, remote = results[0].policy, make(gymnasium.make, "rkhs/Remote-v0")
    observation, _ = remote.reset(seed=5)
    actions = []
    for _ in range(9):
        actions.append(policy(observation))
        observation, *_ = remote.step(actions[-1])
    assert np.array_equal(actions, np.repeat(actions[::3], 3, axis=0))
    assert len(np.unique(actions)) == 3


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
    for options, reason in (
        ({"domain": 400}, "domain"),
        ({"timeout": 0}, "timeout"),
        ({"horizon": -1}, "horizon"),
        ({"namespace": "no name"}, "namespace"),
    ):
        with pytest.raises(ValueError, match=f"{reason}: expected"):
            make(RemoteEnv, **options)


@pytest.mark.nightly
def test_a_killed_simulator_is_reported_in_time_and_its_successor_used(simulator: Simulate, make: Make) -> None:
    first = simulator("rkhs/Pendulum-v0")
    remote = make(RemoteEnv, timeout=3.0)
    before, _ = remote.reset(seed=4)
    remote.step([1.0])
    kill(first.popen.pid)
    with pytest.raises(SilentError, match=r"the simulator node did not answer within 3 s"):
        remote.step([1.0])
    with pytest.raises(RunError, match="expected a reset first"):
        remote.step([1.0])
    simulator("rkhs/Pendulum-v0")
    np.testing.assert_array_equal(before, remote.reset(seed=4)[0])
    remote.step([1.0])


def play(remote: Any, steps: int) -> None:
    """Make steps, beginning anew where an episode is over."""
    for _ in range(steps):
        if any(remote.step([0.0])[2:4]):
            remote.reset()


def test_a_failing_environment_is_named_and_can_be_reset(simulator: Simulate, make: Make) -> None:
    simulator("test.faults.bad_tasks:Bad-v0", fault="nan reward")
    remote = make(RemoteEnv)
    remote.reset(seed=1)
    play(remote, 65)
    reason = r"^test\.faults\.bad_tasks:Bad-v0: reward of environment 0 in step \d+: expected finite numbers"
    with pytest.raises(RunError, match=reason):
        play(remote, 20)
    remote.reset(seed=1)


def test_a_missing_simulator_is_named(make: Make) -> None:
    with pytest.raises(SilentError, match=r"the /nowhere/simulator node did not answer within 0\.5 s"):
        make(RemoteEnv, namespace="nowhere", timeout=0.5)


def test_a_client_that_takes_over_the_simulator_is_reported(simulator: Simulate, make: Make) -> None:
    simulator("rkhs/Pendulum-v0")
    first, second = make(RemoteEnv, timeout=2.0), make(RemoteEnv)
    first.reset()
    second.reset()
    with pytest.raises(SilentError, match=r"the simulator node made no step 1 within 2 s"):
        first.step([0.0])
    second.step([0.0])


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


def threads() -> int:
    return len(os.listdir("/proc/self/task"))


def test_a_closed_environment_leaves_nothing_behind(simulator: Simulate, make: Make, domain: int) -> None:
    simulator("rkhs/Toy-v0")
    rclpy.init(domain_id=domain)  # as who uses ROS beside it
    make(RemoteEnv).close()  # the first one loads libraries
    before, environment = threads(), dict(os.environ)
    for _ in range(3):
        remote = RemoteEnv()
        remote.reset()
        assert threads() > before
        remote.close()
        remote.close()
    deadline = time.monotonic() + 10
    while threads() > before and time.monotonic() < deadline:
        time.sleep(0.05)
    assert threads() <= before
    assert dict(os.environ) == environment
    assert rclpy.ok()
    rclpy.shutdown()


@pytest.mark.nightly
def test_simulate_ends_with_its_task(start: Start, make: Make) -> None:
    run = start("rkhs", "simulate", "--env", "rkhs/Toy-v0")
    make(RemoteEnv, timeout=30.0).reset(seed=1)
    kill(*nodes_of(run, "simulator"))
    code, _, err = run.finish()
    assert (code, err.splitlines()[-1]) == (1, "error: the simulator node, of rkhs/Toy-v0, was killed by signal 9")


@pytest.mark.clock
def test_a_remote_robot_is_stepped_in_real_time_and_reports_discarded_episodes(start: Start, make: Make) -> None:
    period, patient = 0.05, "robot.learner_timeout=60"
    start("rkhs", "simulate", Path(__file__).parents[2] / "config" / "robot_pendulum.yaml", "--set", patient)
    remote = make(gymnasium.make, "rkhs/Remote-v0", horizon=20, timeout=60.0)
    assert remote.action_space == Box(-3.0, 3.0, (1,), np.float64)
    for _ in range(5):  # the clock may spoil some on a busy machine
        first, _ = remote.reset(seed=1)
        np.testing.assert_allclose(first, [-np.pi, 0.0], atol=0.2)
        began, steps = time.monotonic(), [remote.step([3.0])]
        while not steps[-1][3]:
            steps.append(remote.step([3.0]))
        if "discard_reason" not in steps[-1][4]:
            break
    assert len(steps) == 20
    assert time.monotonic() - began > 19 * period
    assert steps[-1][0][1] > 1.0  # it was pushed
    assert not any(step[2] for step in steps)
    remote.reset()
    remote.step([0.0])
    time.sleep(0.5)
    late = remote.step([0.0])
    while not late[3]:
        late = remote.step([0.0])
    assert late[1:4] == (0.0, False, True)
    assert late[4]["discard_reason"]
