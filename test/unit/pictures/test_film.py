import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from PIL import Image

from rkhs_ros.pictures import film as films
from rkhs_ros.pictures.film import Film, shoot
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.storage import Task, save_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from test.unit.conftest import Result, assert_refused, command_line, random_policy

pytestmark = pytest.mark.slow

TOY = Task("rkhs/Toy-v0", {}, 20, 0.99)
Run = Callable[..., Result]


class Grey(gymnasium.Env[Any, Any]):
    """An environment with three steps per episode, each rendered as a different grey."""

    metadata = {"render_modes": ["rgb_array"]}
    observation_space = Box(-9.0, 9.0, (1,), np.float64)
    action_space = Box(-1.0, 1.0, (1,), np.float64)

    def __init__(self, render_mode: str | None = None, installed: bool = True) -> None:
        self.render_mode = render_mode
        self.installed = installed

    def reset(self, **kwargs: Any) -> Any:
        self.made = 0
        return np.zeros(1), {}

    def step(self, action: Any) -> Any:
        self.made += 1
        return np.full(1, float(self.made)), 0.0, self.made == 3, False, {}

    def render(self) -> Any:
        if not self.installed:
            raise gymnasium.error.DependencyNotInstalled("pip install paint")
        return np.full((20, 30, 3), 80 * self.made, dtype=np.uint8)


class Dark(Grey):
    metadata = {"render_modes": []}


class Moving(Grey):
    """Renders two pictures for each step, like a motion within it."""

    metadata = {"render_modes": ["rgb_array", "rgb_array_list"], "render_fps": 2}

    def render(self) -> Any:
        picture = super().render()
        return [picture, picture + 40]


@pytest.fixture
def foreign() -> Iterator[None]:
    for each in (Grey, Dark, Moving):
        gymnasium.register(f"test/{each.__name__}-v0", each)
    yield
    for each in (Grey, Dark, Moving):
        gymnasium.registry.pop(f"test/{each.__name__}-v0")


@pytest.fixture
def rkhs(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the command line; the output of C libraries is captured, too."""
    monkeypatch.chdir(tmp_path)
    return command_line(capfd)


def constant(*action: float, d: int = 1) -> GaussianPolicy:
    mean = Function(RBF((1e4,)), np.zeros((1, d)), np.array([action]))
    return GaussianPolicy(mean, ConstantVariance(np.full(len(action), 0.25)))


def film(policy: GaussianPolicy, task: Task = TOY, **options: int) -> Film:
    return shoot(policy, task, InlineRunner(Simulation(task.environment, task.options)), **options)


# Frames


@pytest.mark.parametrize("environment", ["rkhs/Toy-v0", "rkhs/Pendulum-v0"])
def test_the_film_shows_what_the_environment_renders_in_the_evaluation_episode(
    rng: np.random.Generator, environment: str
) -> None:
    single = gymnasium.make(environment, render_mode="rgb_array")
    d, task = sum(single.observation_space.shape or ()), Task(environment, {}, 20, 0.99)
    policy, batch = random_policy(rng, d=d, n=1), Batch(4, 0, 1, 20, explore=False)
    shot = film(policy, task, seed=4, frames=200)
    episodes = InlineRunner(Simulation(environment)).collect(policy, batch)
    single.reset(seed=batch.environment_seeds()[0])
    for picture, action in zip(shot.pictures, episodes.actions[0], strict=True):
        np.testing.assert_array_equal(picture, single.render())
        single.step(action)


def test_frames_are_spread_over_the_episode() -> None:
    shot = film(constant(0.1), frames=7)
    assert shot.captions == [f"step {k}" for k in (0, 3, 6, 10, 13, 16, 19)]


def test_other_environments_are_rendered_until_the_episode_ends(foreign: None) -> None:
    shot = film(constant(0.1), Task("test/Grey-v0", {}, 10, 0.9))
    assert [int(picture[0, 0, 0]) for picture in shot.pictures] == [0, 80, 160]
    assert shot.captions == ["step 0", "step 1", "step 2"]
    moved = film(constant(0.1), Task("test/Moving-v0", {}, 10, 0.9), frames=3)
    assert [int(picture[0, 0, 0]) for picture in moved.pictures] == [0, 160, 24]
    assert moved.captions == ["0.0 s", "2.0 s", "3.5 s"]


# Files


@pytest.mark.parametrize(
    ("name", "value", "chosen"), [("_", "", "osmesa"), ("DISPLAY", ":0", None), ("MUJOCO_GL", "glfw", "glfw")]
)
def test_mujoco_renders_off_screen_without_a_display_and_a_choice(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, chosen: str | None
) -> None:
    for each in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(each, raising=False)
    monkeypatch.setattr(films, "find_library", lambda _: None)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv(name, value)
    films.choose_renderer()
    assert os.environ.get("MUJOCO_GL") == chosen


# Command line


def test_render_writes_beside_the_policy_or_into_a_given_folder(rkhs: Run, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    save_policy(tmp_path / "run" / "policy.npz", constant(0.4), TOY)
    assert rkhs("render", "run/policy.npz", "--frames", 9) == (0, "run/film.png\nrun/film.gif\n", "")
    with Image.open("run/film.gif") as animation:
        assert animation.n_frames == 9
    output = rkhs("render", "run/policy.npz", "--frames", 9, "--seed", 1, "--out", "a/b")
    assert output == (0, "a/b/film.png\na/b/film.gif\n", "")
    assert Path("a/b/film.gif").read_bytes() != Path("run/film.gif").read_bytes()
    rkhs("render", "run/policy.npz", "--frames", 9, "--out", "again")
    for name in ("film.png", "film.gif"):
        assert Path("again", name).read_bytes() == Path("run", name).read_bytes()


@pytest.mark.parametrize(
    ("task", "message"),
    [
        (Task("test/Dark-v0", {}, 5, 0.9), "test/Dark-v0: expected an environment with render mode rgb_array, got"),
        (Task("test/Grey-v0", {"installed": False}, 5, 0.9), "a rendered frame, got DependencyNotInstalled"),
        (Task("rkhs/None-v0", {}, 5, 0.9), "unknown environment 'rkhs/None-v0'"),
    ],
)
def test_environments_that_cannot_be_rendered_are_rejected_with_one_line(
    rkhs: Run, foreign: None, task: Task, message: str
) -> None:
    save_policy(Path("p.npz"), constant(0.4), task)
    assert_refused(rkhs("render", "p.npz"), message)
    assert [path.name for path in Path().iterdir()] == ["p.npz"]
