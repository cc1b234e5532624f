"""The tasks, registered with Gymnasium when this package is imported.

``gymnasium.make("sim_nodes.envs:rkhs/Toy-v0")`` imports the package automatically.
"""

from functools import partial

from gymnasium.envs.registration import register

from sim_nodes.envs.cart_pole import CartPole
from sim_nodes.envs.control_tasks import BallOnBeam, Furuta, Tanks
from sim_nodes.envs.lever_stafford import Pendulum, PendulumPOMDP, Toy
from sim_nodes.envs.vector_task import SingleTask, VectorTask


def _single(task: type[VectorTask], **options: object) -> SingleTask:
    return SingleTask(task(**options))  # type: ignore[arg-type]  # Gymnasium passes options by name


TASKS: dict[str, tuple[type[VectorTask], int]] = {
    "rkhs/Toy-v0": (Toy, 20),
    "rkhs/Pendulum-v0": (Pendulum, 100),
    "rkhs/PendulumPOMDP-v0": (PendulumPOMDP, 100),
    "rkhs/CartPoleSwingUp-v0": (CartPole, 60),
    "rkhs/BallOnBeam-v0": (BallOnBeam, 300),
    "rkhs/Tanks-v0": (Tanks, 120),
    "rkhs/Furuta-v0": (Furuta, 300),
}

for _id, (_task, _horizon) in TASKS.items():
    register(
        id=_id,
        entry_point=partial(_single, _task),
        vector_entry_point=_task,  # type: ignore[arg-type]  # Gymnasium's protocol is of keywords only
        max_episode_steps=_horizon if _task.time_limit({}) is None else None,
    )

register(  # by name, because it needs PyBullet, which is optional
    id="rkhs/PR2Door-v0",
    entry_point="sim_nodes.pr2.environment:single",
    vector_entry_point="sim_nodes.pr2.environment:PR2Door",
    max_episode_steps=1,
)

register(  # by name, because it needs ROS 2: a running simulator or robot node
    id="rkhs/Remote-v0", entry_point="rkhs_ros.nodes.lockstep.remote_env:RemoteEnv"
)
