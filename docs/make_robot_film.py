"""Make the film of a motor pendulum that learns by the wall clock: `python docs/make_robot_film.py RUN`.

RUN is the folder of a run of config/robot_pendulum.yaml after `rkhs evaluate RUN`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from pendulum_scene import chart_of, scene_of
from side_by_side_film import Scene, frames, write_gif

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.style import COLOURS
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.episode_files import load_episodes

HERE = Path(__file__).parent
SIMULATED = HERE.parent / "config" / "pendulum_model_nac.yaml"  # the same task in simulation, used to draw it


def main() -> None:
    """Write robot_pendulum.gif beside this file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    run = parser.parse_args().run
    config = load_config(SIMULATED)
    first = read_recording(run).exploration(1)
    scenes = [
        _scene(config, "first episode: random exploration", COLOURS[1], first),
        _scene(config, "after ten episodes", COLOURS[0], load_episodes(run / "evaluation.npz").episodes),
    ]
    write_gif(HERE / "robot_pendulum.gif", list(frames(scenes, chart_of(config))))


def _scene(config: Config, title: str, colour: str, episodes: Episodes) -> Scene:
    """Return the first of several episodes as a scene."""
    return scene_of(config, title, colour, episodes, 0, episodes.rewards[0])


if __name__ == "__main__":
    main()
