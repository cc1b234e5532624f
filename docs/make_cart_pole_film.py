"""Make the film of a cart-pole before and after 8 episodes of config/cart_pole_nac.yaml."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
from make_pictures import CONFIGS, HERE
from matplotlib.figure import Figure
from pendulum_scene import chart_of
from side_by_side_film import DPI, PICTURE_SIZE, Moment, Scene, frames, write_gif

from rkhs_ros.app.inline import iterations, runner_of
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.style import COLOURS, pixels
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config, load_config

EPISODES = 8


def main() -> None:
    """Write cart_pole_learns.gif beside this file."""
    config = load_config(CONFIGS / "cart_pole_nac.yaml")
    first, *_ = done = list(islice(iterations(config), EPISODES))
    last = done[-1]
    nearest = int(np.argmin(np.abs(last.evaluation_returns - last.evaluation_return)))
    scenes = [
        _scene(config, "first episode: random exploration", COLOURS[1], first.exploration, 0),
        _scene(config, f"after {EPISODES} episodes of 3 s", COLOURS[0], last.evaluation, nearest),
    ]
    write_gif(HERE / "cart_pole_learns.gif", list(frames(scenes, chart_of(config))))


def _scene(config: Config, title: str, colour: str, episodes: Episodes, index: int) -> Scene:
    """Return the scene of one of several episodes, with the mean of their returns so far."""
    runner = runner_of(config.environment)
    task: Any = runner.simulation.shown
    states, actions = task.states_of(episodes.observations[index]), runner.spaces.clip(episodes.actions[index])
    discounts = config.training.discount ** np.arange(config.training.horizon)
    returns = np.cumsum(discounts * episodes.rewards.mean(axis=0))
    return Scene(title, colour, lambda step: _moment(task, states[step], actions[step]), returns)


def _moment(task: Any, state: Array, action: Array) -> Moment:
    """Return the drawing of a step."""
    width, height = PICTURE_SIZE
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    task.draw(axes, state, action)
    return Moment(pixels(figure), (), "")


if __name__ == "__main__":
    main()
