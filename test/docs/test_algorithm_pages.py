"""Each algorithm has a complete page, and the table of returns matches the reproduced figures."""

import re

import pytest

from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.iteration import Row
from test.docs.pages import ROOT, links

PAGES = ROOT / "docs" / "algorithms"
FIGURES = ("fig3-toy", "fig3-pendulum", "fig5-pomdp")  # the columns of the table of returns
LABELS = {
    "rkhs_nac": "RKHS-NAC",
    "rkhs_npg": "RKHS-NPG",
    "rkhs_power": "RKHS-PoWER",
    "rkhs_ac": "RKHS-AC",
    "enac": "eNAC",
    "power": "PoWER",
    "ac": "AC",
}
SECTIONS = ("Update", "Settings", "Deviations from the paper", "Reproduction")


def returns(figure: str) -> dict[str, str]:
    """Return the final returns of a figure by the label of the curve."""
    section = (ROOT / "docs" / "results.md").read_text().split(f"\n## {figure}\n")[1].split("\n## ")[0]
    rows = (line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("| "))
    return {cells[-4]: cells[-3] for cells in rows}


@pytest.mark.parametrize("name", ALGORITHMS)
def test_an_algorithm_has_a_complete_page(name: str) -> None:
    page = PAGES / f"{name}.md"
    text, targets = page.read_text(), set(links(page))
    source = f"../../{ALGORITHMS[name].__module__.replace('.', '/')}.py"
    assert {source, f"../settings.md#{name}"} <= targets
    assert f"{name}.md" in set(links(PAGES / "index.md"))
    assert [section for section in SECTIONS if f"\n## {section}\n" not in text] == []


def test_every_metric_has_a_formula() -> None:
    text = (PAGES / "metrics.md").read_text()
    assert [name for name in Row._fields if f"`{name}`" not in text] == []


def test_the_table_of_returns_matches_the_results() -> None:
    index = (PAGES / "index.md").read_text()
    expected = [returns(figure) for figure in FIGURES]
    for name, label in LABELS.items():
        row = re.search(rf"^\| `{name}` \|(.*)\|$", index, re.MULTILINE)
        assert row is not None
        assert [cell.strip() for cell in row[1].split("|")] == [figure.get(label, "") for figure in expected]
