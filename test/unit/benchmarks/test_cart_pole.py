"""The cart-pole table of docs/tasks.md contains the numbers of the curves beside it."""

from collections.abc import Callable, Iterable
from pathlib import Path

from cart_pole import Row, read, summary

ROOT = Path(__file__).parents[3]
RUNS = read(ROOT / "docs" / "results" / "cart_pole.csv")


def first(rows: Iterable[Row], good: Callable[[Row], bool]) -> str:
    """Return the number of episodes after which an iteration is good first."""
    return next((str(row.episodes) for row in rows if good(row)), "never")


def test_the_table_has_the_numbers_of_the_curves() -> None:
    page = (ROOT / "docs" / "tasks.md").read_text()
    lines = {
        "Seed": [str(seed) for seed in RUNS],
        "episodes until success": [first(rows, lambda row: row.succeeds) for rows in RUNS.values()],
        "episodes until an undiscounted return of 45": [
            first(rows, lambda row: row.undiscounted_return >= 45) for rows in RUNS.values()
        ],
    }
    for name, cells in lines.items():
        assert f"| {name} | {' | '.join(cells)} |" in page
    assert summary(RUNS).endswith("median of the first success: 6 episodes")
    assert "The median is 6 episodes" in page


def test_iterations_after_the_first_success_succeed_as_stated() -> None:
    later = []
    for rows in RUNS.values():
        successes = [row.succeeds for row in rows]
        later += successes[successes.index(True) + 1 :] if any(successes) else []
    page = " ".join((ROOT / "docs" / "tasks.md").read_text().split())
    assert all(later)
    assert f"All {len(later)} iterations after the first success succeeded, too." in page
