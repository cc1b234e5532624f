"""Arrange the page's 3D scene: the moving task, with the policy plot beside it."""

from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from viser import SceneApi, ViserServer
from viser.transforms import SO3

from rkhs_ros.pictures.known import Body, BodyTrajectories, ShowsBodies
from rkhs_ros.pictures.style import pixels
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.view.bodies import Surface

SIZE, DPI = (4.2, 4.9), 180  # of the policy plot, in inches
VERTICAL_ANGLE = 0.7  # rad, of the camera
UP = (0.0, 0.0, 1.0)
ASPECT = 1.0  # of the view until a browser reports its own
SAME_ASPECT = 0.02  # greatest difference that does not move the camera
ROOM = 1.04  # extent of the view, relative to its content
GAP = 0.1  # between task and picture, relative to the picture's height
LARGER = 1.6  # height of a picture beside the task, relative to the task's height
WIDE = 1.6  # width to height of a task from which the picture is above it, not beside it
MARKER = 0.011  # radius of the marker on the picture, relative to the picture's width
MARK = (0, 230, 115)
CELLS_ACROSS = 12  # of the floor's grid, about
FLOOR_EXTENT = 1.5  # relative to the task's


class Stage:
    """The 3D scene of a page: the bodies of a task, a policy plot, and a marker at the current step on the plot.

    Owns the objects of the scene. If the task has depth, its bodies stand on a floor with a grid.
    """

    def __init__(self, server: ViserServer, task: ShowsBodies, *, has_depth: bool) -> None:
        self._server = server
        self._eye = np.array(task.view_direction) / np.linalg.norm(task.view_direction)
        self._right = np.cross(-self._eye, (0.0, 0.0, 1.0))
        self._right /= np.linalg.norm(self._right)
        self._up = np.cross(self._right, -self._eye)
        self._bodies = task.bodies()
        self._light(server.scene)
        self._handles = [_added(server.scene, f"/task/{i}", body) for i, body in enumerate(self._bodies)]
        low, high = np.array(task.bounds)
        self._arrange(low, high)
        if has_depth:
            self._lay_floor(low, high)
        self._backdrop: Any = None
        self._picture: Any = None
        self._mark: Any = None
        self._points: Array = np.zeros((0, 2))

    def _light(self, scene: SceneApi) -> None:
        """Light the scene from above and from the viewer; without a GPU, shadows and reflections take minutes."""
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map(hdri=None)
        scene.add_light_ambient("/light/everywhere", intensity=1.2)
        for name, place, intensity in (("above", (0.0, 0.0, 1.0), 0.8), ("eye", self._eye + 0.5 * self._right, 1.6)):
            scene.add_light_directional(f"/light/{name}", intensity=intensity, position=tuple(place))

    def _arrange(self, low: Array, high: Array) -> None:
        """Place the picture and the camera for a task whose bounding box has the corners ``low`` and ``high``."""
        corners = np.array(list(product(*zip(low, high, strict=True))))
        across, up, depth = corners @ self._right, corners @ self._up, float((low + high) @ self._eye) / 2
        begin, end = np.array([across.min(), up.min()]), np.array([across.max(), up.max()])
        task, shape = end - begin, np.array([SIZE[0] / SIZE[1], 1.0])
        self._task_size, self._task_middle = task, self._in_space((begin + end) / 2, depth)
        is_wide = task[0] > WIDE * task[1]
        board = shape * (task[0] / shape[0] if is_wide else LARGER * task[1])
        way = np.array([0.0, 1.0] if is_wide else [1.0, 0.0])  # to the picture
        distance = way @ (task / 2 + GAP * board[1] + board / 2)
        self._board = board
        self._middle = self._in_space((begin + end) / 2 + distance * way, depth)
        whole = np.where(way > 0, task + GAP * board[1] + board, np.maximum(task, board))
        seen = (begin + end) / 2 + (distance + way @ (board - task) / 2) / 2 * way
        self._aim_cameras(self._in_space(seen, depth), whole)

    def _lay_floor(self, low: Array, high: Array) -> None:
        """Draw a grid below a task whose bounding box has the corners ``low`` and ``high``."""
        extent = FLOOR_EXTENT * float((high - low).max())
        cell = _round(extent / CELLS_ACROSS)
        size, middle = cell * np.ceil(extent / cell), (low + high) / 2
        lines: Any = {"cell_size": cell, "section_size": 5 * cell, "shadow_opacity": 0.0}
        self._server.scene.add_grid("/floor", size, size, position=(middle[0], middle[1], low[2]), **lines)

    def set_picture(self, figure: Figure, points: Array) -> None:
        """Show a policy plot beside or above the task."""
        figure.set_dpi(DPI)
        image, axes = pixels(figure), figure.axes[0]
        ends = np.sort([axes.get_xlim(), axes.get_ylim()])
        self._points = axes.transData.transform(np.clip(points, *ends.T)) / [image.shape[1], image.shape[0]]
        if self._picture is not None:
            self._picture.image = image
            return
        scene, radius = self._server.scene, MARKER * self._board[0]
        self._picture = self._add_picture("/policy", image, self._board, self._middle)
        self._mark = scene.add_icosphere("/mark", radius, color=MARK, position=self._middle)

    def set_backdrop(self, image: NDArray[np.uint8]) -> None:
        """Show an image behind the bodies, as large as the task."""
        if self._backdrop is None:
            self._backdrop = self._add_picture("/backdrop", image, self._task_size, self._task_middle)
        else:
            self._backdrop.image = image

    def _add_picture(self, name: str, image: NDArray[np.uint8], size: Array, middle: Array) -> Any:
        # The axes of an image point right, down, and away from the viewer.
        turn = SO3.from_matrix(np.stack([self._right, -self._up, -self._eye], axis=1)).wxyz
        return self._server.scene.add_image(name, image, *size, format="png", wxyz=turn, position=middle)

    def show(self, motion: BodyTrajectories | None, frame: int, step: int) -> None:
        """Show a frame of the motion, which is None to hide the bodies, and mark a step of the episode."""
        with self._server.atomic():
            for i, handle in enumerate(self._handles):
                handle.visible = motion is not None
                if motion is not None:
                    handle.position, handle.wxyz = motion.positions[frame, i], motion.orientations[frame, i]
            if self._mark is not None and len(self._points):
                across, up = self._board * (self._points[min(step, len(self._points) - 1)] - 0.5)
                lift = MARKER * self._board[0] * self._eye
                self._mark.position = self._middle + across * self._right + up * self._up + lift

    def _in_space(self, place: Array, depth: float) -> Array:
        """Return the 3D point at a position (right, up) in the view plane and a depth towards the viewer."""
        return np.asarray(place[0] * self._right + place[1] * self._up + depth * self._eye)

    def _aim_cameras(self, target: Array, whole: Array) -> None:
        """Aim the camera of each browser so that a rectangle (width, height) fits into its window."""
        self._front = target, whole, self._eye
        initial: Any = self._server.initial_camera
        initial.up = UP
        _aim(initial, ASPECT, *self._front)

        # viser runs `async` functions in the order of the messages, and others in threads, of which the one that aims
        # for the window before the panel was docked could be the last.
        @self._server.on_client_connect
        async def _(client: Any) -> None:
            aimed_for = 0.0

            @client.camera.on_update  # type: ignore[untyped-decorator]
            async def fit(camera: Any) -> None:
                nonlocal aimed_for
                if abs(camera.aspect - aimed_for) > SAME_ASPECT:  # the window was resized
                    aimed_for = camera.aspect
                    _aim(camera, aimed_for, *self._front)

            await fit(client.camera)


