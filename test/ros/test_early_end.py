"""Episodes that end before the horizon, over topics."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rkhs_ros.recordings.recording import read_recording

Start = Callable[..., Any]

MODULE = """
import gymnasium, numpy as np, os
from gymnasium.spaces import Box

class Robot(gymnasium.Env):
    '''There is one robot, and an episode must end before the next one starts.'''
    observation_space, action_space = Box(-9.0, 9.0, (1,)), Box(-1.0, 1.0, (1,))
    going = False

    def __init__(self):
        os.close(os.open("taken", os.O_CREAT | os.O_EXCL))

    def close(self):
        os.remove("taken")

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if self.going:
            raise RuntimeError("reset during an episode")
        self.place, self.left, self.going = 0.0, int(self.np_random.integers(3, 9)), True
        return np.array([self.place], np.float32), {}

    def step(self, action):
        self.place, self.left = self.place + float(action[0]), self.left - 1
        self.going = self.left > 0
        return np.array([self.place], np.float32), -abs(self.place - 1.0), not self.going, False, {}

gymnasium.register("Robot-v0", Robot, max_episode_steps=20)
"""
CONFIG = """
simulator: {ros__parameters: {environment: {id: "one_robot:Robot-v0"}}}
learner:
  ros__parameters:
    {iterations: 2, episodes_per_iteration: 4, evaluation_episodes: 2, horizon: 20, model: {form: none}}
"""


def test_one_robot_learns_over_topics_as_in_process(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("one_robot.py").write_text(MODULE)
    Path("robot.yaml").write_text(CONFIG)
    for name in ("inline", "ros"):
        run = start("rkhs", "train", "robot.yaml", "--runner", name, "--quiet", "--out", name)
        code, out, err = run.finish()
        assert code == 0, err
        assert not Path("taken").exists()
        assert out.startswith("Trained on one_robot:Robot-v0 for 8 episodes")
    lines = [Path(name, "curve.csv").read_text().splitlines() for name in ("inline", "ros")]
    without_seconds = [[line.rpartition(",")[0] for line in curve] for curve in lines]
    assert without_seconds[0] == without_seconds[1]
    assert len(without_seconds[0]) == 3
    for file in ("policy.npz", "best_policy.npz"):
        assert Path("inline", file).read_bytes() == Path("ros", file).read_bytes()
    episodes = read_recording(Path("ros")).last_episodes()
    assert episodes.terminated.all()
    assert (episodes.mask.sum(axis=1) < 9).all()
    assert np.isfinite(episodes.final_observations).all()
