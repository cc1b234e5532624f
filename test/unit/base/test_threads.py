"""Linear algebra uses one thread while the package computes, and the threads of the process before and after that."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
IMPORTS = {"numpy first": "import numpy, scipy.linalg, rkhs_ros", "rkhs_ros first": "import rkhs_ros, scipy.linalg"}
SCRIPT = """
import os
import gymnasium, numpy
from threadpoolctl import threadpool_info
def threads(): return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}
rkhs_ros.RBF
class Watched(gymnasium.Env):
    observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.np_random.uniform(-1, 1, 2), {}
    def step(self, action):
        within.append(threads())
        return self.np_random.uniform(-1, 1, 2), 0.0, False, False, {}
within, between, environment = [], [threads()], dict(os.environ)
small = dict(iterations=2, episodes_per_iteration=1, evaluation_episodes=1, horizon=3, progress=False)
result = rkhs_ros.train(Watched, model="none", callback=lambda result: between.append(threads()), **small)
rkhs_ros.evaluate(result.policy, Watched, episodes=1)
between.append(threads())
one, other = rkhs_ros.base.processes.one_thread(), rkhs_ros.base.processes.one_thread()  # of two Python threads
one.__enter__(), other.__enter__(), one.__exit__(None, None, None)
within.append(threads())
other.__exit__(None, None, None)
between.append(threads())
print(within == [{1}] * len(within), len(within) > 10, between, dict(os.environ) == environment)
"""


@pytest.mark.parametrize(
    ("first", "variable"), [("numpy first", "OMP_NUM_THREADS"), ("rkhs_ros first", "OPENBLAS_NUM_THREADS")]
)
def test_training_and_evaluation_limit_the_threads_while_they_run(first: str, variable: str) -> None:
    inherited = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    environment = {**inherited, variable: "2", "PYTHONPATH": f"{ROOT}{os.pathsep}{inherited.get('PYTHONPATH', '')}"}
    command = [sys.executable, "-c", f"{IMPORTS[first]}{SCRIPT}"]
    shown = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert shown.stdout == "True True [{2}, {2}, {2}, {2}, {2}] True\n"
