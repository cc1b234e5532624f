"""Make the films and pictures of the documentation: `python docs/make_films.py NAME ...`.

NAME is one of pendulum, cart_pole, run, pr2 and `tune_node=PARAMETERS`, with the file that `rkhs tune-node` wrote. The
films of robots are made from the folder of a run in config/ after `rkhs evaluate RUN`: `robot_pendulum=RUN` and
`robot_arm=RUN`.
"""

import sys
import tempfile
from collections.abc import Callable, Iterator
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from scipy.optimize import least_squares

from rkhs_ros.app.inline import iterations, runner_of
from rkhs_ros.base.yaml_text import loaded
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.state import first_state
from rkhs_ros.pictures.film import animate, draw_strip, shoot, spread, write_gif
from rkhs_ros.pictures.known import references
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.pictures.style import COLOURS
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.episode_files import load_episodes
from rkhs_ros.runs.run import run_training
from sim_nodes.axis_node import GAINS, PERIOD, TARGET, Axis, Controller
from sim_nodes.envs.scene import Camera

HERE = Path(__file__).parent
CONFIGS = HERE.parent / "config"
RANDOM = "first episode: random exploration"
FRAMES = 50  # per episode
FRAME_MS, ARM_MS, LAST_MS = 60, 150, 3000  # durations of a frame, of one of the arm, and of the last one
WIDTH, HEIGHT, DPI = 9.6, 3.3, 100  # inches
PANEL, TOP = 0.33, 0.88  # width and height of a panel, relative to the figure
SIZE = (round(PANEL * WIDTH * DPI), round(TOP * HEIGHT * DPI))  # pixels of a panel
MAX_BYTES = 2_000_000


class Scene(NamedTuple):
    """An episode in a film.

    Attributes:
        title: title of its panel.
        picture: function that draws a step, of `SIZE`.
        values: number to plot at each step, shape (H,).
    """

    title: str
    picture: Callable[[int], NDArray[np.uint8]]
    values: Array


class Chart(NamedTuple):
    """The plot beside the panels.

    Attributes:
        x: label of the x axis.
        y: label of the y axis.
        step: length of a step on the x axis.
        top: upper end of the y axis.
        reference: value at which to draw a dashed line.
        name: label of that line.
    """

    x: str
    y: str
    step: float
    top: float
    reference: float
    name: str


def pendulum() -> None:
    """Write pendulum_learns.gif: the first episode of the demo, and the one nearest to its evaluation return."""
    config = load_config(CONFIGS / "pendulum_wrap_model_nac.yaml")
    write_film("pendulum_learns", *_learning(config, 1, "after model-based training on it"))


def cart_pole() -> None:
    """Write cart_pole_learns.gif: the first episode, and the policy after eight."""
    config = load_config(CONFIGS / "cart_pole_nac.yaml")
    write_film("cart_pole_learns", *_learning(config, 8, "after 8 episodes of 3 s"))


def robot_pendulum(run: Path) -> None:
    """Write robot_pendulum.gif from a run of config/robot_pendulum.yaml, drawn as the same task in simulation."""
    config = load_config(CONFIGS / "pendulum_model_nac.yaml")
    first, last = _episodes_of(run)
    scenes = [_scene(config, title, episodes) for title, episodes in ((RANDOM, first), ("after ten episodes", last))]
    write_film("robot_pendulum", scenes, _chart(config))


def robot_arm(run: Path) -> None:
    """Write robot_arm.gif from a run of config/robot_arm.yaml."""
    from sim_nodes.robots.arm import distance

    scenes = [
        Scene(title, _arm(episodes.observations[0]), 100.0 * distance(episodes.observations[0]))
        for title, episodes in zip((RANDOM, "after twelve episodes"), _episodes_of(run), strict=True)
    ]
    write_film(
        "robot_arm", scenes, Chart("time (s)", "distance from the mark (cm)", 0.2, 40.0, 5.0, "aim 5 cm"), ARM_MS
    )


def run() -> None:
    """Write pendulum_curve.png and pendulum_policy.png: the pictures of the first run of docs/start.md."""
    config = load_config(CONFIGS / "pendulum_nac.yaml")
    with tempfile.TemporaryDirectory() as folder:
        run_training(config, runner_of(config.environment), Path(folder), quiet=True)
        for picture in draw_run(Path(folder)):
            (HERE / f"pendulum_{picture.name}").write_bytes(picture.read_bytes())


