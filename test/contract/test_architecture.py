"""The imports that each package may have, read from the source."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# The layers of rkhs_ros: each imports only from itself and from earlier ones. sim_nodes is separate, see below.
LAYERS = (
    "base",
    "rkhs",
    "policies",
    "learning",
    "recordings",
    "rollouts",
    "sketches",
    "runs",
    "studies",
    "robot",
    "nodes",
    "pictures",
    "view",
    "paper",
    "app",
)
ROS = (
    "rclpy",
    "rkhs_interfaces",
    "rcl_interfaces",
    "rosgraph_msgs",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "trajectory_msgs",
    "visualization_msgs",
)
# Modules of sim_nodes that may import ROS.
SIM_NODES = [
    ROOT / "sim_nodes" / f"{name}.py"
    for name in ("simulator_node", "composed_node", "robots/simulated_robot_node", "robots/topics")
]
SOURCES = sorted(path for package in ("rkhs_ros", "sim_nodes") for path in (ROOT / package).rglob("*.py"))
EVERYTHING = sorted(
    [*SOURCES, *(p for folder in ("test", "benchmarks", "launch") for p in (ROOT / folder).rglob("*.py"))]
)
EXPLICIT_STREAMS = {"Generator", "Philox", "PCG64", "SeedSequence", "BitGenerator", "default_rng"}
over_sources = pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
over_everything = pytest.mark.parametrize("path", EVERYTHING, ids=lambda path: str(path.relative_to(ROOT)))


def imports(path: Path) -> set[str]:
    """Return the dotted names of all imports of a module, including those inside functions."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"a relative import in {path}"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def within(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


def layer(path: Path) -> int:
    """Return the index of a module's layer; one beyond the last for modules of the package itself."""
    parts = path.relative_to(ROOT / "rkhs_ros").parts
    return LAYERS.index(parts[0]) if len(parts) > 1 else len(LAYERS)


def upward(names: set[str], place: int) -> list[str]:
    """Return the forbidden imports of a module in a layer."""
    above = [f"rkhs_ros.{name}" for name in LAYERS[place + 1 :]]
    tasks = ["sim_nodes"] if place < LAYERS.index("app") else []
    return [name for name in names for package in [*above, *tasks] if within(name, package)]


def is_node(path: Path) -> bool:
    return path.is_relative_to(ROOT / "rkhs_ros" / "nodes") or path in SIM_NODES


def test_all_packages_have_a_layer() -> None:
    packages = {path.parent.name for path in (ROOT / "rkhs_ros").glob("*/__init__.py")}
    assert packages == set(LAYERS)
    assert len(SOURCES) > 30


@pytest.mark.parametrize(
    "path", [p for p in SOURCES if p.is_relative_to(ROOT / "rkhs_ros")], ids=lambda path: str(path.relative_to(ROOT))
)
def test_layers_import_only_from_earlier_layers(path: Path) -> None:
    assert not upward(imports(path), layer(path))


def test_an_import_from_a_later_layer_is_detected(tmp_path: Path) -> None:
    for place, name in enumerate(LAYERS[:-1]):
        module = tmp_path / f"{name}.py"
        module.write_text(f"def later() -> None:\n    from rkhs_ros.{LAYERS[place + 1]} import something\n")
        assert upward(imports(module), place)
        module.write_text("import sim_nodes.envs\n")
        assert upward(imports(module), place)


def test_only_app_and_its_nodes_import_the_tasks() -> None:
    allowed = {
        "rkhs_ros.base",
        "rkhs_ros.policies",
        "rkhs_ros.learning",
        "rkhs_ros.rollouts",
        "rkhs_ros.runs",
        "rkhs_ros.nodes",
        "rkhs_ros.rkhs",
    }
    for path in [*(ROOT / "sim_nodes").glob("*.py"), *(ROOT / "sim_nodes" / "robots").glob("*.py")]:
        ours = {".".join(name.split(".")[:2]) for name in imports(path) if within(name, "rkhs_ros")}
        assert ours <= allowed


@pytest.mark.parametrize(
    "path",
    [p for p in SOURCES if p.is_relative_to(ROOT / "rkhs_ros") and layer(p) < LAYERS.index("rollouts")],
    ids=lambda path: str(path.relative_to(ROOT)),
)
def test_layers_below_rollouts_do_not_import_gymnasium(path: Path) -> None:
    assert not [name for name in imports(path) if within(name, "gymnasium")]


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_only_pictures_import_matplotlib(path: Path) -> None:
    drawing = ("rkhs_ros/pictures", "rkhs_ros/view", "rkhs_ros/paper")
    if not path.relative_to(ROOT).as_posix().startswith(drawing):
        tree = ast.parse(path.read_text())
        loaded = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
        names = {alias.name for node in loaded for alias in node.names} | {
            node.module or "" for node in loaded if isinstance(node, ast.ImportFrom)
        }
        assert not [name for name in names if within(name, "matplotlib")]


@pytest.mark.parametrize("path", [p for p in SOURCES if not is_node(p)], ids=lambda path: str(path.relative_to(ROOT)))
def test_only_nodes_import_ros(path: Path) -> None:
    assert not [name for name in imports(path) for package in ROS if within(name, package)]


@pytest.mark.parametrize(
    "path",
    sorted(p for folder in ("envs", "pr2") for p in (ROOT / "sim_nodes" / folder).rglob("*.py")),
    ids=lambda path: path.name,
)
def test_tasks_do_not_import_rkhs_ros(path: Path) -> None:
    assert not [name for name in imports(path) if within(name, "rkhs_ros")]


@over_everything
def test_random_numbers_come_from_explicit_streams(path: Path) -> None:
    assert not [name for name in imports(path) if within(name, "random")]
    from_numpy = {name.removeprefix("numpy.random.") for name in imports(path) if name.startswith("numpy.random.")}
    assert from_numpy <= EXPLICIT_STREAMS
    for node in ast.walk(ast.parse(path.read_text())):
        match node:
            case ast.Attribute(value=ast.Attribute(value=ast.Name(id="np" | "numpy"), attr="random"), attr=name):
                assert name in EXPLICIT_STREAMS, f"np.random.{name} in line {node.lineno}"
            case ast.Call(func=ast.Attribute(attr="default_rng"), args=args):
                assert args, f"a stream without a seed in line {node.lineno}"


def asserts(path: Path) -> Iterator[int]:
    return (node.lineno for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Assert))


@over_sources
def test_package_code_has_no_assert(path: Path) -> None:
    assert not list(asserts(path))
