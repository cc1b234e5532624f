"""What pip installs, in an environment without ROS."""

import ast
import os
import re
import runpy
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
KEYS = {  # of rosdep, by the names of the packages and those that they are imported by; of the others: python3-NAME
    "PIL": "python3-pil",
    "PyYAML": "python3-yaml",
    "gymnasium": "python3-gymnasium-pip",
    "lz4": "mcap-ros2-support",
    "markdown_it": "python3-rich",
    "mcap": "mcap-ros2-support",
    "mcap_ros2": "mcap-ros2-support",
    "pillow": "python3-pil",
    "pybullet": "python3-pybullet-pip",
    "pybullet_data": "python3-pybullet-pip",
    "pybullet_utils": "python3-pybullet-pip",
    "rosbags": "python3-rosbags-pip",
    "threadpoolctl": "python3-sklearn",
    "zstandard": "mcap-ros2-support",
}
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


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_pip_installs_the_library_and_the_command_without_ros(tmp_path: Path) -> None:
    made = run(sys.executable, "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    python, rkhs = tmp_path / "venv/bin/python", tmp_path / "venv/bin/rkhs"
    source = tmp_path / "source"
    folders, files = "rkhs_ros rkhs_interfaces sim_nodes config launch resource requirements", "setup.py setup.cfg"
    ours = f"{folders} {files} pyproject.toml package.xml".split()
    source.mkdir()
    subprocess.run(["cp", "-r", *(ROOT / name for name in ours), source], check=True)
    installed = run(python, "-m", "pip", "install", "-q", source, cwd=tmp_path)
    assert installed.returncode == 0, installed.stderr
    (tmp_path / "still_life.py").write_text(SCRIPT)
    played = run(python, "still_life.py", cwd=tmp_path)
    assert played.returncode == 0, played.stderr
    arguments = ("train", "--env", "still_life:Still-v0", "--runner", "inline", "--iterations", 2, "--out", "run")
    learnt = run(rkhs, *arguments, "--quiet", cwd=tmp_path)
    assert learnt.returncode == 0, learnt.stderr
    assert (tmp_path / "run" / "policy.png").is_file()
    assert (tmp_path / "run" / "recording.mcap").is_file()  # the definitions of the messages are there, too
    assert "fig3-toy" in run(rkhs, "list", cwd=tmp_path).stdout  # the configurations are there, too
    there = run(python, "-c", "import rclpy", cwd=tmp_path)
    assert "ModuleNotFoundError" in there.stderr
    assert not {"robot", "gate", "policy", "learner"} & {path.name for path in python.parent.iterdir()}
    refused = run(rkhs, "train", "--env", "still_life:Still-v0", "--runner", "ros", cwd=tmp_path)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)


@pytest.mark.parametrize(
    ("command", "nodes"),
    [("bdist_wheel", False), ("editable_wheel", False), ("dist_info", False), ("develop", True), ("install", True)],
)
def test_only_colcon_installs_the_nodes(command: str, nodes: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr("setuptools.setup", lambda **arguments: given.update(arguments))
    monkeypatch.setattr("sys.argv", ["setup.py", command])
    monkeypatch.chdir(ROOT)
    runpy.run_path("setup.py")
    scripts = {script.partition(" ")[0] for script in given["entry_points"]["console_scripts"]}
    launched = {"simulator", "gate", "robot", "simulated_robot", "policy", "learner", "axis_controller"}
    assert scripts == {"rkhs"} | (launched if nodes else set())


def test_the_packages_asked_for_are_those_pinned_and_named_to_rosdep() -> None:
    needed = set(re.findall(r'^        "([\w-]+)>=', (ROOT / "setup.py").read_text(), flags=re.MULTILINE))
    pinned = set(re.findall(r"^([\w-]+)==", (ROOT / "requirements" / "core.txt").read_text(), flags=re.MULTILINE))
    assert len(needed) > 5
    assert needed == pinned - {"pybullet"}
    assert {KEYS.get(name, f"python3-{name}") for name in pinned} <= named("exec_depend")


def named(*kinds: str) -> set[str]:
    manifest = ET.parse(ROOT / "package.xml")
    return {depend.text or "" for kind in kinds for depend in manifest.iter(kind)}


def extras() -> set[str]:
    """Return the packages of the extras in setup.py, by the names that they are imported by."""
    text = (ROOT / "setup.py").read_text().partition("extras_require")[2].partition("}")[0]
    return {name.replace("-", "_") for name in re.findall(r'"([\w-]+)[\[>]', text)}


def imported(path: Path) -> set[str]:
    """Return the packages that a module imports, within functions too."""
    return imported_by(list(ast.walk(ast.parse(path.read_text()))))


def imported_by(nodes: Sequence[ast.AST]) -> set[str]:
    """Return the packages that some statements import."""
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    return {name.partition(".")[0] for name in names}


def test_all_that_is_imported_is_named_in_the_manifest_or_an_extra() -> None:
    manifest, ours = named("exec_depend"), {*sys.stdlib_module_names, "rkhs_ros", "sim_nodes"}
    sources = [path for folder in ("rkhs_ros", "sim_nodes", "launch") for path in (ROOT / folder).rglob("*.py")]
    found = set().union(*map(imported, sources)) - ours
    assert {"mcap", "rosbags", "rclpy", "launch_ros", "threadpoolctl"} <= found
    undeclared = {name for name in found if not {name, KEYS.get(name, f"python3-{name}")} & manifest}
    assert undeclared <= {*extras(), "trimesh"}  # which comes with viser


def test_plain_colcon_can_collect_all_tests() -> None:
    """Modules import at once only what the manifest names, or what they skip without."""
    manifest = named("exec_depend", "test_depend")
    local = {path.stem for folder in ("benchmarks", "docs") for path in (ROOT / folder).glob("*.py")}
    ours = {*sys.stdlib_module_names, "rkhs_ros", "sim_nodes", "test", *local}
    missing = {}
    for path in (ROOT / "test").rglob("*.py"):
        text = path.read_text()
        names = imported_by(ast.parse(text).body) - ours - set(re.findall(r'importorskip\("(\w+)', text))
        missing[path] = {name for name in names if not {name, KEYS.get(name, f"python3-{name}")} & manifest}
    assert {path: names for path, names in missing.items() if names} == {}


def test_commands_are_imported_without_the_extras() -> None:
    script = """
import sys
sys.modules |= dict.fromkeys(sys.argv[1].split())
from importlib import import_module
from pathlib import Path
import rkhs_ros.app.commands as commands
for path in Path(commands.__file__).parent.glob("*.py"):
    import_module(f"rkhs_ros.app.commands.{path.stem}")
"""
    absent = extras() - {"gymnasium", "pybullet"}
    assert "onnx" in absent
    ran = subprocess.run([sys.executable, "-c", script, " ".join(absent)], capture_output=True, text=True, cwd=ROOT)
    assert (ran.returncode, ran.stderr) == (0, "")
