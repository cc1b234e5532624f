"""Configuration files: ROS parameter files, read alike by the nodes and by the in-process runner."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from rkhs_ros.base.parameter_files import PARAMETERS, read_sections
from rkhs_ros.base.settings import Entry, entries
from rkhs_ros.base.validation import hint, require, shown
from rkhs_ros.base.yaml_text import loaded, require_ros_value
from rkhs_ros.learning.training_settings import Training, training_from
from rkhs_ros.policies.storage import Task
from rkhs_ros.runs.any_task import settings_for

ENVIRONMENT = re.compile(r"-v\d+$")  # as ids of Gymnasium end
MOST_ROWS = 10_000
# Of each node, what is no setting of a run.
OF_ANY_NODE = {"use_sim_time", "start_type_description_service", "qos_overrides", "restarts", "instance"}
NODE_PARAMETERS = {
    "simulator": OF_ANY_NODE | {"robot_state"},
    "policy": OF_ANY_NODE | {"simulators", "policy_file"},
    "learner": OF_ANY_NODE | {"output", "quiet", "resume", "record"},
}


@dataclass(frozen=True)
class Environment:
    """The simulator's settings.

    Attributes:
        id: Gymnasium id of an environment with continuous actions.
        options: keyword options of the environment.
        rows_at_once: rows side by side at most, as 1 of a robot; 0 for as many as the environment allows.
    """

    id: str
    options: Mapping[str, Any]
    rows_at_once: int = 0

    def __post_init__(self) -> None:
        """Raise ValueError where the options are not a section, or the rows no number."""
        good = type(self.rows_at_once) is int and 0 <= self.rows_at_once <= MOST_ROWS
        require(good, "environment.rows_at_once", f"a whole number in [0, {MOST_ROWS}]", repr(self.rows_at_once))
        require(isinstance(self.id, str), "environment.id", "text", repr(self.id))
        require(isinstance(self.options, Mapping), "environment.options", "a section of keys", repr(self.options))

    def entries(self) -> Iterator[Entry]:
        """Walk through the settings by their dotted names."""
        yield Entry("environment.id", self.id, {"description": "Gymnasium id of the environment"})
        rows = {"description": "rows side by side at most; 0 for as many as the environment allows", "minimum": 0}
        yield Entry("environment.rows_at_once", self.rows_at_once, rows | {"maximum": MOST_ROWS})
        for name, value in _leaves(self.options):
            about = {"description": f"option that {self.id} is made with"}
            yield Entry(f"environment.options.{name}", value, about)


@dataclass(frozen=True)
class Config:
    """A whole run: where it learns and how."""

    environment: Environment
    training: Training

    @property
    def task(self) -> Task:
        """What the policy is learnt on."""
        training = self.training
        return Task(self.environment.id, dict(self.environment.options), training.horizon, training.discount)

    @property
    def settings(self) -> dict[str, Any]:
        """All settings by their dotted names."""
        options = {f"environment.options.{name}": value for name, value in self.environment.options.items()}
        learner = {entry.name: entry.value for entry in entries(self.training)}
        return {"environment.id": self.environment.id, **options, **learner}

    def check_for_topics(self) -> None:
        """Raise ValueError where a setting cannot be a ROS parameter, as an option of the environment's may be."""
        require_ros_value(self.training.name, "name")
        require_ros_value(self.environment.id, "environment.id")
        require_ros_value(self.environment.options, "environment.options")

    def parameters(self) -> dict[str, Any]:
        """Return all settings as the tree of a ROS parameter file."""
        environment: dict[str, Any] = {"id": self.environment.id}
        if self.environment.rows_at_once:
            environment["rows_at_once"] = self.environment.rows_at_once
        if self.environment.options:
            environment["options"] = dict(self.environment.options)
        learner: dict[str, Any] = {}
        for name, value, _ in entries(self.training):
            _insert(learner, name, list(value) if isinstance(value, tuple) else value)
        return {
            "/**/simulator": {PARAMETERS: {"environment": environment}},
            "/**/learner": {PARAMETERS: learner},
        }


