"""The measurements of benchmarks/configurations.py, and the pages that quote them."""

import math
import re
from pathlib import Path

from configurations import Result, as_markdown, names, read_results, result_of, summaries

ROOT = Path(__file__).parents[3]
FILE = ROOT / "docs" / "results" / "configurations.csv"
CHOSEN_ON = range(100)  # seeds that may have been used to choose settings


def text_of(page: str) -> str:
    return " ".join((ROOT / page).read_text().split())


def median(name: str) -> str:
    """Return the median episodes until each threshold, as in "2 / 3"."""
    return " / ".join(f"{each.value:g}" for each in summaries(read_results(FILE))[name].until)


def test_episodes_are_counted_until_a_return_reaches_a_threshold() -> None:
    curve = [(5, 44.0), (10, 45.0), (15, 45.1), (20, 30.0), (25, 49.0)]
    assert result_of("a", 100, (45.0, 50.0), curve) == Result("a", 100, 25, 49.0, 10.0, math.inf)


def test_seeds_that_never_reach_a_threshold_are_counted() -> None:
    until = (3.0, 4.0, math.inf, math.inf, 2.0)
    results = [Result("pendulum_nac", seed, 10, 50.0, each, 3.0) for seed, each in enumerate(until, 100)]
    assert "| 100 to 104 | 4 [2, inf] | 2 never | 3 [3, 3] | 3 |" in as_markdown(results)


def test_the_documentation_gives_results_of_held_out_seeds() -> None:
    seeds: dict[str, list[int]] = {}
    for result in read_results(FILE):
        seeds.setdefault(result.name, []).append(result.seed)
    assert not {seed for each in seeds.values() for seed in each} & set(CHOSEN_ON)
    assert min(map(len, seeds.values())) >= 10
    assert set(seeds) == set(names())


def test_the_page_of_configurations_has_the_tables_of_the_results() -> None:
    assert as_markdown(read_results(FILE)) in (ROOT / "docs" / "configurations.md").read_text()


def test_the_output_of_the_demo_shows_the_results_without_a_model() -> None:
    ((of_45, of_50),) = re.findall(
        r"([\d.]+) real episodes to reach 45, and ([\d.]+) to reach 50", text_of("docs/start.md")
    )
    assert median("pendulum_wrap_few_nac") == f"{of_45} / {of_50}"
