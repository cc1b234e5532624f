"""Configuration files: ROS parameter files, which nodes and the in-process runner read alike."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from rkhs_ros.base.settings import Entry, build, entries
from rkhs_ros.base.validation import hint, prefixed, require, truncated
from rkhs_ros.base.yaml_text import OF_ANY_NODE, PARAMETERS, loaded, read_sections, require_ros_value
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.storage import Task
from rkhs_ros.runs.defaults import settings_for

ENVIRONMENT = re.compile(r"-v\d+$")  # end of a Gymnasium id
MOST_ENVS = 10_000
# Parameters of each node that are not settings of a run.
NODE_PARAMETERS = {
    "simulator": OF_ANY_NODE,
    "robot": OF_ANY_NODE | {"simulated"},
    "gate": OF_ANY_NODE,
    "simulated_robot": OF_ANY_NODE,
    "policy": OF_ANY_NODE | {"policy_file"},
    "learner": OF_ANY_NODE | {"output", "quiet", "resume", "tensorboard", "evaluate"},
}
ROBOT_NODES = ("robot", "gate", "simulated_robot")  # nodes that replace the simulator


@dataclass(frozen=True)
class Environment:
    """Environment of a run: the settings of a simulator, or of a robot's nodes.

    Attributes:
        id: Gymnasium id of an environment with continuous actions, or the name of a robot's task.
        options: keyword options of the environment.
        num_envs: maximum number of environments in a batch, 1 for a robot; 0 for as many as the environment allows.
        nodes: parameters of a robot's nodes by name; empty for a simulator.
    """

    id: str
    options: Mapping[str, Any]
    num_envs: int = 0
    nodes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ValueError if a value has another type or is out of range."""
        good = type(self.num_envs) is int and 0 <= self.num_envs <= MOST_ENVS
        require(good, "environment.num_envs", f"a whole number in [0, {MOST_ENVS}]", repr(self.num_envs))
        require(isinstance(self.id, str), "environment.id", "text", repr(self.id))
        require(isinstance(self.options, Mapping), "environment.options", "a section of keys", repr(self.options))
        require(isinstance(self.nodes, Mapping), "environment.nodes", "a section of keys", repr(self.nodes))
        for name, parameters in self.nodes.items():
            require(isinstance(parameters, Mapping), name, "a section of keys", repr(parameters))

    def tree(self) -> dict[str, Any]:
        """Return the settings as a tree of values, without those that have their defaults."""
        more = {name: getattr(self, name) for name in ("num_envs", "options", "nodes") if getattr(self, name)}
        return {"id": self.id, **more}

    def entries(self) -> Iterator[Entry]:
        """Walk through the settings by their dotted names."""
        yield Entry("environment.id", self.id, {"description": "Gymnasium id of the environment"})
        about = "maximum number of environments in a batch; 0 for as many as the environment allows"
        limits = {"description": about, "minimum": 0, "maximum": MOST_ENVS}
        yield Entry("environment.num_envs", self.num_envs, limits)
        for name, value in _leaves(self.options):
            yield Entry(f"environment.options.{name}", value, {"description": f"keyword option of {self.id}"})


