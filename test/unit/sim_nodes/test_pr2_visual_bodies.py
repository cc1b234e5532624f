"""The PR2 on film, in a window and as joint states."""

import os
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from rkhs_ros.pictures.film import shoot
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.storage import Task
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation

pytest.importorskip("pybullet", reason="PyBullet is not installed")

from sim_nodes.pr2 import environment, robot, world
from sim_nodes.pr2.environment import PR2Door

pytestmark = pytest.mark.slow

TASK = "rkhs/PR2Door-v0"


@pytest.fixture
def display(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[bool]]:
    """A display that is not there: worlds are made without a window, and which were to be in one is kept."""
    made: list[bool] = []

    class Unseen(world.World):
        def __init__(self, *, gui: bool = False, meshes: bool = False) -> None:
            made.append(gui)
            super().__init__(meshes=meshes)

    monkeypatch.setattr(world, "World", Unseen)
    monkeypatch.setattr(environment, "World", Unseen)
    monkeypatch.setattr(environment, "require_display", lambda: None)
    world.in_window.cache_clear()
    yield made
    world.in_window.cache_clear()


def play(simulation: Simulation, actions: list[list[float]]) -> None:
    simulation.start(Batch(0, 0, len(actions), 1, explore=True))
    simulation.step(np.array(actions))


def test_the_film_has_images_of_every_camera() -> None:
    action, options = [-0.03, -0.02], {"pose": "per_episode"}
    mean = Function(RBF((1e4,)), np.zeros((1, 3)), np.array([action]))
    policy = GaussianPolicy(mean, ConstantVariance(np.full(2, 0.01)))
    runner = InlineRunner(Simulation(TASK, options))
    film = shoot(policy, Task(TASK, options, 1, 0.99), runner, seed=3, frames=5)
    assert set(film.pictures) == {"room", "hand"}
    assert film.captions == ["0.0 s", "1.2 s", "2.4 s", "3.6 s", "4.8 s"]
    task = PR2Door(pose="per_episode")
    task.reset(seed=Batch(3, 0, 1, 1, explore=False).environment_seeds())
    done = runner.collect(policy, Batch(3, 0, 1, 1, explore=False)).actions[0, 0]
    expected = task.render_frames(task.states[0], task.change(done), every=24)
    for camera, pictures in film.pictures.items():
        assert pictures.shape == (5, 360, 480, 3)
        assert np.any(pictures[0] != pictures[-1])
        np.testing.assert_array_equal(pictures, expected[camera])
    task.close()


def test_joint_states_of_the_first_environment_are_available_after_a_step() -> None:
    simulation = Simulation(TASK)
    assert simulation.robot_description() == robot.urdf()
    simulation.start(Batch(0, 0, 2, 1, explore=True))
    assert simulation.joint_states() is None
    play(simulation, [[-0.03, -0.02], [0.01, 0.0]])
    told = simulation.joint_states()
    assert told is not None
    outcomes = simulation.shown.outcomes  # type: ignore[attr-defined]
    names, first = outcomes[0].trajectory.joint_states()
    assert (told.names, told.period) == (names, 0.05)
    np.testing.assert_array_equal(told.positions, first)
    assert np.any(told.positions != outcomes[1].trajectory.joint_states()[1])
    simulation.start(Batch(0, 0, 2, 1, explore=True))
    assert simulation.joint_states() is None


def test_tasks_without_a_robot_have_no_joint_states() -> None:
    for environment_id in ("rkhs/Toy-v0", "Pendulum-v1"):
        simulation = Simulation(environment_id)
        play(simulation, [[0.1], [0.2]])
        assert simulation.joint_states() is None
        assert simulation.robot_description() is None


def test_no_window_opens_by_default(display: list[bool]) -> None:
    play(Simulation(TASK), [[0.0, 0.0]])
    assert display == [False]


def test_all_tasks_of_a_process_share_one_window(display: list[bool]) -> None:
    simulation = Simulation(TASK, {"gui": True})
    play(simulation, [[-0.03, -0.02]])
    shown = simulation.joint_states()
    simulation.shown.close()
    play(simulation, [[-0.03, -0.02], [0.0, 0.0]])
    assert display == [True]
    again, plain = simulation.joint_states(), Simulation(TASK)
    play(plain, [[-0.03, -0.02]])
    unseen = plain.joint_states()
    assert shown is not None
    assert again is not None
    assert unseen is not None
    np.testing.assert_array_equal(shown.positions, again.positions)
    np.testing.assert_array_equal(shown.positions, unseen.positions)


@pytest.mark.skipif(sys.platform != "linux", reason="X11 is asked on Linux only")
@pytest.mark.parametrize("name", [None, "", ":98765"])
def test_a_window_without_a_display_is_refused_in_one_line(name: str | None) -> None:
    variables = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | ({} if name is None else {"DISPLAY": name})
    code = (
        f"import sys; sys.path[:] = {sys.path!r}\n"
        "import sim_nodes.envs\n"
        "from rkhs_ros.rollouts.simulation import Simulation\n"
        f"try: Simulation('{TASK}', {{'gui': True}})\n"
        "except ValueError as error: print(error)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=True)
    assert ended.stdout.count("\n") == 1
    assert "gui: expected a display, got none (" in ended.stdout


def test_a_gui_option_that_is_not_a_boolean_is_refused() -> None:
    with pytest.raises(ValueError, match="gui: expected true or false, got 'yes'"):
        PR2Door(gui="yes")  # type: ignore[arg-type]