def _aim(camera: Any, aspect: float, target: Array, whole: Array, direction: Array) -> None:
    """Aim a camera so that a rectangle (width, height) around the target fits into its window."""
    height = ROOM * max(whole[0] / aspect, whole[1])  # of the window, at the target
    camera.fov = VERTICAL_ANGLE
    position = target + height / 2 / np.tan(VERTICAL_ANGLE / 2) * direction
    camera.up_direction, camera.position, camera.look_at = UP, position, target  # a new position also moves look_at


def _round(length: float) -> float:
    """Return the greatest of 1, 2 and 5 times a power of ten that is not greater than a length."""
    unit = 10.0 ** np.floor(np.log10(length))
    return float(unit * max(factor for factor in (1, 2, 5) if factor * unit <= length))


def _added(scene: SceneApi, name: str, body: Body | Surface) -> Any:
    red, green, blue = bytes.fromhex(body.colour.removeprefix("#"))
    colour = red, green, blue
    if body.shape == "ball":
        return scene.add_icosphere(name, radius=body.size[0] / 2, color=colour, visible=False)
    if body.shape == "cylinder":
        return scene.add_cylinder(name, body.size[0] / 2, body.size[2], color=colour, visible=False)
    if isinstance(body, Surface):
        return scene.add_mesh_simple(name, body.vertices, body.faces, color=colour, visible=False)
    return scene.add_box(name, color=colour, dimensions=body.size, visible=False)
