"""The boxes of the robot and the door on the page match the simulator."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("pybullet")

from sim_nodes.pr2 import door, robot, visual_bodies
from sim_nodes.pr2.demonstration import load
from sim_nodes.pr2.environment import POSE_SD, PR2Door
from sim_nodes.pr2.motion import adapted

SHOWN = ("torso_lift_link", "r_forearm_link", "r_gripper_palm_link", "r_gripper_l_finger_tip_link", "panel", "lever")


def test_the_boxes_match_the_simulator() -> None:
    task = PR2Door()
    observation, action = np.array([0.5, -1.0, 1.0]), -task.start
    motion = task.motion(observation[None], action[None])
    places, turns = boxes(task, observation * POSE_SD)
    links = [link.name for link in (*robot.LINKS, *door.LINKS) for _ in visual_bodies._boxes(link)]
    assert len(links) == len(task.bodies()) == motion.positions.shape[1]
    for name in SHOWN:
        column = links.index(name)  # the first box of a link is its own
        assert np.abs(motion.positions[:, column] - places[name]).max() < 1e-6
        assert np.abs(np.abs((motion.orientations[:, column] * turns[name]).sum(axis=1)) - 1.0).max() < 1e-6
    assert np.ptp(motion.orientations[:, links.index("panel")], axis=0).max() > 0.05  # the door opens
    task.close()


def boxes(task: PR2Door, pose: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the middles and the quaternions w, x, y, z of the boxes of some links, at each moment, by PyBullet."""
    world, places, turns = task.world, {name: [] for name in SHOWN}, {name: [] for name in SHOWN}
    middles = {link.name: np.add(*link.box) / 2 for link in (*robot.LINKS, *door.LINKS) if link.box}

    def watch(client: Any) -> None:
        for body in (world._robot, world._door):
            for i in range(client.getNumJoints(body)):
                name = client.getJointInfo(body, i)[12].decode()
                if name in SHOWN:
                    place, turn = client.getLinkState(body, i, computeForwardKinematics=True)[4:6]
                    places[name].append(client.multiplyTransforms(place, turn, middles[name], (0, 0, 0, 1))[0])
                    turns[name].append(np.roll(turn, 1))

    world.run(adapted(load(), np.zeros(2)), pose, watch)
    return ({name: np.array(values) for name, values in each.items()} for each in (places, turns))
