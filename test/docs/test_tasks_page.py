"""The figures of the page of tasks are those of its curves."""

import csv
import re
from itertools import groupby
from statistics import median

from test.docs.pages import ROOT

PAGE = ROOT / "docs" / "tasks.md"
CURVES = ROOT / "docs" / "results" / "defaults.csv"
ROW = re.compile(
    r"\| `(\S+)` \| ([^|]+) \| (\d+) to (\d+) \| ([^|]+) \| ([\d.]+|inf) [^|]*\| [^|]+ \| (\d+) of (\d+) \|"
)
BALANCED = "18 of 20 episodes are balanced"


def holds(line: dict[str, str], criterion: str) -> bool:
    if criterion == BALANCED:
        return float(line["balanced"]) >= 0.9
    return float(line["undiscounted_return"]) >= float(criterion.replace("\u2212", "-").removeprefix("at least "))


def test_the_table_of_the_defaults_agrees_with_the_curves() -> None:
    with CURVES.open(newline="") as file:
        lines = list(csv.DictReader(file))
    curves = {key: list(group) for key, group in groupby(lines, lambda line: (line["task"], int(line["seed"])))}
    rows = ROW.findall(PAGE.read_text())
    assert {row[0] for row in rows} == {task for task, _ in curves}
    for task, criterion, first, last, episodes, middle, kept, later in rows:
        runs = [curve for (name, seed), curve in curves.items() if name == task and int(first) <= seed <= int(last)]
        assert len(runs) == int(last) - int(first) + 1
        good = [[holds(line, criterion) for line in run] for run in runs]
        begins = [each.index(True) if True in each else None for each in good]
        counts = [float("inf") if i is None else float(run[i]["episodes"]) for i, run in zip(begins, runs, strict=True)]
        assert [f"{count:g}" if count < float("inf") else "never" for count in counts] == episodes.split(", "), task
        assert median(counts) == float(middle)
        after = [each[i + 1 :] for i, each in zip(begins, good, strict=True) if i is not None]
        assert (sum(map(sum, after)), sum(map(len, after))) == (int(kept), int(later))
