"""Scenes of robots on the page: from their URDF, or from their simulated twin."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("viser")

from viser.transforms import SO3

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.task import RobotTask, robot_task_from
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.view.bodies import Surface, UrdfBodies
from rkhs_ros.view.scenes import RobotScene, appearance_of
from rkhs_ros.view.timeline import Timeline

CONFIGS = Path(__file__).parents[3] / "config"
TWO_LINKS = """<robot name="two">
<material name="paint"><color rgba="1 0 0 1"/></material>
<link name="base"><visual><geometry><box size="0.2 0.2 0.1"/></geometry><material name="paint"/></visual></link>
<link name="rod"><visual>
<origin xyz="0 0 0.5"/><geometry><cylinder radius="0.02" length="1"/></geometry></visual></link>
<link name="slide"><visual><geometry><sphere radius="0.05"/></geometry></visual>
<visual><geometry><mesh filename="package://nobody/knows.stl"/></geometry></visual></link>
<joint name="swing" type="revolute">
<parent link="base"/><child link="rod"/><origin xyz="0 0 0.1"/><axis xyz="0 2 0"/></joint>
<joint name="push" type="prismatic">
<parent link="rod"/><child link="slide"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.6"/></joint>
</robot>"""


@pytest.fixture
def two_links(tmp_path: Path) -> UrdfBodies:
    file = tmp_path / "two.urdf"
    file.write_text(TWO_LINKS)
    return UrdfBodies(file)


def test_frames_follow_the_joints(two_links: UrdfBodies) -> None:
    assert [body.shape for body in two_links.bodies] == ["box", "cylinder", "ball"]  # no missing mesh
    assert two_links.bodies[0].colour == "#DE0000"
    (waiting,) = two_links.frames({}, 1)[2:]
    assert np.allclose(waiting[0, :3, 3], [0, 0, 1.4])  # in the middle of its range
    base, rod, ball = two_links.frames({"swing": np.array([0.0, np.pi / 2]), "push": np.array([0.0, 0.5])}, 2)
    assert np.allclose(base, np.eye(4))
    assert np.allclose(rod[:, :3, 3], [[0, 0, 0.6], [0.5, 0, 0.1]])
    assert np.allclose(ball[:, :3, 3], [[0, 0, 1.1], [1.5, 0, 0.1]])


def mimicking(tmp_path: Path, *mimics: str) -> UrdfBodies:
    """Return three balls, each one metre above the previous link and on a joint along x with a mimic element."""
    links = "".join(
        f"<link name='l{i}'><visual><geometry><sphere radius='0.1'/></geometry></visual></link>" for i in range(4)
    )
    joints = "".join(
        f"<joint name='j{i}' type='prismatic'><parent link='l{i}'/><child link='l{i + 1}'/><origin xyz='0 0 1'/>"
        f"<axis xyz='1 0 0'/><limit lower='0' upper='0.6'/>{mimic}</joint>"
        for i, mimic in enumerate(mimics)
    )
    file = tmp_path / "mimics.urdf"
    file.write_text(f"<robot name='mimics'>{links}{joints}</robot>")
    return UrdfBodies(file)


def test_a_joint_that_mimics_another_follows_it_unless_it_is_sensed(tmp_path: Path) -> None:
    second, third = "<mimic joint='j2' multiplier='-2' offset='0.1'/>", "<mimic joint='j0'/>"
    bodies = mimicking(tmp_path, "", second, third)

    def pushed(**positions: float) -> list[float]:
        frames = bodies.frames({name: np.array([at]) for name, at in positions.items()}, 1)
        return np.diff([frame[0, 0, 3] for frame in frames]).round(9).tolist()  # type: ignore[no-any-return]

    assert pushed(j0=0.2) == [0.2, -0.3, 0.2]
    assert pushed() == [0.3, -0.5, 0.3]  # the leader is in the middle of its range
    assert pushed(j0=0.2, j2=0.0) == [0.2, 0.1, 0.0]


@pytest.mark.parametrize("text", ["no XML", "<robot/>"])
def test_a_urdf_without_bodies_is_rejected(text: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.urdf"
    file.write_text(text)
    with pytest.raises(ValueError, match=r"bad\.urdf: expected "):
        UrdfBodies(file)


def configured() -> Config:
    return load_config(CONFIGS / "robot_arm.yaml", ["gate.limits.velocity=[2.0]"])


def arm(observations: Array, actions: Array) -> RobotScene:
    config = configured()
    names, scene = appearance_of(config.task, None, config.environment.nodes, observations, actions)
    assert isinstance(scene, RobotScene)
    assert names.observations[0].startswith("mark ")
    assert names.actions[0].startswith("panda_joint1 ")
    return scene


def task() -> RobotTask:
    return robot_task_from(configured().environment.nodes["robot"])


def at(scene: RobotScene, commanded: dict[str, float]) -> Array:
    """Return the positions of the arm's seven joints; those without a command are in the middle of their range."""
    middles = {joint.name: joint.middle for joint in scene._bodies._joints.values()}
    return np.array([(middles | commanded)[f"panda_joint{number}"] for number in range(1, 8)])


