"""The notebook runs, and its stored outputs are up to date."""

import re
from pathlib import Path
from typing import Any

import pytest

from test.docs.pages import ROOT

nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
NOTEBOOK = ROOT / "docs" / "first_steps.ipynb"
NUMBER = re.compile(r"\d+\.\d+")


def outputs(notebook: Any) -> list[list[str]]:
    """Return the printed text of each code cell, or the kind of its other outputs."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [[output.get("text", output.output_type) for output in cell.outputs] for cell in cells]


@pytest.mark.nightly
def test_the_stored_outputs_of_the_notebook_are_reproduced(tmp_path: Path) -> None:
    stored = nbformat.read(NOTEBOOK, as_version=4)
    executed = nbformat.read(NOTEBOOK, as_version=4)
    for cell in executed.cells:
        if cell.cell_type == "code":
            cell.outputs = []
    nbclient.NotebookClient(executed, timeout=200, resources={"metadata": {"path": str(tmp_path)}}).execute()
    ours, theirs = str(outputs(executed)), str(outputs(stored))
    assert NUMBER.sub("", ours) == NUMBER.sub("", theirs)
    numbers, expected = ([float(number) for number in NUMBER.findall(text)] for text in (ours, theirs))
    assert numbers == pytest.approx(expected, abs=0.5)  # rounding depends on the processor
    assert sum(len(each) for each in outputs(stored)) >= 5
