"""The three nodes of a run: ``ros2 launch rkhs_ros train.launch.py config:=FILE``."""

from launch import LaunchDescription  # noqa: I001  # ruff takes it for the folder of this file
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Start simulator, policy and learner with one parameter file; where one of them ends, all end."""
    default = PathJoinSubstitution([FindPackageShare("rkhs_ros"), "config", "pendulum_nac.yaml"])
    config = LaunchConfiguration("config")
    nodes = [
        Node(
            package="rkhs_ros",
            executable=name,
            output="screen",
            parameters=[config],
            on_exit=Shutdown(reason=f"the {name} node ended"),
        )
        for name in ("simulator", "policy", "learner")
    ]
    argument = DeclareLaunchArgument("config", default_value=default, description="parameter file, see config/")
    return LaunchDescription([argument, *nodes])
