"""Learn a pendulum swing-up from three episodes over ROS topics, and print the returns: `make demo`."""

import shlex
import subprocess
import sys
from pathlib import Path

import sim_nodes.envs  # noqa: F401  # registers the task
from rkhs_ros.pictures.known import references
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.report import new_folder

CONFIG = Path(__file__).parents[1] / "config" / "pendulum_wrap_model_nac.yaml"
EPISODES = 3
TRAIN = ["rkhs", "train", str(CONFIG), "--iterations", str(EPISODES)]
# Medians of config/pendulum_wrap_few_nac.yaml in docs/results/configurations.csv.
WITHOUT_A_MODEL = {45: 15, 50: 25}  # return: episodes
INTRODUCTION = f"""\
rkhs_ros demo: swing up a pendulum. Three ROS 2 nodes (simulator, policy, learner) run {EPISODES} real episodes. After
each of them, the learner fits a dynamics model and trains the policy in it, which takes some seconds.
$ {shlex.join([*TRAIN[:2], f"config/{CONFIG.name}", *TRAIN[3:]])}
"""


def main() -> int:
    """Train, print the summary, and return the exit code."""
    print(INTRODUCTION, flush=True)
    folder = new_folder(None, "demo")
    code = subprocess.run([*TRAIN, "--out", str(folder)], stdout=subprocess.DEVNULL, check=False).returncode
    if code == 0:
        print(summary(folder), flush=True)
    return code


def summary(folder: Path) -> str:
    """Return the results of the run in a folder, with the next steps."""
    task = load_config(CONFIG).task
    first, *others = Curve(folder / "curve.csv").rows()
    (low, few), (high, many) = WITHOUT_A_MODEL.items()
    return f"""
Discounted return:
  {first.exploration_return:5.1f}  in the first real episode: {task.horizon} steps of random exploration
  {first.evaluation_return:5.1f}  after model-based training on that episode
  {others[-1].evaluation_return:5.1f}  after {EPISODES} episodes
  {max(references(task).values()):5.1f}  at the optimum

Without a model, the same task takes {few} real episodes to reach {low}, and {many} to reach {high}
(medians over 20 seeds, see docs/configurations.md). To compare: rkhs train config/pendulum_wrap_few_nac.yaml

Pictures: {folder}/curve.png (returns) and {folder}/policy.png (the policy's actions, and episodes)

Next: enter the environment, film an episode of the policy, and read docs/start.md.
  . ./setup.bash
  rkhs render {folder}"""


if __name__ == "__main__":
    sys.exit(main())