def pr2() -> None:
    """Write pr2_before.png, pr2_after.png, pr2_attempts.png and pr2_door.gif, in some minutes."""
    config = load_config(CONFIGS / "pr2_door_power.yaml")
    first = first_state(config.training, runner_of(config.environment).spaces).policy
    draw_strip(HERE / "pr2_before.png", shoot(first, config.task, runner_of(config.environment)))
    with tempfile.TemporaryDirectory() as name:
        folder = run_training(config, runner_of(config.environment), Path(name), quiet=True)
        _, attempts = draw_run(folder)
        (HERE / "pr2_attempts.png").write_bytes(attempts.read_bytes())
        film = shoot(load_policy(folder / "policy.npz")[0], config.task, runner_of(config.environment))
    draw_strip(HERE / "pr2_after.png", film)
    animate(HERE / "pr2_door.gif", film)


def _learning(config: Config, episodes: int, title: str) -> tuple[list[Scene], Chart]:
    """Return the first episode and the evaluation episode nearest to the mean return at the end, and their chart."""
    first, *_ = done = list(islice(iterations(config), episodes))
    last = done[-1]
    nearest = int(np.argmin(np.abs(last.evaluation_returns - last.evaluation_return)))
    scenes = [_scene(config, RANDOM, first.exploration), _scene(config, title, last.evaluation, nearest)]
    return scenes, _chart(config)


def _scene(config: Config, title: str, episodes: Episodes, index: int = 0) -> Scene:
    """Return the scene of one of several episodes, with the mean of their returns so far."""
    runner = runner_of(config.environment)
    task: Any = runner.simulation.shown
    motion = task.motion(episodes.observations[index], runner.spaces.clip(episodes.actions[index]))
    camera, bodies = Camera(task.view_direction, task.bounds, SIZE), task.bodies()
    discounts = config.training.discount ** np.arange(config.training.horizon)

    def picture(step: int) -> NDArray[np.uint8]:
        return camera.picture(bodies, motion.positions[step], motion.orientations[step])

    return Scene(title, picture, np.cumsum(discounts * episodes.rewards.mean(axis=0)))


def _arm(observations: Array) -> Callable[[int], NDArray[np.uint8]]:
    """Return a function that draws a step of the arm, whose observations are y and z of the mark, and of the tool.

    An observation contains no joint positions: the picture shows those at which the tool is where it was sensed.
    """
    from sim_nodes.bullet import connected  # here, because the other films do not need PyBullet
    from sim_nodes.robots.arm import CENTRE, HOME
    from sim_nodes.robots.arm_body import FILE, JOINTS, TOOL

    client = connected(100.0)
    arm = client.loadURDF(str(FILE), useFixedBase=True)
    ball = client.createVisualShape(client.GEOM_SPHERE, radius=0.035, rgbaColor=to_rgba(COLOURS[1]))
    mark = client.createMultiBody(baseMass=0.0, baseVisualShapeIndex=ball)
    infos = [client.getJointInfo(arm, k) for k in range(client.getNumJoints(arm))]
    joints = [next(k for k, info in enumerate(infos) if info[1].decode() == joint) for joint in JOINTS]
    tool = next(k for k, info in enumerate(infos) if info[12].decode() == TOOL)
    view = client.computeViewMatrix((1.75, -1.35, 1.0), (0.22, 0.0, 0.42), (0.0, 0.0, 1.0))
    lens = client.computeProjectionMatrixFOV(36.0, SIZE[0] / SIZE[1], 0.05, 10.0)

    def tool_at(angles: Array) -> Array:
        """Move the commanded joints 1, 2 and 4, and return the position of the tool."""
        for joint, angle in zip(joints, [*angles[:2], HOME[2], angles[2], *HOME[4:]], strict=True):
            client.resetJointState(arm, joint, angle)
        return np.array(client.getLinkState(arm, tool, computeForwardKinematics=True)[4])

    def picture(step: int) -> NDArray[np.uint8]:
        client.resetBasePositionAndOrientation(mark, [CENTRE[0], *observations[step, :2]], (0.0, 0.0, 0.0, 1.0))
        solved = least_squares(lambda angles: tool_at(angles) - observations[step, 2:], HOME[[0, 1, 3]], diff_step=1e-4)
        tool_at(solved.x)
        pixels = client.getCameraImage(*SIZE, view, lens, renderer=client.ER_TINY_RENDERER)[2]
        return np.reshape(pixels, (SIZE[1], SIZE[0], 4)).astype(np.uint8)[:, :, :3]

    return picture


