"""The notebook runs, and what it shows is what comes out."""

from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

from test.docs.pages import ROOT

NOTEBOOK = ROOT / "docs" / "first_steps.ipynb"


def shown(notebook: Any) -> list[list[str]]:
    """Return what each cell of code prints, and the kinds of what else it shows."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [[output.get("text", output.output_type) for output in cell.outputs] for cell in cells]


@pytest.mark.pages
def test_the_notebook_gives_the_outputs_that_it_shows(tmp_path: Path) -> None:
    stored = nbformat.read(NOTEBOOK, as_version=4)
    executed = nbformat.read(NOTEBOOK, as_version=4)
    for cell in executed.cells:
        if cell.cell_type == "code":
            cell.outputs = []
    NotebookClient(executed, timeout=60, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert shown(executed) == shown(stored)
    assert sum(len(outputs) for outputs in shown(stored)) >= 5