def _leaves(tree: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Walk through what is no section, by dotted names."""
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}.{rest}", leaf) for rest, leaf in _leaves(value))
        else:
            yield name, value


def environment_from(tree: Any) -> Environment:
    """Return the simulator's settings from a tree of values.

    Raises:
        ValueError: an unknown key, no id, or no section at all.
    """
    known = {f.name: f for f in fields(Environment)}
    require(isinstance(tree, Mapping), "environment", "a section of keys", repr(tree))
    for key in tree:
        if key not in known:
            raise ValueError(f"unknown key 'environment.{key}', {hint(str(key), known, 'environment.')}")
    require("id" in tree, "environment", "a key 'id' with a Gymnasium id", dict(tree))
    return Environment(tree["id"], tree.get("options", {}), tree.get("rows_at_once", 0))


def load_config(path: Path, changes: Iterable[str] = ()) -> Config:
    """Read a configuration file.

    Args:
        path: a ROS parameter file with the sections ``/**/simulator`` and ``/**/learner``; others that name these nodes
            do as well. The learner's may hold the environment, too, as that of a learner which was told what to expect.
        changes: settings that replace the file's, as ``algorithm.ridge=0.1``.

    Raises:
        ValueError: not such a file, or settings that are unknown or do not fit.
        OSError: the file cannot be read.
    """
    if path.is_dir():
        remedy = f"; go on with a run by --resume {path}" * (path / "config.yaml").is_file()
        raise ValueError(f"{path}: expected a configuration's file, got a folder{remedy}")
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such configuration, {_nearest(path)}")
    sections = _sections(path)
    tree = {"name": path.stem, **sections["learner"], "environment": _environment(path, sections)}
    unknown = [key for key in sections["simulator"] if key != "environment"]
    require(not unknown, f"{path}: simulator", "the key 'environment'", ", ".join(map(str, unknown)))
    return _changed(tree, changes)


def _environment(path: Path, sections: Mapping[str, Mapping[str, Any]]) -> Any:
    """Return the environment's section, of the simulator or of the learner.

    Raises:
        ValueError: both have one, and they differ.
    """
    given = [sections[node]["environment"] for node in ("simulator", "learner") if "environment" in sections[node]]
    if len(given) == 2:
        simulated, expected = map(environment_from, given)
        require(simulated == expected, f"{path}: learner: environment", f"the simulator's, {simulated}", expected)
    return given[0] if given else {}


def _nearest(path: Path) -> str:
    """Return a hint at the configurations with the nearest names, beside the one asked for or in config/."""
    found = {file.stem: file for folder in (Path("config"), path.parent) for file in folder.glob("*.yaml")}
    if near := get_close_matches(path.stem, found, n=1):
        return f"did you mean '{found[near[0]]}'?"
    return "nor one of a like name" + f"; an environment is given as --env {path}" * bool(ENVIRONMENT.search(str(path)))


def config_for(environment: str, horizon: int | None, changes: Iterable[str] = ()) -> Config:
    """Return the configuration of a run on an environment that nobody tuned the settings for.

    Args:
        environment: Gymnasium id.
        horizon: steps of an episode; the default where None.
        changes: settings that replace these, as ``algorithm.ridge=0.1``.

    Raises:
        ValueError: settings that are unknown or do not fit.
    """
    name = re.sub(r"\W+", "_", environment.rpartition(":")[2]).strip("_").lower()
    changes = list(changes)
    algorithm = tree_of(changes).get("algorithm", {})
    chosen = algorithm.get("name", "rkhs_nac") if isinstance(algorithm, Mapping) else "rkhs_nac"
    tree = {"name": name or "run", "environment": {"id": environment}, **settings_for(str(chosen))}
    return _changed(tree | ({"horizon": horizon} if horizon else {}), changes)


def _changed(tree: dict[str, Any], changes: Iterable[str]) -> Config:
    """Return the configuration of a tree of settings with some of them replaced."""
    tree = tree_of(changes, tree)
    environment = environment_from(tree.pop("environment"))
    return Config(environment, training_from(tree))


def tree_of(changes: Iterable[str], tree: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return a tree of settings with some of them replaced.

    Args:
        changes: settings, as ``algorithm.ridge=0.1``.
        tree: the settings before; none where None.

    Raises:
        ValueError: a change is of another form.
    """
    changed = dict(tree or {})
    for change in changes:
        name, equals, text = change.partition("=")
        require(bool(name and equals), "--set", "KEY=VALUE", f"'{change}'")
        try:
            value = loaded(text)
        except ValueError as error:
            raise ValueError(f"--set: expected a value in YAML, got {shown(repr(change))}") from error
        _insert(changed, name.strip(), value)
    return changed


def _sections(path: Path) -> dict[str, dict[str, Any]]:
    """Return the settings of simulator and learner, whatever the namespaces that the file gives them.

    Parameters that are a node's own, as ``ros2 param dump`` writes them, are left out.
    """
    found: dict[str, dict[str, Any]] = {}
    for name, parameters in read_sections(path).items():
        node = name.rpartition("/")[2]
        if node not in NODE_PARAMETERS:
            raise ValueError(f"{path}: unknown section '{shown(name)}', {hint(node, NODE_PARAMETERS)}")
        settings = {key: value for key, value in parameters.items() if key not in NODE_PARAMETERS[node]}
        require(found.setdefault(node, settings) == settings, f"{path}: {node}", "one task for all", "several")
    return {"simulator": {}, "learner": {}} | found


def _insert(tree: dict[str, Any], name: str, value: Any) -> None:
    """Put a value at a dotted name; the sections on the way are copied, not edited."""
    head, dot, rest = name.partition(".")
    if not dot:
        tree[head] = value
        return
    section = tree.get(head, {})
    require(isinstance(section, dict), head, "a section of keys", repr(section))
    tree[head] = dict(section)
    _insert(tree[head], rest, value)