@pytest.fixture(scope="module")
def episode() -> tuple[Array, Array]:
    rng = np.random.default_rng(0)
    return np.tile([0.1, 0.45, 0.5, 0.0, 0.5], (4, 1)), rng.uniform(-0.25, 0.25, (4, len(task().action.minimum)))


def test_the_arm_has_the_frames_of_its_physics_engine(episode: tuple[Array, Array]) -> None:
    arm_body = pytest.importorskip("pybullet") and pytest.importorskip("sim_nodes.robots.arm_body")
    observations, actions = episode
    scene = arm(observations, actions)
    bodies, motion = scene.bodies(), scene.motion(observations, actions)
    assert sum(isinstance(body, Surface) for body in bodies) == 11
    joints = configured().environment.nodes["gate"]["joints"]
    commanded = {joint: np.array(task().reset.home.position)[i] for i, joint in enumerate(joints)}
    for step in range(len(actions)):
        body = arm_body.ArmBody(240.0, at(scene, commanded))
        state = body._client.getLinkState(body._body, 8, computeForwardKinematics=True)  # the hand
        assert np.allclose(motion.positions[step, 8], state[4], atol=1e-6)
        for joint, asked in zip(joints, task().action.command(actions[step]), strict=True):
            commanded[joint] += np.clip(asked - commanded[joint], -2.0 * task().period, 2.0 * task().period)
        x, y, z, w = state[5]
        assert np.allclose(
            SO3(motion.orientations[step, 8]).as_matrix(), SO3(np.array([w, x, y, z])).as_matrix(), atol=1e-5
        )
    assert np.allclose(motion.positions[:, -2], [0.5, 0.1, 0.45])  # the mark; its unobserved x is that of the tool
    low, high = scene.bounds
    assert (motion.positions > low).all()
    assert (motion.positions < high).all()


def test_the_motor_pendulum_looks_like_the_pendulum() -> None:
    config = load_config(CONFIGS / "robot_pendulum.yaml")
    names, scene = appearance_of(config.task, None, config.environment.nodes, np.zeros((3, 2)), np.zeros((3, 1)))
    assert type(scene).__name__ == "Pendulum"
    assert [name.split()[:2] for name in names.observations] == [["motor", "position"], ["motor", "velocity"]]


def test_robots_without_a_urdf_have_a_timeline() -> None:
    nodes = dict(load_config(CONFIGS / "robot_pendulum.yaml").environment.nodes)
    nodes.pop("simulated_robot")
    mine = SimpleNamespace(environment="mine", options={})
    for some in (nodes, {"robot": {"task": "gone"}, "gate": {}}):
        assert isinstance(appearance_of(mine, None, some, np.zeros((3, 2)), np.zeros((3, 1)))[1], Timeline)
