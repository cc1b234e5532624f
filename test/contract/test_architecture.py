"""What may import what, read from the source."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LAYERS = ("rkhs", "policies", "learning", "experiments", "nodes")
ROS = ("rclpy", "rkhs_interfaces", "rcl_interfaces", "sensor_msgs", "std_msgs", "diagnostic_msgs", "rosgraph_msgs")
SOURCES = sorted(path for package in ("rkhs_ros", "sim_nodes") for path in (ROOT / package).rglob("*.py"))
EVERYTHING = sorted(
    [*SOURCES, *(p for folder in ("test", "benchmarks", "launch") for p in (ROOT / folder).rglob("*.py"))]
)
EXPLICIT_STREAMS = {"Generator", "Philox", "PCG64", "SeedSequence", "BitGenerator", "default_rng"}
over_sources = pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
over_everything = pytest.mark.parametrize("path", EVERYTHING, ids=lambda path: str(path.relative_to(ROOT)))


def imports(path: Path) -> set[str]:
    """Return the dotted names of all that a module imports, inside functions too."""
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
    """Return the place of a module in the order of layers; -1 for the package itself."""
    parts = path.relative_to(ROOT / "rkhs_ros").parts
    return LAYERS.index(parts[0]) if len(parts) > 1 else -1


def is_node(path: Path) -> bool:
    return path.is_relative_to(ROOT / "rkhs_ros" / "nodes") or path == ROOT / "sim_nodes" / "simulator_node.py"


def test_the_layers_are_all_there() -> None:
    packages = {path.parent.name for path in (ROOT / "rkhs_ros").glob("*/__init__.py")}
    assert packages == set(LAYERS)
    assert len(SOURCES) > 30


@pytest.mark.parametrize(
    "path", [p for p in SOURCES if p.is_relative_to(ROOT / "rkhs_ros")], ids=lambda path: str(path.relative_to(ROOT))
)
def test_layers_import_downwards_only(path: Path) -> None:
    above = LAYERS[layer(path) + 1 :]
    assert not [name for name in imports(path) for upper in above if within(name, f"rkhs_ros.{upper}")]


@pytest.mark.parametrize(
    "path",
    [p for p in SOURCES if p.is_relative_to(ROOT / "rkhs_ros") and layer(p) < LAYERS.index("experiments")],
    ids=lambda path: str(path.relative_to(ROOT)),
)
def test_learning_and_what_is_below_it_know_no_simulator(path: Path) -> None:
    assert not [name for name in imports(path) if within(name, "sim_nodes") or within(name, "gymnasium")]


@pytest.mark.parametrize("path", [p for p in SOURCES if not is_node(p)], ids=lambda path: str(path.relative_to(ROOT)))
def test_ros_is_imported_by_the_nodes_only(path: Path) -> None:
    assert not [name for name in imports(path) for package in ROS if within(name, package)]
    assert not [name for name in imports(path) if within(name, "rkhs_ros.nodes")]


@pytest.mark.parametrize("path", sorted((ROOT / "sim_nodes" / "envs").rglob("*.py")), ids=lambda path: path.name)
def test_the_tasks_know_nothing_of_learning(path: Path) -> None:
    assert not [name for name in imports(path) if within(name, "rkhs_ros")]


@over_everything
def test_random_draws_come_from_explicit_streams(path: Path) -> None:
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
def test_no_check_disappears_with_optimisation(path: Path) -> None:
    assert not list(asserts(path))
