"""Environments that fail from some step on, until they are repaired; an option selects the kind of failure."""

import ctypes
import os
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

EPISODE = 20  # steps
GOOD_STEPS = 90  # per environment: four batches, enough for two iterations, and ten steps of the fifth
MENDED = Path("mended")  # exists after the repair
CRASHED = Path("crashed")  # exists after the first crash of the process; from then on it crashes every time


class Bad(gymnasium.Env[np.ndarray, np.ndarray]):
    """A point on a line that fails after some steps."""

    observation_space, action_space = Box(-9.0, 9.0, (2,)), Box(-1.0, 1.0, (1,))

    def __init__(self, fault: str = "") -> None:
        self.fault = fault
        self.steps = 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self.x = float(self.np_random.uniform(-1, 1))
        if self.fault == "raise in reset" and self.is_bad(EPISODE):
            raise RuntimeError("there is no way back")
        return self.seen(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        self.x = float(np.clip(self.x + 0.3 * action[0], -2, 2))
        reward = -(self.x**2)
        if self.is_bad():
            reward = self.misbehave(reward)
        return self.seen(), reward, False, False, {}

    def misbehave(self, reward: float) -> float:
        if self.fault in ("os._exit", "segmentation fault", "hang"):
            CRASHED.touch()
        match self.fault:
            case "nan observation":
                self.x = np.nan
            case "hang":
                time.sleep(60)
            case "sys.exit":
                sys.exit(3)
            case "os._exit":
                os._exit(3)
            case "os._exit like a node":
                os._exit(1)
            case "segmentation fault":
                ctypes.string_at(0)
        return np.nan if self.fault == "nan reward" else reward

    def seen(self) -> np.ndarray:
        numbers = 3 if self.fault == "wrong shape" and self.is_bad() else 2
        return np.array([self.x, 1.0, 0.0][:numbers], np.float32)

    def is_bad(self, steps: int = 0) -> bool:
        """Return whether the environment fails within a number of steps."""
        return self.steps + steps > (5 if CRASHED.exists() else GOOD_STEPS) and not MENDED.exists()


gymnasium.register("Bad-v0", Bad, max_episode_steps=EPISODE)
