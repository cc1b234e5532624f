"""All pictures in difficult cases: no text is cut off or overlaps another, and no legend covers a line."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.film import Film, strip_figure
from rkhs_ros.pictures.known import names_of, success_reward
from rkhs_ros.pictures.policy_axes import PolicyAxes, most_informative
from rkhs_ros.pictures.policy_figure import draw_policy, policy_figure
from rkhs_ros.pictures.run_pictures import attempts_figure, comparison_figure, curve_figure
from rkhs_ros.pictures.style import legend_above, sheet
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs, Names, input_names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Array
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.studies.comparison import Comparison, LearningCurve
from rkhs_ros.view.stage import SIZE
from rkhs_ros.view.timeline import Timeline
from sim_nodes.envs.lever_stafford import Pendulum

pytestmark = pytest.mark.slow

LONG = "somebodys_package.environments.quadrupeds:VeryLongNamed/QuadrupedOnUnevenGround-v12"
PENDULUM = Task("rkhs/Pendulum-v0", {}, 100, 0.99)
SIZES = pytest.mark.parametrize("size", [1e-3, 1e6])
TOUCHING = 0.5  # pixels by which boxes may overlap
LEAST_PLOT = 80  # pixels


def texts(figure: Figure) -> dict[str, Bbox]:
    """Return the boxes of all visible texts, in pixels."""
    seen = list(figure.texts)
    for axes in figure.axes:
        seen += [axes.title, *axes.texts]
        for axis in (axes.xaxis, axes.yaxis):
            seen += [axis.label, axis.get_offset_text()]
            seen += [tick.label1 for tick in axis._update_ticks()]  # the ticks that Matplotlib draws
        if legend := axes.get_legend():
            seen += [legend.get_title(), *legend.get_texts()]
    drawn = [text for text in seen if text.get_visible() and text.get_text().strip()]
    return {f"{k}: {text.get_text()!r}": text.get_window_extent() for k, text in enumerate(drawn)}


def overlap(a: Bbox, b: Bbox) -> bool:
    both = Bbox.intersection(a, b)
    return both is not None and min(both.width, both.height) > TOUCHING


def assert_clear(figure: Figure, *, within: bool = True, least: float = LEAST_PLOT) -> None:
    """Fail if a text is cut off or overlaps another, or a legend covers data."""
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    boxes = texts(figure)
    assert boxes
    edge = figure.bbox.padded(TOUCHING)
    for name, box in boxes.items():
        inside = edge.x0 <= box.x0 and box.x1 <= edge.x1 and edge.y0 <= box.y0 and box.y1 <= edge.y1
        assert inside or not within, f"cut off: {name}"
    for (one, a), (other, b) in combinations(boxes.items(), 2):
        assert not overlap(a, b), f"{one} lies on {other}"
    for axes in figure.axes:
        assert_legend_covers_nothing(axes)
        room = axes.get_window_extent()
        assert min(room.width, room.height) > least or axes.get_label() == "<colorbar>", "no room for the plot"


def assert_legend_covers_nothing(axes: Axes) -> None:
    legend = axes.get_legend()
    if legend is not None:
        assert not overlap(legend.get_window_extent(), axes.get_window_extent())


PLAIN = Inputs()


def policy(d: int, n: int, inputs: Inputs = PLAIN, size: float = 1.0) -> GaussianPolicy:
    rng = np.random.default_rng(d)
    width = inputs.dimension(d, n)
    mean = Function(RBF((2.0,)), rng.normal(size=(30, width)), size * rng.normal(size=(30, n)))
    return GaussianPolicy(mean, ConstantVariance(np.full(n, size**2)), inputs)


def episodes(rows: int, steps: int, d: int, n: int, size: float = 1.0) -> Episodes:
    rng = np.random.default_rng(1)
    shape = (rows, steps)
    observations, actions = rng.normal(size=(*shape, d)), rng.normal(size=(*shape, n))
    return Episodes.without_ends(observations, actions, size * rng.uniform(size=shape), np.ones(shape, dtype=bool))


def long_names(d: int, n: int) -> Names:
    seen = tuple(f"angular velocity of the left front ankle joint {i} (rad/s)" for i in range(d))
    return Names(seen, tuple(f"torque of the right rear shoulder joint {i} (N m)" for i in range(n)))


def bounded(d: int, n: int, size: float) -> Spaces:
    return Spaces((d,), np.full(n, -size), np.full(n, size))


def curve(iterations: int, size: float) -> dict[str, Array]:
    rng = np.random.default_rng(0)
    mean = size * (1.0 + 0.1 * rng.normal(size=iterations))
    mean[1::2] = np.nan
    return {
        "iteration": np.arange(1.0, iterations + 1),
        "exploration_return": size * rng.normal(size=iterations),
        "evaluation_return": mean,
        "evaluation_return_sd": np.where(np.isnan(mean), np.nan, 0.1 * size),
        "evaluation_episodes": np.cumsum(np.where(np.isnan(mean), 0, 10)),
        "model_return": size * (1.0 + 0.1 * rng.normal(size=iterations)),
    }


# Layout


def test_a_band_shows_the_standard_errors_of_evaluations() -> None:
    rows = curve(5, 2.0)
    (band,) = curve_figure(rows, PENDULUM).axes[0].collections
    low, high = (pick(band.get_paths()[0].vertices[:, 1]) for pick in (np.min, np.max))
    measured = rows["evaluation_return"][::2]
    np.testing.assert_allclose([low, high], [measured.min() - 0.2 / 3, measured.max() + 0.2 / 3])


@SIZES
@pytest.mark.parametrize(("task", "iterations"), [(PENDULUM, 1000), (Task(LONG, {}, 1, 0.9), 2)])
def test_the_learning_curve_is_clear(task: Task, iterations: int, size: float) -> None:
    assert_clear(curve_figure(curve(iterations, size), task))


@SIZES
@pytest.mark.parametrize(("d", "n", "steps"), [(1, 1, 1000), (2, 3, 1000), (17, 6, 1)])
def test_the_policy_is_clear(d: int, n: int, steps: int, size: float) -> None:
    made = episodes(2, steps, d, n)
    assert_clear(policy_figure(policy(d, n, size=size), bounded(d, n, size), long_names(d, n), made, LONG))


def test_a_zero_policy_of_windows_without_bounds_is_clear() -> None:
    inputs = Inputs(history=4, angles=(0.0,), degree=2)
    mean = Function.constant(RBF((1.0,)), inputs.dimension(1, 1), 1)
    still, names = GaussianPolicy(mean, ConstantVariance(np.ones(1)), inputs), Names(("angle (rad)",), ("torque",))
    assert_clear(policy_figure(still, Spaces.unbounded(1, 1), names, episodes(1, 30, 1, 1), "t"))


@SIZES
@pytest.mark.parametrize(("n", "count"), [(1, 1000), (2, 1), (6, 100)])
def test_attempts_are_clear(count: int, n: int, size: float) -> None:
    tried, learnt, spaces = episodes(count, 1, 3, n, size), episodes(1, 1, 3, n, size), bounded(3, n, 1e-3)
    for success in (None, 0.5 * size):
        assert_clear(attempts_figure(tried, learnt, spaces, long_names(3, n), LONG, success))


@SIZES
@pytest.mark.parametrize(("count", "runs"), [(1, 1), (9, 20)])
def test_a_comparison_is_clear(count: int, runs: int, size: float) -> None:
    rng = np.random.default_rng(0)
    returns = size * rng.normal(size=(count, runs, 5))
    curves = (
        LearningCurve(f"{LONG} {k}", 1e4 * np.arange(1.0, 6), 5e4, r, is_evaluation=True) for k, r in enumerate(returns)
    )
    assert_clear(
        comparison_figure(Comparison(PENDULUM, tuple(curves), 400, ())), within=False
    )  # the legend adds to its size


@pytest.mark.parametrize(("frames", "shape"), [(1, (30, 40)), (1000, (12, 16))])
def test_a_strip_of_a_film_is_clear(frames: int, shape: tuple[int, int]) -> None:
    pictures = np.zeros((frames, *shape, 1), dtype=np.uint8) + np.arange(3, dtype=np.uint8)
    film = Film(pictures, [f"step {k}" for k in range(frames)])
    assert_clear(strip_figure(film), least=20)


# The pictures of the page


@SIZES
@pytest.mark.parametrize(("d", "n", "rows", "steps"), [(1, 1, 20, 1000), (17, 6, 1, 1)])
def test_the_policy_on_the_page_is_clear(d: int, n: int, rows: int, steps: int, size: float) -> None:
    made = episodes(rows, steps, d, n, size)
    made = replace(made, observations=size * made.observations)
    each = [made.take(slice(row, row + 1)) for row in range(rows)]
    axes = PolicyAxes.of(policy(d, n, size=size), long_names(d, n), made)
    for spaces in (bounded(d, n, size), Spaces.unbounded(d, n)):
        figure = sheet(*SIZE, "Policy after iteration 100000")
        plot = figure.subplots()
        points = draw_policy(plot, axes, spaces, each, (0, d - 1), n - 1)
        assert np.array_equal(points[:, 0], made.observations[-1, :, 0])
        legend_above(plot)
        assert_clear(figure)


@SIZES
@pytest.mark.parametrize(("d", "n", "steps"), [(1, 1, 1), (17, 6, 1000)])
def test_the_timeline_is_clear(d: int, n: int, steps: int, size: float) -> None:
    made = episodes(1, steps, d, n)
    figure = Timeline(long_names(d, n)).figure(size * made.observations[0], made.actions[0])
    assert_clear(figure, least=20)


# Content


def test_colours_show_clipped_actions_and_a_zero_action_is_white() -> None:
    spaces = Spaces((2,), np.array([-0.5]), np.array([0.25]))
    shown, made = policy(3, 1, size=9.0), episodes(2, 50, 3, 1)
    figure = policy_figure(shown, spaces, Names(("x", "y", "z"), ("a",)), made, "t")
    (mesh,) = figure.axes[0].collections
    values = np.asarray(mesh.get_array())
    assert (values.min(), values.max() <= 0.25) == (-0.5, True)
    assert mesh.get_clim() == (-0.5, 0.5)
    assert np.allclose(
        figure.axes[1].lines[0].get_ydata(), spaces.clip(shown.mean(made.observations[1]))[:, 0]
    )  # newest


# Names


class Named(gymnasium.Env[Any, Any]):
    observation_names = ("height (m)", "speed (m/s)")
    action_names = ["thrust (N)"]
    success_reward = 2
    observation_space, action_space = Box(-1.0, 1.0, (2,)), Box(-1.0, 1.0, (1,))


@pytest.fixture
def named() -> Iterator[Task]:
    gymnasium.register("test/Named-v0", Named)
    yield Task("test/Named-v0", {}, 1, 0.9)
    gymnasium.registry.pop("test/Named-v0")


def test_a_task_names_its_observations_and_actions(named: Task) -> None:
    assert names_of(named, 2, 1) == Names(("height (m)", "speed (m/s)"), ("thrust (N)",))
    assert success_reward(named) == 2.0
    spaces = Simulation(named.environment).spaces  # these go into files and messages
    assert Names(spaces.observation_names, spaces.action_names) == names_of(named, 2, 1)
    assert names_of(PENDULUM, 2, 1) == Names(Pendulum.observation_names, Pendulum.action_names)
    assert names_of(named, 2, 1, replace(spaces, observation_names=("a", "b"))).observations == ("a", "b")
    assert names_of(named, 3, 1).observations == ("observation 0", "observation 1", "observation 2")
    assert success_reward(Task("gone:Task-v0", {}, 1, 0.9)) is None


def test_names_of_inputs_match_their_columns() -> None:
    """Each column depends only on the values that its name describes."""
    names = Names(("angle (rad)", "speed"), ("push",))
    inputs = Inputs(history=3, angles=(0.0,))
    labels = input_names(inputs, names)
    assert labels[:4] == (
        "sine of angle, 2 steps ago",
        "cosine of angle, 2 steps ago",
        "speed, 2 steps ago",
        "push, 3 steps ago",
    )
    assert labels[-4:] == ("sine of angle", "cosine of angle", "speed", "push, 1 step ago")
    held = input_names(inputs, names, 3)
    assert (held[2], held[3], held[-1]) == ("speed, 6 steps ago", "push, 9 steps ago", "push, 3 steps ago")
    assert input_names(Inputs(degree=2), Names(("x",), ("a",))) == ("x · x", "x", "constant")
    made = episodes(1, 9, 2, 1)
    (point,) = inputs.at(np.array([8]), made.observations, made.actions)[0]
    o, a = made.observations[0], made.actions[0]
    by_name = {
        "sine of angle, 1 step ago": np.sin(o[7, 0]),
        "speed, 2 steps ago": o[6, 1],
        "push, 2 steps ago": a[6, 0],
    }
    for name, value in by_name.items():
        assert point[labels.index(name)] == pytest.approx(value)


def test_a_cosine_and_a_sine_are_one_angle() -> None:
    angles, speeds = np.linspace(-3.0, 3.0, 40), np.linspace(-1.0, 2.0, 40)
    points = np.column_stack([2 * np.cos(angles), speeds, 2 * np.sin(angles)])
    made = replace(episodes(1, 40, 3, 1), observations=points[None])
    axes = PolicyAxes.of(policy(3, 1), Names(("cos", "speed", "sin"), ("a",)), made)
    assert axes.labels == ("angle of (cos, sin) (rad)", "speed")
    assert np.allclose(axes.visited(made)[0], np.column_stack([angles, speeds]))
    assert np.allclose(axes.inputs(axes.visited(made)[0]), points)


def test_a_slice_of_independent_inputs_explains_the_variance_of_its_inputs() -> None:
    corners = np.array(list(product([-1.0, 1.0], repeat=3)))
    pair, explained = most_informative(lambda x: x @ np.array([2.0, 1.0, 3.0]), corners)
    assert pair == (0, 2)
    assert explained == pytest.approx(13 / 14)  # the inputs contribute variances 4, 1 and 9