def _chart(config: Config) -> Chart:
    """Return the plot of the returns so far, with a line at the best known return."""
    name, best = max(references(config.task).items(), key=lambda item: item[1])
    return Chart("step", "discounted return", 1.0, best * 1.15, best, f"{name.partition(' (')[0]} {best:g}")


def _episodes_of(run: Path) -> tuple[Episodes, Episodes]:
    """Return the first exploration episode of a run, and its evaluation episodes."""
    return read_recording(run).exploration(1), load_episodes(run / "evaluation.npz")[0]


def frames(scenes: list[Scene], chart: Chart) -> Iterator[Image.Image]:
    """Yield the frames: the scenes side by side, and the plot of their numbers so far."""
    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI, facecolor="white")
    canvas: Any = FigureCanvasAgg(figure)
    times = chart.step * np.arange(len(scenes[0].values))
    axes = figure.add_axes((0.735, 0.17, 0.19, 0.71))
    axes.axhline(chart.reference, color="0.35", linestyle="--", linewidth=1)
    axes.text(0.04 * times[-1], chart.reference + 0.015 * chart.top, chart.name, color="0.35", fontsize=10)
    axes.set(xlim=(0, times[-1]), ylim=(0, chart.top), xlabel=chart.x, ylabel=chart.y)
    axes.spines[["top", "right"]].set_visible(False)
    colours = COLOURS[1], COLOURS[0]
    lines = [axes.plot([], [], color=colour, linewidth=2.5)[0] for colour in colours]
    ends = [axes.text(0, 0, "", color=colour, va="center", weight="bold") for colour in colours]
    panels = [figure.add_axes((PANEL * k, 0.0, PANEL, TOP)) for k in range(len(scenes))]
    for step in spread(len(times), FRAMES):
        for panel, line, end, scene, colour in zip(panels, lines, ends, scenes, colours, strict=True):
            panel.clear()
            panel.set_axis_off()
            panel.set_title(scene.title, fontsize=12, color=colour)
            panel.imshow(scene.picture(step), interpolation="nearest")
            line.set_data(times[: step + 1], scene.values[: step + 1])
            end.set_text(f"{scene.values[step]:.1f}")
            end.set_position((times[step] + 0.02 * times[-1], scene.values[step]))
        canvas.draw()
        yield Image.fromarray(np.array(canvas.buffer_rgba())[:, :, :3])


def write_film(name: str, scenes: list[Scene], chart: Chart, frame_ms: int = FRAME_MS) -> None:
    """Write a film of scenes beside this file.

    Raises:
        ValueError: the file would be larger than `MAX_BYTES`.
    """
    buffer = BytesIO()
    write_gif(buffer, list(frames(scenes, chart)), frame_ms, LAST_MS)
    if len(buffer.getvalue()) > MAX_BYTES:
        raise ValueError(f"{name}: expected at most {MAX_BYTES} bytes, got {len(buffer.getvalue())}")
    (HERE / f"{name}.gif").write_bytes(buffer.getvalue())


def tune_node(parameters: Path) -> None:
    """Draw steps of the axis with its first gains and with those that ``rkhs tune-node`` wrote."""
    (best,) = loaded(parameters.read_text()).values()
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    axes = figure.subplots()
    for label, gains, colour in (("before", GAINS, COLOURS[1]), ("after", best["ros__parameters"], COLOURS[0])):
        axis, controller, positions = Axis(), Controller(**gains), [0.0]
        for _ in range(200):
            axis.advance(controller.command(axis.sensed))
            positions.append(axis.sensed)
        values = ", ".join(f"{name} = {value:.3g}" for name, value in gains.items())
        axes.plot(PERIOD * np.arange(len(positions)), positions, color=colour, label=f"{label}: {values}")
    axes.axhline(TARGET, color="0.4", linestyle="--", linewidth=1.0, label="target")
    axes.set_xlabel("time (s)")
    axes.set_ylabel("position (m)")
    axes.legend(frameon=False, loc="lower right")
    figure.savefig(HERE / "tune_node.png", dpi=110)


def main() -> None:
    """Make what the command line names."""
    makers: dict[str, Any] = {
        make.__name__: make for make in (pendulum, cart_pole, run, pr2, robot_pendulum, robot_arm, tune_node)
    }
    for argument in sys.argv[1:]:
        name, _, folder = argument.partition("=")
        makers[name](*([Path(folder)] if folder else []))


if __name__ == "__main__":
    main()
