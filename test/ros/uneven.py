"""An environment whose episodes differ in length, terminated or truncated."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box


class Uneven(gymnasium.Env[Any, Any]):
    """Lasts as many steps as was drawn; by the task if those are even, otherwise cut off."""

    observation_space: Any = Box(-100.0, 100.0, (3,), np.float32)
    action_space: Any = Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.lasts = self.left = int(self.np_random.integers(2, 9))
        return self.seen(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.left -= 1
        even = self.lasts % 2 == 0
        return self.seen(), float(action.sum()), not self.left and even, not self.left and not even, {}

    def seen(self) -> Any:
        return np.array([self.left, self.lasts, self.np_random.normal()], dtype=np.float32)


gymnasium.register("Uneven-v0", Uneven, max_episode_steps=7)
