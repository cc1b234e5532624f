"""Make the film of an arm that learns to follow a mark: `python docs/make_arm_film.py RUN`.

RUN is the folder of a run of config/robot_arm.yaml after `rkhs evaluate RUN`. An observation contains no joint
positions: the film shows those at which the tool is where it was sensed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from lit_scene import LitScene
from scipy.optimize import least_squares
from side_by_side_film import PICTURE_SIZE, Chart, Label, Moment, Scene, frames, write_gif

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.style import COLOURS
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.episode_files import load_episodes
from sim_nodes.envs.vector_task import DARK, ORANGE, Body
from sim_nodes.pr2.cameras import Camera
from sim_nodes.robots.arm import CENTRE, HOME, distance
from sim_nodes.robots.arm_body import FILE, JOINTS, TOOL

HERE = Path(__file__).parent
CAMERA = Camera((1.75, -1.35, 1.0), (0.22, 0.0, 0.42), 36.0)
MARK = Body("ball", (0.07, 0.07, 0.07), ORANGE)
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
COMMANDED = [0, 1, 3]  # of the joints
PERIOD_S, FRAME_MS = 0.2, 150
CHART = Chart("time (s)", "distance from the mark (cm)", PERIOD_S, 40.0, 5.0, "aim 5 cm", " cm")


def main() -> None:
    """Write robot_arm.gif beside this file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    run = parser.parse_args().run
    first = read_recording(run).exploration(1)
    scenes = [
        _scene("first episode: random exploration", COLOURS[1], first),
        _scene("after twelve episodes", COLOURS[0], load_episodes(run / "evaluation.npz").episodes),
    ]
    write_gif(HERE / "robot_arm.gif", list(frames(scenes, CHART)), FRAME_MS)


def _scene(title: str, colour: str, episodes: Episodes) -> Scene:
    """Return the first of several episodes as a scene."""
    observations = episodes.observations[0]
    return Scene(title, colour, _Stage(observations).moment, 100.0 * distance(observations))


class _Stage:
    """An episode of the arm in a scene.

    Args:
        observations: y and z of the mark, then x, y and z of the tool, in metres, shape (H, 5).
    """

    def __init__(self, observations: Array) -> None:
        self._scene, self._observations = LitScene(CAMERA, PICTURE_SIZE), observations
        self._mark = self._scene.add(MARK)
        client = self._scene.client
        self._arm = client.loadURDF(str(FILE), useFixedBase=True)
        infos = [client.getJointInfo(self._arm, k) for k in range(client.getNumJoints(self._arm))]
        self._joints = [next(k for k, info in enumerate(infos) if info[1].decode() == joint) for joint in JOINTS]
        self._tool = next(k for k, info in enumerate(infos) if info[12].decode() == TOOL)

    def moment(self, step: int) -> Moment:
        """Return the picture of a step with its labels and the distance."""
        mark, tool = np.array([CENTRE[0], *self._observations[step, :2]]), self._observations[step, 2:]
        self._scene.move(self._mark, mark, UPRIGHT)
        solved = least_squares(lambda angles: self._tool_at(angles) - tool, HOME[COMMANDED], diff_step=1e-4)
        self._tool_at(solved.x)
        note = f"{100.0 * distance(self._observations[step]):.1f} cm from the mark"
        labels = (
            Label("mark", COLOURS[1], self._scene.pixel(mark), (55.0, 30.0)),
            Label("tool", DARK, self._scene.pixel(tool), (-60.0, 45.0)),
        )
        return Moment(self._scene.picture(), labels, note)

    def _tool_at(self, angles: Array) -> Array:
        """Move the commanded joints to angles, and return the position of the tool."""
        positions = HOME.copy()
        positions[COMMANDED] = angles
        for joint, angle in zip(self._joints, positions, strict=True):
            self._scene.client.resetJointState(self._arm, joint, angle)
        state = self._scene.client.getLinkState(self._arm, self._tool, computeForwardKinematics=True)
        return np.array(state[4])


if __name__ == "__main__":
    main()
