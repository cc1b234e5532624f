"""The repository in a workspace of colcon, as people have who use ROS natively."""

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PACKAGES = {"rkhs_ros": "ros.ament_python", "rkhs_interfaces": "ros.ament_cmake"}
UNTRACKED = {".git", ".venv", "build", "install", "log", "results"}

pytest.importorskip("colcon_core", reason="colcon is not installed")
pytest.importorskip("rclpy", reason="ROS is not there")


def colcon(*arguments: str, cwd: Path, interfaces: bool = False) -> subprocess.CompletedProcess[str]:
    """Run colcon with the ROS of this environment, without the workspace that is entered, but for its interfaces."""
    environment = {k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    ours = tuple(str(ROOT / folder) for folder in ("install", "build"))
    for name in ("AMENT_PREFIX_PATH", "PYTHONPATH"):
        paths = environment.pop(name, "").split(":")
        kept = [p for p in paths if not p.startswith(ours) or (interfaces and "/rkhs_interfaces" in p)]
        environment[name] = ":".join(kept)
    code = "import colcon_core.command, sys; sys.exit(colcon_core.command.main())"
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)


def found(workspace: Path) -> dict[str, str]:
    lines = [line.split("\t") for line in colcon("list", cwd=workspace).stdout.splitlines()]
    return {name: kind.strip("()") for name, _, kind in lines}


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A workspace as it is documented: the repository, and beside it a link to the package inside it."""
    source = tmp_path / "src"
    (source / "rkhs").mkdir(parents=True)
    for path in ROOT.iterdir():
        if path.name not in UNTRACKED:
            subprocess.run(["cp", "-r", path, source / "rkhs"], check=True)
    (source / "rkhs_interfaces").symlink_to("rkhs/rkhs_interfaces")
    return tmp_path


def test_both_packages_are_found_in_a_workspace_and_in_the_repository(workspace: Path) -> None:
    assert found(workspace) == PACKAGES
    assert found(workspace / "src" / "rkhs") == PACKAGES


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_workspace_is_built_and_tested_by_plain_colcon(workspace: Path) -> None:
    only = ("--base-paths", "src/rkhs")  # the interfaces take long, and are built the same everywhere
    built = colcon("build", *only, cwd=workspace, interfaces=True)
    assert built.returncode == 0, built.stderr
    assert (workspace / "install/rkhs_ros/lib/rkhs_ros/learner").is_file()
    tested = colcon("test", *only, "--pytest-args", " -k", "names or packaging", cwd=workspace, interfaces=True)
    assert tested.returncode == 0, tested.stderr
    (suite,) = ET.parse(workspace / "build/rkhs_ros/pytest.xml").iter("testsuite")
    ran = {case.get("name") for case in suite.iter("testcase")}
    assert "test_all_that_is_imported_is_named_in_the_manifest_or_an_extra" in ran
    assert "test_pip_installs_the_library_and_the_command_without_ros" not in ran  # it is slow
    assert (suite.get("failures"), suite.get("errors")) == ("0", "0")
