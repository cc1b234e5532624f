"""Build the ament_python package; run by colcon, see the Makefile."""

import re
import sys
from pathlib import Path

from setuptools import find_packages, setup

NAME = "rkhs_ros"
BY_COLCON = bool({"develop", "install"} & set(sys.argv))
# colcon installs the nodes into lib/rkhs_ros, where `ros2 run` and launch files find them. pip would install them onto
# the PATH, where their names clash with others; `robot` is Robot Framework's command.
NODES = [
    "simulator = sim_nodes.simulator_node:main",
    "robot = rkhs_ros.nodes.robot.robot_node:main",
    "simulated_robot = sim_nodes.robots.simulated_robot_node:main",
    "axis_controller = sim_nodes.axis_node:main",
    "gate = rkhs_ros.nodes.robot.gate_node:main",
    "policy = rkhs_ros.nodes.lockstep.policy_node:main",
    "learner = rkhs_ros.app.learner:main",
]


def files(pattern: str) -> list[str]:
    """List the files that match a pattern, without dangling links left by builds of removed files."""
    return [str(path) for path in sorted(Path().glob(pattern)) if path.exists()]


def requirements(name: str) -> list[str]:
    """List the packages of a requirements file."""
    lines = Path(__file__).resolve().parent.joinpath("requirements", f"{name}.txt").read_text().splitlines()
    return [line for line in lines if line and not line.startswith("#")]


setup(
    name=NAME,
    version=re.search('__version__ = "(.*)"', Path(NAME, "__init__.py").read_text())[1],
    description="Policy search in reproducing kernel Hilbert spaces, in process or over ROS 2.",
    license="Apache-2.0",
    maintainer="The rkhs_ros authors",
    maintainer_email="rkhs-ros@example.org",
    packages=find_packages(include=[NAME, f"{NAME}.*", "sim_nodes", "sim_nodes.*"]),
    package_data={
        "rkhs_ros.nodes.core": ["*.xml"],
        "rkhs_ros.recordings": ["msg/*.msg"],
        "sim_nodes.pr2": ["*.npz", "*.urdf"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", files("config/*.yaml")),
        (f"share/{NAME}/config/experiments", files("config/experiments/*.yaml")),
        (f"share/{NAME}/config/tuning", files("config/tuning/*.yaml")),
        (f"share/{NAME}/launch", files("launch/*.launch.py")),
    ],
    python_requires=">=3.11",
    install_requires=[
        "argcomplete>=3",
        "gymnasium>=1.1",
        "joblib>=1.3",
        "matplotlib>=3.6",
        "mcap>=1.2",
        "numpy>=1.26",
        "pillow>=9",
        "PyYAML>=6",
        "rich>=13",
        "rosbags>=0.11",
        "scipy>=1.11",
        "threadpoolctl>=3.1",
    ],
    extras_require={
        "pr2": ["pybullet>=3.2.5"],
        "view": ["viser>=1.1,<1.2"],
        "export": ["onnx>=1.17", "onnxruntime>=1.20", "pyarrow>=15"],
        "tensorboard": ["tensorboardX>=2.6"],
        "dask": ["distributed>=2024.8"],
        "test": requirements("dev"),  # colcon runs pytest if it finds it here
    },
    zip_safe=True,
    entry_points={"console_scripts": ["rkhs = rkhs_ros.app.cli:main", *(NODES if BY_COLCON else [])]},
)
