"""What pip installs, in an environment without ROS."""

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = """
import gymnasium, rkhs_ros
class Still(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,)); action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    def reset(self, *, seed=None, options=None): super().reset(seed=seed); return self.np_random.uniform(-1, 1, 2), {}
    def step(self, action): return self.np_random.uniform(-1, 1, 2), -float(action[0] ** 2), False, False, {}
result = rkhs_ros.train(Still, rkhs_ros.RKHSNAC(centres=9), iterations=3, horizon=10, seed=0, progress=False)
result.policy.save("p.npz"); policy = rkhs_ros.load("p.npz"); env = Still()
observation, _ = env.reset(seed=1); policy.reset()
for _ in range(10): observation, reward, *_ = env.step(policy(observation))
gymnasium.register("Still-v0", Still, max_episode_steps=10)
"""


def run(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command without anything of this environment's but the pip configuration."""
    kept = {k: v for k, v in os.environ.items() if k.startswith(("PIP_", "HOME", "LANG", "http", "HTTP", "SSL"))}
    return subprocess.run(
        [str(a) for a in arguments], cwd=cwd, env={**kept, "PATH": "/usr/bin:/bin"}, capture_output=True, text=True
    )


@pytest.mark.faults
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_pip_installs_the_library_and_the_command_without_ros(tmp_path: Path) -> None:
    made = run(sys.executable, "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    python, rkhs = tmp_path / "venv/bin/python", tmp_path / "venv/bin/rkhs"
    source = tmp_path / "source"
    ours = (
        "rkhs_ros",
        "rkhs_interfaces",
        "sim_nodes",
        "config",
        "launch",
        "resource",
        "requirements",
        "setup.py",
        "setup.cfg",
        "package.xml",
    )
    source.mkdir()
    subprocess.run(["cp", "-r", *(ROOT / name for name in ours), source], check=True)
    installed = run(python, "-m", "pip", "install", "-q", source, cwd=tmp_path)
    assert installed.returncode == 0, installed.stderr
    (tmp_path / "still_life.py").write_text(SCRIPT)
    played = run(python, "still_life.py", cwd=tmp_path)
    assert played.returncode == 0, played.stderr
    arguments = (
        "train",
        "--env",
        "still_life:Still-v0",
        "--runner",
        "inline",
        "--iterations",
        2,
        "--out",
        "run",
        "--record",
    )
    learnt = run(rkhs, *arguments, "--quiet", cwd=tmp_path)
    assert learnt.returncode == 0, learnt.stderr
    assert (tmp_path / "run" / "policy.png").is_file()
    assert (tmp_path / "run" / "recording.mcap").is_file()  # the definitions of the messages are there, too
    assert "fig3-toy" in run(rkhs, "list", cwd=tmp_path).stdout  # the configurations are there, too
    there = run(python, "-c", "import rclpy", cwd=tmp_path)
    assert "ModuleNotFoundError" in there.stderr
    refused = run(rkhs, "train", "--env", "still_life:Still-v0", "--runner", "ros", cwd=tmp_path)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)


def test_the_packages_asked_for_are_those_pinned_and_named_to_rosdep() -> None:
    setup = (ROOT / "setup.py").read_text()
    needed = set(re.findall(r'^        "([\w-]+)>=', setup, flags=re.MULTILINE))
    pinned = set(re.findall(r"^([\w-]+)==", (ROOT / "requirements" / "core.txt").read_text(), flags=re.MULTILINE))
    assert len(needed) > 5
    assert needed == pinned - {"pybullet"}


@pytest.mark.parametrize("package", [ROOT, ROOT / "rkhs_interfaces"], ids=["rkhs_ros", "rkhs_interfaces"])
def test_each_package_has_its_licence_and_a_changelog_of_its_name(package: Path) -> None:
    name = ET.parse(package / "package.xml").findtext("name")
    assert (package / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    title = (package / "CHANGELOG.rst").read_text().splitlines()[1]
    assert title == f"Changelog for package {name}"


def test_every_ros_package_that_is_imported_is_named_in_the_manifest() -> None:
    named = {depend.text for depend in ET.parse(ROOT / "package.xml").iter("exec_depend")}
    sources = [*(ROOT / "rkhs_ros").rglob("*.py"), *(ROOT / "sim_nodes").rglob("*.py"), *(ROOT / "launch").glob("*.py")]
    pattern = re.compile(r"^\s*(?:from|import) ((?:rclpy|launch|launch_ros|\w+_msgs|\w+_interfaces))\b", re.MULTILINE)
    imported = {name for source in sources for name in pattern.findall(source.read_text())}
    assert len(imported) > 5
    assert imported <= named