@dataclass(frozen=True)
class Config:
    """Configuration of a run.

    Attributes:
        environment: settings of the environment.
        training: settings of the learner.
    """

    environment: Environment
    training: Training

    @property
    def task(self) -> Task:
        """Task of the policy."""
        training = self.training
        return Task(self.environment.id, dict(self.environment.options), training.horizon, training.discount)

    @property
    def settings(self) -> dict[str, Any]:
        """All settings by their dotted names."""
        options = {f"environment.options.{name}": value for name, value in self.environment.options.items()}
        robot = dict(_leaves({"robot": self.environment.nodes["robot"]})) if self.environment.nodes else {}
        learner = {entry.name: entry.value for entry in entries(self.training)}
        return {"environment.id": self.environment.id, **options, **robot, **learner}

    def check_for_topics(self) -> None:
        """Raise ValueError if a setting, such as an option of the environment, cannot be a ROS parameter."""
        values = {"name": self.training.name}
        values |= {f"environment.{name}": getattr(self.environment, name) for name in ("id", "options")}
        for name, value in {**values, **self.environment.nodes}.items():
            require_ros_value(value, name)

    def parameters(self) -> dict[str, Any]:
        """Return all settings as the tree of a ROS parameter file, which cannot contain empty lists."""
        learner: dict[str, Any] = {}
        for name, value, _ in entries(self.training):
            if value != ():
                _insert(learner, name, list(value) if isinstance(value, tuple) else value)
        nodes = self.environment.nodes or {"simulator": {"environment": self.environment.tree()}}
        return {f"/**/{name}": {PARAMETERS: parameters} for name, parameters in {**nodes, "learner": learner}.items()}


def _leaves(tree: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}.{rest}", leaf) for rest, leaf in _leaves(value))
        else:
            yield name, value


def environment_from(tree: Any) -> Environment:
    """Return the settings of a simulator from a tree of values.

    Raises:
        ValueError: a key is unknown, the id is missing, or the tree is not a section.
    """
    known = {f.name: f for f in fields(Environment)}
    require(isinstance(tree, Mapping), "environment", "a section of keys", repr(tree))
    for key in tree:
        if key not in known:
            raise ValueError(f"unknown key 'environment.{key}', {hint(str(key), known, 'environment.')}")
    require("id" in tree, "environment", "a key 'id' with a Gymnasium id", dict(tree))
    return Environment(**{"options": {}, **tree})


def load_config(path: Path, changes: Iterable[str] = ()) -> Config:
    """Read a configuration file.

    Args:
        path: a ROS parameter file with the sections ``/**/simulator`` and ``/**/learner``, or with these nodes in
            another namespace. The learner's section may also contain the environment that the learner expects. For a
            robot, ``/**/robot``, ``/**/gate`` and optionally ``/**/simulated_robot`` replace the simulator.
        changes: settings that replace the file's, such as ``algorithm.ridge=0.1``.

    Raises:
        ValueError: the file has another form, or a setting is unknown or invalid.
    """
    if path.is_dir():
        remedy = f". To resume a run, use --resume {path}" * (path / "config.yaml").is_file()
        raise ValueError(f"{path}: expected a configuration file, got a folder{remedy}")
    if not path.exists():
        remedy = f". For an environment, use --env {path}" if ENVIRONMENT.search(str(path)) else ""
        raise FileNotFoundError(f"{path}: no such configuration{remedy}")
    sections = _sections(path)
    with prefixed(path):
        _config_in(sections, path.stem, ())  # without the changes, whose errors do not name the file
    return _config_in(sections, path.stem, changes)


def config_of(configuration: str, changes: Iterable[str] = ()) -> Config:
    """Return the configuration in the header of a recording, with some settings replaced."""
    document = loaded(configuration)
    sections = {name.rpartition("/")[2]: section[PARAMETERS] for name, section in document.items()}
    return _config_in(sections, "run", changes)


def _config_in(sections: Mapping[str, dict[str, Any]], name: str, changes: Iterable[str]) -> Config:
    """Return the configuration in the sections of a file, with a default for its name and some settings replaced."""
    robot = {node: sections[node] for node in ROBOT_NODES if node in sections}
    learner, simulator = sections["learner"], sections.get("simulator", {})
    tree = {"name": name, **learner}
    if robot:
        require("simulator" not in sections, "sections", "either a simulator or a robot", "both")
        missing = [node for node in ROBOT_NODES[:2] if node not in robot]
        require(not missing, "sections", "/**/robot and /**/gate", f"no {', no '.join(missing)}")
        require(bool(learner), "sections", "/**/learner, which is required for robots", "none")
        tree.pop("environment", None)  # which the learner expects
        tree = tree_of(changes, tree | robot)
        require("environment" not in tree, "environment", "no settings of a simulator for a robot", "some")
        nodes = {node: tree.pop(node) for node in robot}
        require(isinstance(nodes["robot"], Mapping), "robot", "a section of keys", repr(nodes["robot"]))
        environment = Environment(nodes["robot"].get("task", "robot"), {}, 1, nodes)
    else:
        unknown = [key for key in simulator if key != "environment"]
        require(not unknown, "simulator", "the key 'environment'", ", ".join(map(str, unknown)))
        tree = tree_of(changes, {"environment": {}} | tree | simulator)
        environment = environment_from(tree.pop("environment"))
        require(not environment.nodes, "environment.nodes", "none for a simulator", "some")
    return Config(environment, build(Training, tree))


