"""Experiments: curves to compare and their numbers of runs, from files in config/experiments/."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rkhs_ros.base.validation import pick
from rkhs_ros.base.yaml_text import read_yaml
from rkhs_ros.runs.config import Config, load_config


@dataclass(frozen=True)
class Curve:
    """A curve of a figure: runs with equal settings."""

    label: str
    config: Path  # file
    changes: tuple[str, ...]  # of the file, such as ``algorithm.ridge=0.1``; ``{run}`` is the number of the run

    def run(self, number: int) -> Config:
        """Return the configuration of a run, whose number is also its seed."""
        changes = [change.replace("{run}", str(number)) for change in self.changes]
        return load_config(self.config, [*changes, f"name={self.label!r}", f"seed={number}"])


@dataclass(frozen=True)
class Experiment:
    """An experiment, shown in one figure."""

    name: str  # of its file
    title: str
    runs: int  # independent ones of each curve
    band: str  # around the mean: its 95 % "confidence" interval, or the "sd" of the runs
    panels: Mapping[str, tuple[Curve, ...]]  # curves of each plot by its title, from left to right


def folder() -> Path:
    """Return the folder of the experiment files, in the source tree or in the installed share folder."""
    parts = ("config/experiments", "share/rkhs_ros/config/experiments")
    places = (parent / part for parent in Path(__file__).resolve().parents for part in parts)
    found = next((place for place in places if place.is_dir()), None)
    if found is None:
        raise FileNotFoundError("config/experiments: expected it beside the sources or under share/rkhs_ros, got none")
    return found


def known() -> dict[str, Path]:
    """Return the files of the experiments by name."""
    return {path.stem: path for path in sorted(folder().glob("*.yaml"))}


def load_experiment(name: str) -> Experiment:
    """Read an experiment by name."""
    path = pick(name, known(), "experiment")
    tree = read_yaml(path)
    panels = {
        panel["title"]: tuple(_curve(each, panel.get("set", []), path) for each in panel["curves"])
        for panel in tree["panels"]
    }
    return Experiment(name, tree["title"], tree["runs"], tree["band"], panels)


def _curve(tree: Mapping[str, Any], common: list[str], path: Path) -> Curve:
    return Curve(tree["label"], path.parents[1] / f"{tree['config']}.yaml", (*common, *tree.get("set", [])))
