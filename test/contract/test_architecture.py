"""The imports that each package may have, read from the source; each test lists all files that break its rule."""

import ast
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
# The layers of rkhs_ros: each imports only from itself and from earlier ones. sim_nodes is separate, see below.
LAYERS = (
    *("base", "rkhs", "policies", "learning", "recordings", "rollouts", "runs", "studies"),
    *("robot", "nodes", "pictures", "view", "paper", "app"),
)
ROS = (
    *("rclpy", "rkhs_interfaces", "rcl_interfaces", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs"),
    *("sensor_msgs", "std_msgs", "std_srvs", "trajectory_msgs", "launch", "launch_ros"),
)
# Modules of sim_nodes that may import ROS.
SIM_NODES = [
    ROOT / "sim_nodes" / f"{name}.py" for name in ("simulator_node", "axis_node", "robots/simulated_robot_node")
]
SOURCES = sorted(path for package in ("rkhs_ros", "sim_nodes") for path in (ROOT / package).rglob("*.py"))
PRODUCT = [path for path in SOURCES if path.is_relative_to(ROOT / "rkhs_ros")]
EVERYTHING = sorted(
    [*SOURCES, *(p for folder in ("test", "benchmarks", "launch") for p in (ROOT / folder).rglob("*.py"))]
)


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def imported(nodes: Iterable[ast.AST]) -> set[str]:
    """Return the dotted names that some statements import."""
    found: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{'.' * node.level}{node.module}.{alias.name}" for alias in node.names}
    return found


@cache
def imports(path: Path) -> set[str]:
    """Return the dotted names of all imports of a module, including those inside functions."""
    return imported(ast.walk(parsed(path)))


def within(name: str, *packages: str) -> bool:
    return any(name == package or name.startswith(package + ".") for package in packages)


def offenders(paths: Iterable[Path], is_forbidden: Callable[[str], bool]) -> list[str]:
    """Return the forbidden imports of some modules, with the modules."""
    return [f"{path.relative_to(ROOT)}: {name}" for path in paths for name in imports(path) if is_forbidden(name)]


def layer(path: Path) -> int:
    """Return the index of a module's layer; one beyond the last for modules of the package itself."""
    parts = path.relative_to(ROOT / "rkhs_ros").parts
    return LAYERS.index(parts[0]) if len(parts) > 1 else len(LAYERS)


def upward(names: Iterable[str], place: int) -> list[str]:
    """Return the forbidden imports of a module in a layer."""
    above = [f"rkhs_ros.{name}" for name in LAYERS[place + 1 :]]
    tasks = ["sim_nodes"] if place < LAYERS.index("app") else []
    return [name for name in names if within(name, *above, *tasks)]


def is_node(path: Path) -> bool:
    return path.is_relative_to(ROOT / "rkhs_ros" / "nodes") or path in SIM_NODES


def test_all_packages_have_a_layer() -> None:
    packages = {path.parent.name for path in (ROOT / "rkhs_ros").glob("*/__init__.py")}
    assert packages == set(LAYERS)
    assert len(SOURCES) > 30


def test_layers_import_only_from_earlier_layers() -> None:
    assert [f"{path}: {name}" for path in PRODUCT for name in upward(imports(path), layer(path))] == []


def circle_in(folder: Path) -> set[str]:
    """Return the modules and packages in a folder that import one another, directly or through others."""
    prefix = ".".join(folder.relative_to(ROOT).parts) + "."
    parts = {path.stem: [path] for path in folder.glob("*.py") if path.stem != "__init__"}
    parts |= {path.parent.name: list(path.parent.rglob("*.py")) for path in folder.glob("*/__init__.py")}
    below = {}
    for part, paths in parts.items():
        names = {name for path in paths for name in imports(path) if name.startswith(prefix)}
        below[part] = {name.removeprefix(prefix).split(".")[0] for name in names} - {part}
    left = set(parts)
    while free := {part for part in left if not below[part] & left}:
        left -= free
    return left


def test_imports_run_one_way_within_each_package() -> None:
    folders = {path.parent for path in SOURCES}
    assert len(folders) > 20
    assert {folder.name: circle for folder in folders if (circle := circle_in(folder))} == {}


def test_imports_are_absolute() -> None:
    assert offenders(EVERYTHING, lambda name: name.startswith(".")) == []


def test_only_app_and_its_nodes_import_the_tasks() -> None:
    allowed = [
        f"rkhs_ros.{name}"
        for name in ("base", "policies", "learning", "recordings", "rollouts", "runs", "nodes", "rkhs")
    ]
    paths = [*(ROOT / "sim_nodes").glob("*.py"), *(ROOT / "sim_nodes" / "robots").glob("*.py")]
    assert offenders(paths, lambda name: within(name, "rkhs_ros") and not within(name, *allowed)) == []


def test_layers_below_rollouts_do_not_import_gymnasium() -> None:
    below = [path for path in PRODUCT if layer(path) < LAYERS.index("rollouts")]
    assert offenders(below, lambda name: within(name, "gymnasium")) == []


def test_only_pictures_import_matplotlib_at_once() -> None:
    drawing = ("rkhs_ros/pictures", "rkhs_ros/view", "rkhs_ros/paper")
    others = [path for path in SOURCES if not path.relative_to(ROOT).as_posix().startswith(drawing)]
    early = {path: imported(parsed(path).body) for path in others}
    assert [f"{path}: {name}" for path in others for name in early[path] if within(name, "matplotlib")] == []


def test_only_nodes_import_ros() -> None:
    others = [path for path in SOURCES if not is_node(path)]
    assert offenders(others, lambda name: within(name, *ROS)) == []


def test_tasks_do_not_import_rkhs_ros() -> None:
    tasks = [path for folder in ("envs", "pr2") for path in (ROOT / "sim_nodes" / folder).rglob("*.py")]
    assert offenders(tasks, lambda name: within(name, "rkhs_ros")) == []


def implicit_streams(tree: ast.Module) -> list[int]:
    """Return the lines that make a generator without a seed; Ruff finds the use of numpy's global one."""
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call) and not node.args)
    return [call.lineno for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "default_rng"]


def test_random_numbers_come_from_explicit_streams() -> None:
    assert offenders(EVERYTHING, lambda name: within(name, "random")) == []
    assert [f"{path}:{line}" for path in EVERYTHING for line in implicit_streams(parsed(path))] == []


def test_package_code_has_no_assert() -> None:
    nodes = ((path, node) for path in SOURCES for node in ast.walk(parsed(path)))
    assert [f"{path}:{node.lineno}" for path, node in nodes if isinstance(node, ast.Assert)] == []
