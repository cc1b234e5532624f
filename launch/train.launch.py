"""The three nodes of a run: ``ros2 launch rkhs_ros train.launch.py config:=FILE``."""

from launch import LaunchDescription  # noqa: I001  # ruff takes it for the folder of this file
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

AGAIN = {"respawn": True, "respawn_delay": 1.0}


def generate_launch_description() -> LaunchDescription:
    """Start simulator, policy and learner with one parameter file; all end with the learner.

    Simulator and policy node are started again where they die: the learner brings them back.
    """
    default = PathJoinSubstitution([FindPackageShare("rkhs_ros"), "config", "pendulum_nac.yaml"])
    config = LaunchConfiguration("config")
    nodes = [
        Node(
            package="rkhs_ros",
            executable=name,
            output="screen",
            parameters=[config],
            **({"on_exit": Shutdown(reason="the learner ended")} if name == "learner" else AGAIN),
        )
        for name in ("simulator", "policy", "learner")
    ]
    argument = DeclareLaunchArgument("config", default_value=default, description="parameter file, see config/")
    return LaunchDescription([argument, *nodes])
