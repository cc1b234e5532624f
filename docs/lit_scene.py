"""Draw bodies on a floor with shadows, with PyBullet's software renderer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pybullet
from matplotlib.colors import to_rgba
from numpy.typing import NDArray
from pybullet_utils.bullet_client import BulletClient

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.visualization import Body
from sim_nodes.pr2.cameras import FAR, FLOOR_COLOUR, LIGHT, NEAR, TINY_RENDERER, Camera

UP = (0.0, 0.0, 1.0)
LIGHT_DISTANCE = 4.0  # m; shadows need a light nearby
FLOOR = (1.5, 1.5, 0.01)  # half of its size in m; the renderer shades what the light does not reach


class LitScene:
    """A floor at height 0 with bodies on it, as one camera sees them.

    Owns a PyBullet client.

    Args:
        camera: camera of all pictures.
        size: width and height of a picture in pixels.
    """

    def __init__(self, camera: Camera, size: tuple[int, int]) -> None:
        self.client: Any = BulletClient(pybullet.DIRECT)
        self.size = size
        floor = self.client.createVisualShape(self.client.GEOM_BOX, halfExtents=FLOOR, rgbaColor=FLOOR_COLOUR)
        self.client.createMultiBody(baseMass=0.0, baseVisualShapeIndex=floor, basePosition=(0.0, 0.0, -FLOOR[2]))
        self._view = self.client.computeViewMatrix(camera.place, camera.target, UP)
        self._lens = self.client.computeProjectionMatrixFOV(camera.view, size[0] / size[1], NEAR, FAR)
        self._projection = np.reshape(self._lens, (4, 4)).T @ np.reshape(self._view, (4, 4)).T

    def add(self, body: Body) -> int:
        """Add a body at the origin and return its number."""
        x, y, z = body.size
        kinds: dict[str, dict[str, Any]] = {
            "box": {"shapeType": self.client.GEOM_BOX, "halfExtents": (x / 2, y / 2, z / 2)},
            "ball": {"shapeType": self.client.GEOM_SPHERE, "radius": x / 2},
            "cylinder": {"shapeType": self.client.GEOM_CYLINDER, "radius": x / 2, "length": z},
        }
        shape = self.client.createVisualShape(**kinds[body.shape], rgbaColor=to_rgba(body.colour))
        return int(self.client.createMultiBody(baseMass=0.0, baseVisualShapeIndex=shape))

    def move(self, number: int, position: Array, orientation: Array) -> None:
        """Move a body to a position in metres and an orientation w, x, y, z."""
        self.client.resetBasePositionAndOrientation(number, position.tolist(), np.roll(orientation, -1).tolist())

    def picture(self) -> NDArray[np.uint8]:
        """Return the RGB picture of the bodies where they are now, shape (height, width, 3)."""
        light = {"lightDirection": LIGHT, "lightDistance": LIGHT_DISTANCE, "shadow": 1}
        _, _, pixels, _, _ = self.client.getCameraImage(
            *self.size, self._view, self._lens, **light, renderer=TINY_RENDERER
        )
        return np.reshape(pixels, (self.size[1], self.size[0], 4)).astype(np.uint8)[:, :, :3]

    def pixel(self, point: Array) -> tuple[float, float]:
        """Return the column and the row of the picture at which a point in metres appears."""
        x, y, _, depth = self._projection @ [*point, 1.0]
        return (1 + x / depth) / 2 * self.size[0], (1 - y / depth) / 2 * self.size[1]
