"""Experiments: curves to compare and their numbers of runs, from files in config/experiments/."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rkhs_ros.base.validation import pick, require
from rkhs_ros.base.yaml_text import read_yaml
from rkhs_ros.runs.config import Config, load_config

BANDS = ("confidence", "sd")


@dataclass(frozen=True)
class Curve:
    """A curve of a figure: runs with equal settings.

    Attributes:
        label: name of the curve in the figure.
        config: configuration file.
        changes: settings that replace the file's, such as ``algorithm.ridge=0.1``; ``{run}`` is the number of the run.
    """

    label: str
    config: Path
    changes: tuple[str, ...]

    def run(self, number: int) -> Config:
        """Return the configuration of a run, whose number is also its seed."""
        changes = [change.replace("{run}", str(number)) for change in self.changes]
        return load_config(self.config, [*changes, f"name={self.label!r}", f"seed={number}"])


@dataclass(frozen=True)
class Panel:
    """A plot with several curves."""

    title: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class Experiment:
    """An experiment, shown in one figure.

    Attributes:
        name: name of its file.
        title: title of the figure.
        runs: number of independent runs of each curve.
        band: band around the mean: its 95 % "confidence" interval, or the "sd" of the runs.
        panels: plots, from left to right.
    """

    name: str
    title: str
    runs: int
    band: str
    panels: tuple[Panel, ...]


def folder() -> Path:
    """Return the folder of the experiment files, in the source tree or in the installed share folder.

    Raises:
        FileNotFoundError: the folder is missing in both.
    """
    for parent in Path(__file__).resolve().parents:
        for place in (parent / "config" / "experiments", parent / "share" / "rkhs_ros" / "config" / "experiments"):
            if place.is_dir():
                return place
    raise FileNotFoundError(
        "config/experiments: expected a folder beside the sources or under share/rkhs_ros, got none"
    )


def known() -> dict[str, Path]:
    """Return the files of the experiments by name."""
    return {path.stem: path for path in sorted(folder().glob("*.yaml"))}


def load_experiment(name: str) -> Experiment:
    """Read an experiment by name.

    Raises:
        ValueError: the name is unknown, or the file is not an experiment.
    """
    path = pick(name, known(), "experiment")
    tree = _section(read_yaml(path), ("title", "runs", "band", "panels"), str(path))
    require(tree["band"] in BANDS, f"{path}: band", f"one of {', '.join(BANDS)}", tree["band"])
    panels = tuple(_panel(panel, path) for panel in tree["panels"])
    return Experiment(name, str(tree["title"]), int(tree["runs"]), str(tree["band"]), panels)


def _panel(tree: Any, path: Path) -> Panel:
    tree = _section(tree, ("title", "curves"), f"{path}: panel", ("set",))
    common = tree.get("set", [])
    return Panel(str(tree["title"]), tuple(_curve(curve, common, path) for curve in tree["curves"]))


def _curve(tree: Any, common: list[str], path: Path) -> Curve:
    tree = _section(tree, ("label", "config"), f"{path}: curve", ("set",))
    changes = tuple(str(change) for change in [*common, *tree.get("set", [])])
    return Curve(str(tree["label"]), path.parents[1] / f"{tree['config']}.yaml", changes)


def _section(tree: Any, needed: tuple[str, ...], what: str, more: tuple[str, ...] = ()) -> Mapping[str, Any]:
    if not isinstance(tree, Mapping):
        raise ValueError(f"{what}: expected a section of keys, got {tree!r}")
    missing = [key for key in needed if key not in tree]
    unknown = [key for key in tree if key not in (*needed, *more)]
    require(not missing and not unknown, what, f"the keys {', '.join((*needed, *more))}", ", ".join(map(str, tree)))
    return tree
