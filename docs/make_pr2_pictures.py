"""Makes the pictures of docs/pr2.md, in some minutes: the PR2 before and after it learnt, and a map of its actions."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from rkhs_ros.app.inline import iterations, runner_of
from rkhs_ros.learning.state import first_state
from rkhs_ros.pictures.film import shoot
from rkhs_ros.pictures.film_files import draw_strip
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.runs.config import Config, load_config

HERE = Path(__file__).parent
CONFIG = HERE.parent / "config" / "pr2_door_power.yaml"
MAP = HERE.parent / "benchmarks" / "pr2_map.py"


def main() -> None:
    """Write pr2_before.png, pr2_after.png and pr2_map.png beside this file."""
    config = load_config(CONFIG)
    subprocess.run([sys.executable, MAP, "--out", HERE / "pr2_map.png"], check=True)
    _draw("before", first_state(config.training, runner_of(config.environment).spaces).policy, config)
    *_, last = iterations(config)
    _draw("after", last.policy, config)


def _draw(name: str, policy: GaussianPolicy, config: Config) -> None:
    draw_strip(HERE / f"pr2_{name}.png", shoot(policy, config.task, runner_of(config.environment)))


if __name__ == "__main__":
    main()
