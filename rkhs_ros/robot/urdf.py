"""Joint limits from a robot's URDF."""

import os
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from rkhs_ros.base.validation import pick, require
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.limits import MOST

ROTATES_FREELY = "continuous"  # type of joints without a range
PACKAGE = "package://"  # prefix of a file in a package


def located(name: str) -> Path:
    """Return the path of a file from its path or from ``package://PACKAGE/FILE``.

    PACKAGE is a ROS or Python package, such as ``pybullet_data``; raises ValueError if there is none.
    """
    if not name.startswith(PACKAGE):
        return Path(name)
    package, _, file = name.removeprefix(PACKAGE).partition("/")
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    shares = [share for prefix in prefixes if prefix and (share := Path(prefix, "share", package)).is_dir()]
    spec = find_spec(package) if package.isidentifier() and not shares else None
    folders = [*shares, *map(Path, spec.submodule_search_locations or [])] if spec else shares
    require(bool(folders), "urdf", f"an installed package '{package}'", "none")
    return folders[0] / file


def read_urdf(file: Path) -> ElementTree.Element:
    """Read a URDF and return its root element; raise ValueError if the file is not a URDF."""
    try:
        root = ElementTree.fromstring(file.read_bytes())
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"{file}: expected a URDF, got invalid XML: {error}") from error
    require(root.tag == "robot", f"{file}", "a URDF with the root element 'robot'", root.tag)
    return root


def read_limits(file: Path, joints: Iterable[str]) -> tuple[Array, Array, Array, Array]:
    """Return the limits of joints in a URDF: lower and upper positions, velocities and efforts, each (joints,).

    An omitted range is 0, as the URDF specification says; a continuous joint has no range, infinity means no limit.
    Raises ValueError if a joint is missing or has no limits. Xacro is not expanded.
    """
    elements = {element.get("name", ""): element for element in read_urdf(file).findall("joint")}
    limits = [_limits(pick(name, elements, f"joint of {file}"), f"{file}: joint '{name}'") for name in joints]
    lower, upper, velocity, effort = np.array(limits).T
    return lower, upper, velocity, effort


def _limits(joint: ElementTree.Element, what: str) -> list[float]:
    limit = joint.find("limit")
    if limit is None:
        raise ValueError(f"{what}: expected a limit, got none")
    frees = joint.get("type") == ROTATES_FREELY
    positions = [-np.inf, np.inf] if frees else [_number(limit, name, what) for name in ("lower", "upper")]
    return [*positions, _number(limit, "velocity", what), _number(limit, "effort", what)]


def _number(limit: ElementTree.Element, name: str, what: str) -> float:
    text = limit.get(name, "0" if name in ("lower", "upper") else "none")
    try:
        number = float(text)
    except ValueError as error:
        raise ValueError(f"{what}: expected a number for {name}, got {text}") from error
    require(abs(number) <= MOST, f"{what}: {name}", f"a number within {MOST:g}", number)
    return number
