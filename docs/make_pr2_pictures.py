"""Make the pictures of docs/pr2.md in some minutes: the PR2 before and after training, its attempts, and a map.

The robot is drawn with its meshes if the package example-robot-data is installed.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from rkhs_ros.app.inline import runner_of
from rkhs_ros.learning.state import first_state
from rkhs_ros.pictures.film import shoot
from rkhs_ros.pictures.film_files import animate, draw_strip
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.run import run_training

HERE = Path(__file__).parent
CONFIG = HERE.parent / "config" / "pr2_door_power.yaml"
FRAMES = 40  # of the film
MAP = HERE.parent / "benchmarks" / "pr2_map.py"


def main() -> None:
    """Write pr2_before.png, pr2_after.png, pr2_attempts.png, pr2_map.png and pr2_door.gif beside this file."""
    config = load_config(CONFIG)
    subprocess.run([sys.executable, MAP, "--out", HERE / "pr2_map.png"], check=True)
    _draw("before", first_state(config.training, runner_of(config.environment).spaces).policy, config)
    with tempfile.TemporaryDirectory() as name:
        folder = run_training(config, runner_of(config.environment), Path(name), quiet=True)
        _, attempts = draw_run(folder)
        (HERE / "pr2_attempts.png").write_bytes(attempts.read_bytes())
        policy = load_policy(folder / "policy.npz")[0]
        _draw("after", policy, config)
        animate(HERE / "pr2_door.gif", shoot(policy, config.task, runner_of(config.environment), frames=FRAMES))


def _draw(name: str, policy: GaussianPolicy, config: Config) -> None:
    draw_strip(HERE / f"pr2_{name}.png", shoot(policy, config.task, runner_of(config.environment)))


if __name__ == "__main__":
    main()
