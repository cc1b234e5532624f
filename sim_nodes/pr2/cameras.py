"""Camera images of an episode, rendered in software."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_nodes.pr2.robot import Vector


class Camera(NamedTuple):
    """A camera: its position and target in metres, and its vertical field of view in degrees."""

    place: Vector
    target: Vector
    view: float


CAMERAS = {
    "room": Camera((-0.5, -1.5, 1.55), (0.38, -0.1, 0.9), 55.0),
    "hand": Camera((0.45, -0.75, 1.25), (0.80, -0.20, 0.95), 42.0),
}
NEAR, FAR = 0.05, 10.0  # m
LIGHT = (-2.0, -2.0, 4.0)
TINY_RENDERER = 1 << 16  # PyBullet's software renderer
FLOOR_SIZE, FLOOR_COLOUR = (4.0, 4.0, 0.01), (0.80, 0.78, 0.74, 1.0)  # m (half extents), RGBA


def add_floor(client: Any) -> None:
    """Add a visible floor without contacts, so that the physics do not change."""
    shape = client.createVisualShape(client.GEOM_BOX, halfExtents=FLOOR_SIZE, rgbaColor=FLOOR_COLOUR)
    client.createMultiBody(baseMass=0.0, baseVisualShapeIndex=shape, basePosition=(0.0, 0.0, -FLOOR_SIZE[2]))


class Film:
    """Takes an image with every camera once per `every` calls.

    Owns the images.

    Args:
        size: width and height of an image.
        every: calls between images.
    """

    def __init__(self, size: tuple[int, int], every: int) -> None:
        self.size = size
        self.every = every
        self._calls = 0
        self._taken: dict[str, list[NDArray[np.uint8]]] = {name: [] for name in CAMERAS}

    def __call__(self, client: Any) -> None:
        """Take the images of the current state, if they are due."""
        if self._calls % self.every == 0:
            for name, camera in CAMERAS.items():
                self._taken[name].append(picture(client, camera, self.size))
        self._calls += 1

    def frames(self) -> dict[str, NDArray[np.uint8]]:
        """Return the images of each camera, shape (frames, height, width, 3)."""
        return {name: np.array(pictures) for name, pictures in self._taken.items()}


def picture(client: Any, camera: Camera, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the RGB image of a camera, shape (height, width, 3)."""
    width, height = size
    view = client.computeViewMatrix(camera.place, camera.target, (0.0, 0.0, 1.0))
    lens = client.computeProjectionMatrixFOV(camera.view, width / height, NEAR, FAR)
    _, _, pixels, _, _ = client.getCameraImage(
        width, height, view, lens, lightDirection=LIGHT, shadow=1, renderer=TINY_RENDERER
    )
    return np.reshape(pixels, (height, width, 4)).astype(np.uint8)[:, :, :3]
