"""The PR2's meshes are visual only; links that the simulated robot lacks are fixed to known ones."""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_nodes.pr2 import meshes, robot
from sim_nodes.pr2.demonstration import TORSO

ARM = "l_shoulder_pan_joint"
CORNERS = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0]], dtype="<f4")
SEEN = f"""<robot name="pr2">
<link name="base_link"/>
<link name="torso_lift_link"><visual><geometry><mesh filename="package://{meshes.PACKAGE}/torso.stl"/></geometry></visual></link>
<link name="l_shoulder_pan_link"/>
<link name="l_finger"><visual><origin xyz="0 0 0.5" rpy="0 0 0.25"/>
  <geometry><mesh filename="package://{meshes.PACKAGE}/l_finger.stl" scale="1 2 1"/></geometry></visual></link>
<link name="adrift"><visual><geometry><mesh filename="package://{meshes.PACKAGE}/torso.stl"/></geometry></visual></link>
<joint name="torso_lift_joint" type="prismatic"><parent link="base_link"/><child link="torso_lift_link"/></joint>
<joint name="{ARM}" type="revolute"><origin xyz="0 1 0" rpy="0 0 0"/><axis xyz="0 0 1"/>
  <parent link="torso_lift_link"/><child link="l_shoulder_pan_link"/></joint>
<joint name="finger_joint" type="fixed"><origin xyz="3 0 0" rpy="0 0 0"/>
  <parent link="l_shoulder_pan_link"/><child link="l_finger"/></joint>
</robot>"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package with the description of a smaller robot, whose meshes have no normals."""
    root = tmp_path / "share" / meshes.PACKAGE
    description = root / meshes.DESCRIPTION
    description.parent.mkdir(parents=True)
    description.write_text(SEEN)
    triangle = np.zeros(1, meshes.TRIANGLE)
    triangle["corners"] = CORNERS
    for name in ("torso.stl", "l_finger.stl"):
        (root / name).write_bytes(bytes(80) + (1).to_bytes(4, "little") + triangle.tobytes())
    about = tmp_path / "example_robot_data-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {meshes.PACKAGE}\nVersion: 1\n")
    (about / "RECORD").write_text(f"share/{meshes.PACKAGE}/{meshes.DESCRIPTION},,\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    meshes._description.cache_clear()
    yield tmp_path
    meshes._description.cache_clear()


def links(urdf: str) -> dict[str | None, ElementTree.Element]:
    return {link.get("name"): link for link in ElementTree.fromstring(urdf).findall("link")}


def test_meshes_replace_boxes_at_the_poses_of_the_chain(package: Path, tmp_path: Path) -> None:
    plain = robot.simulated_urdf(TORSO)
    seen = links(meshes.with_meshes(plain, tmp_path))
    body, finger = seen["torso_lift_link"].findall("visual")
    assert [v.find("geometry/mesh") is not None for v in (body, finger)] == [True, True]
    origin, mesh = finger.find("origin"), finger.find("geometry/mesh")
    assert origin is not None
    assert mesh is not None
    assert mesh.get("scale") == "1 2 1"
    turn = meshes.REST[ARM]
    place, angles = ([float(word) for word in str(origin.get(key)).split()] for key in ("xyz", "rpy"))
    np.testing.assert_allclose(place, [3 * np.cos(turn), 1 + 3 * np.sin(turn), 0.5])
    np.testing.assert_allclose(Rotation.from_euler("xyz", angles).as_rotvec(), [0, 0, turn + 0.25], atol=1e-8)
    written = np.frombuffer(Path(str(mesh.get("filename"))).read_bytes(), meshes.TRIANGLE, offset=meshes.HEADER)
    np.testing.assert_allclose(written["normal"], [[0, 0, 1]])
    np.testing.assert_array_equal(written["corners"][0], CORNERS)
    assert seen["r_forearm_link"].find("visual/geometry/box") is not None  # of which the package has none


def test_meshes_do_not_change_contacts_and_masses(package: Path, tmp_path: Path) -> None:
    plain = robot.simulated_urdf(TORSO)
    for name, link in links(meshes.with_meshes(plain, tmp_path)).items():
        for part in ("collision", "inertial"):
            before, after = links(plain)[name].findall(part), link.findall(part)
            assert [ElementTree.tostring(e) for e in before] == [ElementTree.tostring(e) for e in after]


def test_without_the_package_the_robot_has_boxes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshes, "PACKAGE", "no-such-package")
    meshes._description.cache_clear()
    assert meshes.with_meshes(robot.simulated_urdf(TORSO), tmp_path) == robot.simulated_urdf(TORSO)
    meshes._description.cache_clear()


def test_meshes_do_not_change_the_motion(package: Path) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    from sim_nodes.pr2 import demonstration
    from sim_nodes.pr2.motion import adapted
    from sim_nodes.pr2.world import World

    motion = adapted(demonstration.load(), np.zeros(2))
    assert motion is not None
    plain, seen = World(), World(meshes=True)
    try:
        for one, other in zip(
            vars(plain.run(motion, np.zeros(3))).values(), vars(seen.run(motion, np.zeros(3))).values(), strict=True
        ):
            np.testing.assert_array_equal(one, other)
        assert len(plain.client.getVisualShapeData(0)) != len(seen.client.getVisualShapeData(0))
    finally:
        plain.close()
        seen.close()
