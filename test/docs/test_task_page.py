"""The numbers of README and of the pages on tasks are those of the stored curves."""

import ablation
import descriptions
import task_table
import tasks
from test.docs.pages import ROOT
from trial import read_curves


def rows_of(text: str, begin: str) -> list[list[str]]:
    """Return the cells of the rows of tables in Markdown that begin with a text."""
    return [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith(begin)]


def test_table_and_page_are_those_of_the_stored_curves() -> None:
    cells = task_table.cells_of(read_curves(tasks.CURVES))
    assert task_table.TABLE.read_text() == task_table.text_of_table(cells)
    page = task_table.PAGE.read_text()
    assert page == task_table.page_with(task_table.summary(cells))
    rows = {row[0].split("`")[1]: row for row in rows_of(page, "| [")}
    quoted = [row for row in rows_of((ROOT / "README.md").read_text(), "| `") if row[0].strip("`") in rows]
    assert len(quoted) == 5
    for name, *figures in quoted:
        row = rows[name.strip("`")]
        assert figures == [*row[1:4], *row[5:7]]
    compared = task_table.PAGE.with_name("compared_with.md").read_text()
    shares = {row[0].strip("`"): int(row[4].split("%")[0]) for row in rows_of(page, "| `sac") if len(row) == 5}
    for learner, its in {"sac-held": "with held actions", "sac": "without held actions"}.items():
        assert f"{its}, in {100 - shares[learner]} % of" in " ".join(compared.split())


def test_the_table_of_the_ablation_is_that_of_its_stored_curves() -> None:
    assert (ablation.FILES / "table.csv").read_text() == ablation.table(read_curves(ablation.FILE))


def test_the_tables_of_the_descriptions_are_those_of_their_stored_curves() -> None:
    lines = descriptions.lines_of(read_curves(descriptions.FILE))
    assert descriptions.TABLE.read_text() == descriptions.table(lines)
    page = task_table.PAGE.read_text()
    assert page == task_table.page_with(descriptions.summary(lines), descriptions.BEGIN)
