"""The scene of a task: rigid bodies and their motion, and pictures of them by ray casting."""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Pixels = NDArray[np.uint8]
Corner = tuple[float, float, float]

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"  # distinguishable for colour-blind viewers
DARK, PALE = "#26262B", "#CCCCCC"
SIZE = (480, 360)  # width and height of a picture, pixels
TANGENT = 0.3  # of half the camera's vertical angle
ROOM = 1.06  # extent of the view, relative to its content
FINER = 2  # rays per pixel along each side
AMBIENT = 0.55  # part of the light that comes from everywhere
BACKGROUND = 255.0
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


class Body(NamedTuple):
    """A visible rigid body.

    Attributes:
        shape: "box", "ball" or "cylinder", whose axis is z.
        size: along x, y and z, in metres.
        colour: red, green and blue, such as "#0072B2".
    """

    shape: str
    size: Corner
    colour: str


class BodyTrajectories(NamedTuple):
    """Trajectories of bodies; z is up.

    Attributes:
        times: of each moment, in seconds, shape (k,).
        positions: of the centres, in metres, shape (k, bodies, 3).
        orientations: unit quaternions w, x, y, z, shape (k, bodies, 4).
    """

    times: Array
    positions: Array
    orientations: Array


def in_plane(along: Array, depth: Array | float, heights: Array, turns: Array | float = 0.0) -> tuple[Array, Array]:
    """Return positions (k, bodies, 3) and orientations (k, bodies, 4) of bodies that turn about the y axis.

    The places are in metres, the turns, of the z axis towards the x axis, in radians; they broadcast to (k, bodies).
    """
    x, y, z, half = np.broadcast_arrays(along, depth, heights, 0.5 * np.asarray(turns))
    return np.stack([x, y, z], axis=-1), np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half], axis=-1)


def beads(count: int, size: float, last: float) -> list[Body]:
    """Return a row of small balls and a larger last one, which visualise an action; sizes in metres."""
    return [Body("ball", (each,) * 3, ORANGE) for each in [*[size] * (count - 1), last]]


