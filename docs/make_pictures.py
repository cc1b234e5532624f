"""Make the pictures of the README and docs/start.md: two episodes of the demo, and curve and policy of a run."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from pendulum_scene import chart_of, scene_of
from side_by_side_film import Scene, frames, write_gif

from rkhs_ros.app.inline import iterations, runner_of
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.pictures.style import COLOURS
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.run import run_training

HERE = Path(__file__).parent
CONFIGS = HERE.parent / "config"
DEMO, FIRST_RUN = CONFIGS / "pendulum_wrap_model_nac.yaml", CONFIGS / "pendulum_nac.yaml"


def main() -> None:
    """Write pendulum_learns.gif, pendulum_curve.png and pendulum_policy.png beside this file."""
    config = load_config(DEMO)
    write_gif(HERE / "pendulum_learns.gif", list(frames(_scenes(config), chart_of(config))))
    config = load_config(FIRST_RUN)
    with tempfile.TemporaryDirectory() as folder:
        run_training(config, runner_of(config.environment), Path(folder), quiet=True)
        for picture in draw_run(Path(folder)):
            (HERE / f"pendulum_{picture.name}").write_bytes(picture.read_bytes())


def _scenes(config: Config) -> list[Scene]:
    """Return scenes of the first real episode and of the evaluation episode nearest to their mean return."""
    first = next(iterations(config))
    nearest = int(np.argmin(np.abs(first.evaluation_returns - first.evaluation_return)))
    return [
        scene_of(config, title, colour, e, index, e.rewards.mean(axis=0))
        for title, colour, e, index in (
            ("first episode: random exploration", COLOURS[1], first.exploration, 0),
            ("after model-based training on it", COLOURS[0], first.evaluation, nearest),
        )
    ]


if __name__ == "__main__":
    main()
