"""Draw the frames of the film of the pendulum."""

from __future__ import annotations

from typing import Any

import numpy as np
from lit_scene import LitScene
from side_by_side_film import PICTURE_SIZE, Chart, Label, Moment, Scene

from rkhs_ros.app.inline import runner_of
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.known import references
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config
from sim_nodes.envs.vector_task import BLUE, DARK, Body
from sim_nodes.pr2.cameras import Camera

HEIGHT = 1.35  # m, of the bearing above the floor
CAMERA = Camera((0.9, -4.3, 2.1), (0.0, 0.0, 1.25), 42.0)
STAND = Body("box", (0.16, 0.1, HEIGHT), "#8C8C94")
BEHIND = 0.2  # m from the pendulum's plane to the stand
WEIGHT, BEARING, TARGET = 1, 2, 3  # of the task's bodies
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
BEYOND = 26.0  # pixels from the weight to its label, away from the bearing


def scene_of(config: Config, title: str, colour: str, episodes: Episodes, index: int, rewards: Array) -> Scene:
    """Return the scene of one of several episodes, with the returns that follow from rewards of shape (H,)."""
    discounts = config.training.discount ** np.arange(config.training.horizon)
    runner = runner_of(config.environment)
    actions = runner.spaces.clip(episodes.actions[index])
    task: Any = runner.simulation.shown
    stage = _Stage(task, episodes.observations[index], actions)
    return Scene(title, colour, stage.moment, np.cumsum(discounts * rewards))


def chart_of(config: Config) -> Chart:
    """Return the plot of the returns so far, with a line at the best known return."""
    name, best = max(references(config.task).items(), key=lambda item: item[1])
    return Chart("step", "return so far", 1.0, best * 1.15, best, f"{name.partition(' (')[0]} {best:g}")


class _Stage:
    """An episode of the pendulum in a scene.

    Args:
        task: the pendulum.
        observations: before each step, shape (H, 2).
        actions: torques, clipped, shape (H, 1).
    """

    def __init__(self, task: Any, observations: Array, actions: Array) -> None:
        self._scene = LitScene(CAMERA, PICTURE_SIZE)
        self._scene.move(self._scene.add(STAND), np.array([0.0, BEHIND, HEIGHT / 2]), UPRIGHT)
        self._bodies = [self._scene.add(body) for body in task.bodies()]
        self._trajectories, self._actions = task.motion(observations, actions), actions

    def moment(self, step: int) -> Moment:
        """Return the picture of a step with its labels and the torque."""
        places = self._trajectories.positions[step] + [0.0, 0.0, HEIGHT]
        for body, place, turn in zip(self._bodies, places, self._trajectories.orientations[step], strict=True):
            self._scene.move(body, place, turn)
        bearing, weight = (np.array(self._scene.pixel(places[k])) for k in (BEARING, WEIGHT))
        away = BEYOND * (weight - bearing) / np.linalg.norm(weight - bearing)
        target = self._scene.pixel(places[TARGET] + [0.0, 0.0, 0.5])
        labels = (
            Label("pendulum", BLUE, (float(weight[0]), float(weight[1])), (1.6 * float(away[0]), float(away[1]))),
            Label("target", DARK, target, (70.0, 0.0)),
        )
        return Moment(self._scene.picture(), labels, f"torque {self._actions[step, 0]:+.2f}".replace("-", "\u2212"))
