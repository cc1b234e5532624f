"""The layout for Foxglove shows topics that there are, in panels that Foxglove knows."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rkhs_ros.recordings.definitions import PACKAGE, store

ROOT = Path(__file__).parents[2]
LAYOUT = json.loads((ROOT / "docs" / "foxglove_layout.json").read_text())
PANELS = {"3D", "Plot", "DiagnosticSummary", "StateTransitions", "RawMessages"}
MESSAGES = {"/progress": "LearningProgress", "/gate/state": "GateState", "/rkhs/events": "LearningEvent"}
OF_OTHERS = {"/learning_markers", "/diagnostics"}


def panels(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        assert layout["direction"] in ("row", "column")
        yield from (*panels(layout["first"]), *panels(layout["second"]))


def paths(value: Any) -> Iterator[str]:
    """Yield all texts and keys of a configuration that name a topic."""
    if isinstance(value, str) and value.startswith("/"):
        yield value
    elif isinstance(value, dict):
        for key, each in value.items():
            yield from (*paths(key), *paths(each))
    elif isinstance(value, list):
        for each in value:
            yield from paths(each)


def test_every_panel_has_a_place_and_is_known() -> None:
    shown = list(panels(LAYOUT["layout"]))
    assert sorted(shown) == sorted(LAYOUT["configById"])
    assert {name.partition("!")[0] for name in shown} == PANELS


def test_every_path_names_a_topic_and_a_field() -> None:
    named = set(paths(LAYOUT["configById"]))
    assert {*MESSAGES, *OF_OTHERS} <= {path.partition(".")[0] for path in named}
    page = (ROOT / "docs" / "nodes.md").read_text()
    for path in named:
        topic, _, field = path.partition(".")
        if topic in OF_OTHERS:
            assert not field
        elif field:
            kinds = {name: about[0].name for name, about in store().fielddefs[PACKAGE + MESSAGES[topic]][1]}
            name, sliced = re.fullmatch(r"(\w+)(\[:\])?", field).groups()  # type: ignore[union-attr]
            assert (kinds[name] == "SEQUENCE") == bool(sliced), path
        assert f"`{topic}`" in page or f"`{topic[1:]}`" in page