def matrices(orientations: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of unit quaternions w, x, y, z of shape (..., 4)."""
    quaternions = np.roll(orientations, -1, axis=-1)  # scipy has w last
    return np.asarray(Rotation.from_quat(quaternions.reshape(-1, 4)).as_matrix().reshape(*quaternions.shape[:-1], 3, 3))


def quaternions(rotations: Array) -> Array:
    """Return unit quaternions w, x, y, z of rotation matrices, shape (..., 3, 3)."""
    turned = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat()
    return np.asarray(np.roll(turned, 1, axis=-1).reshape(*rotations.shape[:-2], 4))


class Camera:
    """A camera in front of a box, which fills the picture."""

    def __init__(self, direction: Corner, bounds: tuple[Corner, Corner], size: tuple[int, int] = SIZE) -> None:
        towards = np.array(direction) / np.linalg.norm(direction)
        right = np.cross((0.0, 0.0, 1.0), towards)
        right /= np.linalg.norm(right)
        self.axes = np.stack([right, np.cross(towards, right), towards])  # to the right, up, towards the camera
        low, high = np.array(bounds)
        across, up, near = (0.5 * (high - low) * CORNERS @ self.axes.T).T
        extents = ROOM * np.maximum(np.abs(across) * size[1] / size[0], np.abs(up))
        self.place = (low + high) / 2 + np.max(extents / TANGENT + near) * towards
        self.size = size
        self._rays = FINER * size[0], FINER * size[1]
        light = np.array([-0.4, 0.7, 1.0]) @ self.axes  # behind the camera, above it and to its left
        self._towards_light = light / np.linalg.norm(light)

    def picture(self, bodies: list[Body], positions: Array, orientations: Array) -> Pixels:
        """Return the RGB picture of bodies, shape (height, width, 3)."""
        width, height = self._rays
        depth, colours = np.full((height, width), np.inf), np.full((height, width, 3), BACKGROUND)
        for body, centre, turn in zip(bodies, positions, matrices(orientations), strict=True):
            half = np.array(body.size) / 2
            window = self._window(centre + (half * CORNERS) @ turn.T)
            rays = self._directions(window)
            distance, normal = _hit(body.shape, (self.place - centre) @ turn / half, rays @ turn / half)
            normal = (np.nan_to_num(normal) / half) @ turn.T
            normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
            light = AMBIENT + (1 - AMBIENT) * np.maximum(normal @ self._towards_light, 0.0)
            nearer = distance < depth[window]
            paint = np.array(list(bytes.fromhex(body.colour.removeprefix("#"))))
            depth[window] = np.where(nearer, distance, depth[window])
            colours[window] = np.where(nearer[..., None], light[..., None] * paint, colours[window])
        fine = colours.reshape(self.size[1], FINER, self.size[0], FINER, 3)
        return np.asarray(fine.mean(axis=(1, 3)).round().astype(np.uint8))

    def _seen(self, points: Array) -> Array:
        """Return the columns and rows of the rays through points of shape (k, 3)."""
        across, up, towards = ((points - self.place) @ self.axes.T).T
        width, height = self._rays
        scale = height / 2 / TANGENT / np.maximum(-towards, 1e-6)
        return np.stack([width / 2 + scale * across, height / 2 - scale * up], axis=1)

    def _window(self, corners: Array) -> tuple[slice, slice]:
        """Return the rows and columns of the rays that may hit a body within corners."""
        seen = self._seen(corners)
        low = np.clip(np.floor(seen.min(axis=0)), 0, self._rays).astype(int)
        high = np.clip(np.ceil(seen.max(axis=0)), 0, self._rays).astype(int)
        return slice(low[1], high[1]), slice(low[0], high[0])

    def _directions(self, window: tuple[slice, slice]) -> Array:
        """Return the directions of rays, shape (rows, columns, 3), which advance by 1 away from the camera."""
        width, height = self._rays
        up = 1.0 - (np.arange(window[0].start, window[0].stop) + 0.5) * 2 / height
        across = (np.arange(window[1].start, window[1].stop) + 0.5) * 2 / height - width / height
        ways = np.stack(np.broadcast_arrays(TANGENT * across, TANGENT * up[:, None], -1.0), axis=-1)
        return np.asarray(ways @ self.axes)


@np.errstate(divide="ignore", invalid="ignore")  # of rays along a side, and of those that miss
def _hit(shape: str, origin: Array, rays: Array) -> tuple[Array, Array]:
    """Return the distances at which rays hit a shape, infinite for a miss, and the normals there."""
    if shape == "ball":
        enter, leave = _within_circle(origin, rays)
        return _misses(enter, leave), origin + enter[..., None] * rays
    slabs = np.stack([(-1.0 - origin) / rays, (1.0 - origin) / rays])
    enters, leaves = slabs.min(axis=0), slabs.max(axis=0)
    sides = -np.sign(rays)
    if shape == "box":
        enter = np.nanmax(enters, axis=-1)
        return _misses(enter, np.nanmin(leaves, axis=-1)), sides * (enters == enter[..., None])
    begin, end = _within_circle(origin[:2], rays[..., :2])
    enter = np.maximum(begin, enters[..., 2])
    normal = (origin + enter[..., None] * rays) * (1.0, 1.0, 0.0)
    normal[enters[..., 2] > begin] = (0.0, 0.0, 1.0)
    normal[..., 2] *= sides[..., 2]
    return _misses(enter, np.minimum(end, leaves[..., 2])), normal


def _within_circle(origin: Array, rays: Array) -> tuple[Array, Array]:
    """Return the distances at which rays enter and leave the unit circle or ball, NaN for a miss."""
    a, b = np.sum(rays**2, axis=-1), rays @ origin
    root = np.sqrt(b**2 - a * (origin @ origin - 1.0))
    return (-b - root) / a, (-b + root) / a


def _misses(enter: Array, leave: Array) -> Array:
    """Return the distances of entry where rays enter before they leave, in front of the camera; infinity elsewhere."""
    return np.where((enter < leave) & (enter > 0.0), enter, np.inf)
