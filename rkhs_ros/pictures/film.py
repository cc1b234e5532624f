"""Render an episode of a policy as a film."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rkhs_ros.base.validation import require, truncated
from rkhs_ros.pictures.headless import choose_renderer, remedy
from rkhs_ros.pictures.style import pixels
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.storage import Task
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.rollouts.visualization import DrawsItself

Pictures = NDArray[np.uint8]  # RGB, shape (height, width, 3), or several of them
FEWEST, MOST, USUAL = 2, 200, 60  # frames of a film
SIZE, DPI = (4.8, 3.6), 100  # inches, of a drawn frame


@dataclass(frozen=True)
class Film:
    """The frames of an episode.

    Attributes:
        pictures: frames by the name of the camera ("" for a single one), RGB, shape (frames, height, width, 3).
        captions: the time or step of each frame.
    """

    pictures: dict[str, Pictures]
    captions: list[str]


def shoot(policy: GaussianPolicy, task: Task, runner: InlineRunner, *, seed: int = 0, frames: int = USUAL) -> Film:
    """Run an episode of a policy without exploration noise and render it.

    Args:
        policy: policy to run.
        task: task to run it on.
        runner: runner of that task.
        seed: seed of all randomness.
        frames: number of frames, spread evenly over the episode; at most one per step.

    Raises:
        ValueError: a number is out of range, or the environment cannot be rendered.
    """
    require(FEWEST <= frames <= MOST, "frames", f"{FEWEST} to {MOST}", frames)
    batch, simulation = Batch(seed, 0, 1, task.horizon, explore=False), runner.simulation
    simulation.start(batch)
    if hasattr(simulation.shown, "render_frames"):
        return _watched(policy, batch, simulation, frames)
    own = isinstance(simulation.shown, DrawsItself)
    look, drawing = (_drawn, nullcontext(simulation)) if own else (_rendered, _with_pictures(task, simulation))
    with drawing as drawn:
        steps = spread(int(runner.collect(policy, batch).mask[0].sum()), frames)
        pictures = np.array(list(_moments(policy, batch, drawn, steps, look)))
    return Film({"": pictures}, [f"step {step}" for step in steps])


def spread(length: int, count: int) -> list[int]:
    """Return up to `count` indices below `length`, evenly spaced from the first to the last."""
    return [int(k) for k in np.linspace(0, length - 1, min(count, length)).round()]


def _watched(policy: GaussianPolicy, batch: Batch, simulation: Simulation, frames: int) -> Film:
    """Render a one-step task, whose action makes a whole motion, with the cameras of the task."""
    task: Any = simulation.shown
    actions = Acting(policy, batch, explore=False)(0, simulation.start(batch).observations)
    simulation.step(actions)
    motion = simulation.joint_states()
    every, period = (1, 0.0) if motion is None else (-(-len(motion.positions) // frames), motion.period)
    change = task.change(actions[0])
    pictures = task.render_frames(task.states[0], change, every=every)  # raises if the action makes no motion
    count = len(next(iter(pictures.values())))
    return Film(pictures, [f"{frame * every * period:.1f} s" for frame in range(count)])


def _moments(
    policy: GaussianPolicy,
    batch: Batch,
    simulation: Simulation,
    steps: list[int],
    look: Callable[[Simulation, Array], Pictures],
) -> Iterator[Pictures]:
    """Yield a frame before each of the given steps of the episode."""
    acting = Acting(policy, batch, explore=False)
    frame = simulation.start(batch)
    for step in range(steps[-1] + 1):
        actions = acting(step, frame.observations)
        if step in steps:
            yield look(simulation, simulation.spaces.clip(actions)[0])
        frame = simulation.step(actions)


def _drawn(simulation: Simulation, action: Array) -> Pictures:
    task: Any = simulation.shown
    figure = Figure(figsize=SIZE, dpi=DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    task.draw(axes, task.states[0], action)
    return pixels(figure)


def _with_pictures(task: Task, simulation: Simulation) -> closing[Simulation]:
    """Return a simulation of the environment with a render mode, as a context manager that closes it."""
    modes = simulation.shown.metadata.get("render_modes") or []
    what = "an environment with render mode rgb_array"
    require("rgb_array" in modes, task.environment, what, f"one with {', '.join(modes) or 'no render mode'}")
    choose_renderer()
    with _rendering_errors(task.environment):
        return closing(Simulation(task.environment, {**task.options, "render_mode": "rgb_array"}))


def _rendered(simulation: Simulation, action: Array) -> Pictures:
    with _rendering_errors(simulation.environment), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about failed backends; the final error is reported in one line
        frame: Any = simulation.shown.render()
    return np.asarray(frame[0] if isinstance(frame, tuple | list) else frame, dtype=np.uint8)


@contextmanager
def _rendering_errors(environment: str) -> Iterator[None]:
    """Convert any error of an environment's rendering into a ValueError with a hint.

    Raises:
        ValueError: rendering failed; the message includes a remedy if one is known.
    """
    try:
        yield
    except (gymnasium.error.DependencyNotInstalled, ImportError) as error:
        got = f"{truncated(error)}{remedy()}"
        raise ValueError(f"{environment}: expected its renderer to be installed, got: {got}") from error
    except Exception as error:
        got = f"{type(error).__name__}: {truncated(error)}{remedy()}"
        raise ValueError(f"{environment}: expected a rendered frame, got {got}") from error