def config_for(environment: str, horizon: int | None, changes: Iterable[str] = ()) -> Config:
    """Return the configuration of a run on an environment with the default settings.

    A horizon of None stands for the default; changes are texts such as ``algorithm.ridge=0.1``.
    """
    changes = list(changes)
    chosen = tree_of(changes, {"algorithm": {"name": "rkhs_nac"}, "model": {"form": "gaussian_process"}})
    algorithm = _named(chosen, "algorithm", "name", "rkhs_nac")
    model = _named(chosen, "model", "form", "gaussian_process")
    steps = chosen.get("horizon", horizon or Training.horizon)
    tree = {"name": name_of_run(environment), **settings_for(algorithm, model, steps)}
    return _config_in({"learner": tree | {"environment": {"id": environment}}}, "run", changes)


def _named(tree: Mapping[str, Any], group: str, key: str, default: str) -> str:
    """Return the choice in a section of a tree of settings, or the default if the section contains none."""
    settings = tree[group]
    return str(settings.get(key, default)) if isinstance(settings, Mapping) else default


def name_of_run(environment: str) -> str:
    """Return the default name of a run on an environment, a valid folder name."""
    return re.sub(r"\W+", "_", environment.rpartition(":")[2]).strip("_").lower() or "run"


def tree_of(changes: Iterable[str], tree: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return a tree of settings with some of them replaced.

    Changes are texts such as ``algorithm.ridge=0.1``; no tree stands for an empty one.

    Raises:
        ValueError: a change is not ``KEY=VALUE`` with a value in YAML.
    """
    changed = dict(tree or {})
    for change in changes:
        name, equals, text = change.partition("=")
        require(bool(name and equals), "--set", "KEY=VALUE", f"'{change}'")
        try:
            value = loaded(text)
        except ValueError as error:
            raise ValueError(f"--set: expected a value in YAML, got {truncated(repr(change))}") from error
        _insert(changed, name.strip(), value)
    return changed


def _sections(path: Path) -> dict[str, dict[str, Any]]:
    """Return the settings of the nodes, in any namespace.

    Parameters that are not settings of a run, such as those that ``ros2 param dump`` adds, are omitted.
    """
    found: dict[str, dict[str, Any]] = {}
    for name, parameters in read_sections(path).items():
        node = name.rpartition("/")[2]
        if node not in NODE_PARAMETERS:
            raise ValueError(f"{path}: unknown section '{truncated(name)}', {hint(node, NODE_PARAMETERS)}")
        settings = {key: value for key, value in parameters.items() if key not in NODE_PARAMETERS[node]}
        same = found.setdefault(node, settings) == settings
        require(same, f"{path}: {node}", "equal sections in all namespaces", "different ones")
    return {"learner": {}} | found


def _insert(tree: dict[str, Any], name: str, value: Any) -> None:
    """Insert a value at a dotted name; copy the sections on the path instead of changing them."""
    head, dot, rest = name.partition(".")
    if not dot:
        tree[head] = value
        return
    section = tree.get(head, {})
    require(isinstance(section, dict), head, "a section of keys", repr(section))
    tree[head] = dict(section)
    _insert(tree[head], rest, value)
