"""Monitoring messages of a learner: progress, and markers of episodes and policy."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path

from builtin_interfaces.msg import Time as Stamp
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from rkhs_interfaces.msg import LearningProgress
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.curve import BEGINNING, Row, seconds_left
from rkhs_ros.sketches.sketch import SIZE, Sketch

FRAME = "map"  # world-fixed frame of REP 105
LINE_M, DOT_M, CENTRE_M, TEXT_M = 0.008, 0.03, 0.04, 0.06  # sizes
OLD, NEW = (0.55, 0.55, 0.60, 0.25), (0.00, 0.62, 0.45, 1.0)  # colours of episodes, with their opacity
LEAST, MOST = (0.00, 0.45, 0.70, 1.0), (0.84, 0.37, 0.00, 1.0)  # colours of the least and of the greatest action
TEXT = (0.50, 0.50, 0.50, 1.0)
CORNERS = ((0.0, -0.6, -0.5), (-0.6, 0.0, -0.5), (-0.5, -0.5, 0.6))  # positions of the axis labels, in sides of the box


def progress_message(stamp: Stamp, run: str, folder: Path, iterations: int, rows: Sequence[Row]) -> LearningProgress:
    """Return the progress of a run from the last lines of its learning curve."""
    return LearningProgress(
        stamp=stamp,
        run=run,
        folder=str(folder),
        iterations=iterations,
        **(rows[-1] if rows else BEGINNING)._asdict(),
        seconds_left=seconds_left(rows, iterations),
        last_iterations=array("I", [row.iteration for row in rows]),
        last_exploration_returns=array("d", [row.exploration_return for row in rows]),
        last_evaluation_returns=array("d", [row.evaluation_return for row in rows]),
        last_model_returns=array("d", [row.model_return for row in rows]),
    )


def marker_array(stamp: Stamp, sketch: Sketch) -> MarkerArray:
    """Return a sketch as markers that replace all earlier ones."""
    header = Header(stamp=stamp, frame_id=FRAME)
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    for number, marker in enumerate(_markers(sketch)):
        marker.header, marker.id = header, number
        marker.pose.orientation.w = 1.0
        markers.append(marker)
    return MarkerArray(markers=markers)


def _markers(sketch: Sketch) -> Iterator[Marker]:
    newest = max(len(sketch.paths) - 1, 1)
    for age, parts in enumerate(sketch.paths):
        colour = _between(OLD, NEW, age / newest)
        for part in parts:
            kind, size = (Marker.LINE_STRIP, LINE_M) if len(part) > 1 else (Marker.SPHERE_LIST, DOT_M)
            yield _marker("episodes", kind, size, colour, points=_points(part))
    heights = sketch.centres[:, 2] / SIZE[2] + 0.5
    colours = [_between(LEAST, MOST, float(height)) for height in heights]
    if colours:
        yield _marker("centres", Marker.SPHERE_LIST, CENTRE_M, points=_points(sketch.centres), colors=colours)
    for label, place in zip(sketch.axes, CORNERS, strict=True):
        text = _marker("axes", Marker.TEXT_VIEW_FACING, TEXT_M, ColorRGBA(**_rgba(TEXT)), text=label)
        (text.pose.position,) = _points((SIZE * place)[None])
        yield text


def _marker(group: str, kind: int, size: float, colour: ColorRGBA | None = None, **content: object) -> Marker:
    marker = Marker(ns=group, type=kind, action=Marker.ADD, **content)
    marker.scale.x = marker.scale.y = marker.scale.z = size
    if colour is not None:
        marker.color = colour
    return marker


def _points(points: Array) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]


def _rgba(colour: Sequence[float]) -> dict[str, float]:
    return dict(zip("rgba", colour, strict=True))


def _between(first: Sequence[float], last: Sequence[float], part: float) -> ColorRGBA:
    """Interpolate linearly between two colours."""
    return ColorRGBA(**_rgba([a + part * (b - a) for a, b in zip(first, last, strict=True)]))
