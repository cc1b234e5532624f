"""What `make demo` does: one real episode over topics, model-based training learnt from it, and what came of that."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import sim_nodes.envs  # noqa: F401  # registers the task
from rkhs_ros.pictures.known import references
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.report import new_folder

CONFIG = Path(__file__).parents[1] / "config" / "pendulum_wrap_model_nac.yaml"
# Of config/pendulum_wrap_few_nac.yaml, medians of docs/results/configurations.csv.
WITHOUT = "15 episodes to a return of 45, 25 to 50"
SOURCE = "docs/configurations.md"


def main() -> int:
    """Learn, tell, and return the exit code."""
    folder = new_folder(None, "demo")
    train = ["rkhs", "train", str(CONFIG), "--iterations", "1", "--out", str(folder)]
    code = subprocess.run(train, check=False).returncode
    if code == 0:
        print(told(folder), flush=True)
    return code


def told(folder: Path) -> str:
    """Return in three lines what came of the run in a folder."""
    task = load_config(CONFIG).task
    (row,) = Curve(folder / "curve.csv").rows()
    best = max(references(task).values())
    return (
        f"\nOne exploring episode ({task.horizon} steps) earned {row.exploration_return:.1f}.\n"
        f"After model-based training learnt from it the evaluation return is {row.evaluation_return:.1f} "
        f"(optimum {best:g}).\n"
        f"Without a model the same task takes {WITHOUT} (medians, {SOURCE}): make demo-long"
    )


if __name__ == "__main__":
    sys.exit(main())
