"""The glossary lists terms that are in use, and retired words occur on no page."""

import re
from collections.abc import Iterator
from pathlib import Path

from test.docs.pages import PAGES, ROOT

GLOSSARY = ROOT / "docs" / "glossary.md"
SOURCES = [path for package in ("rkhs_ros", "sim_nodes") for path in sorted((ROOT / package).rglob("*.py"))]
TEXTS = [*SOURCES, *(page for page in PAGES if page != GLOSSARY)]
# Patterns of whole words.
RETIRED_WORDS = [
    r"(?<!in )(?<!best )practi[cs]e",
    r"practi[cs](es|ed|ing)",
    r"imagine[ds]?",
    r"surpasse[ds]",
    r"surrounding[s]",
    r"voi[d] episodes?",
    r"noise[- ]fre[e]",
    r"(same bits|to the (last )?bit)",
]


def terms() -> dict[str, str]:
    """Return the terms of the glossary with their meanings."""
    _, _, *rows = re.findall(r"^\| *(.+?) *\| *(.+?) *\|$", GLOSSARY.read_text(), re.MULTILINE)
    return dict(rows)


def words(text: str) -> str:
    """Return a text in lower case with single spaces, with names split into words."""
    return " ".join(text.replace("_", " ").lower().split())


def prose(page: Path) -> str:
    """Return a page without code and link targets."""
    text = re.sub(r"```\w+\n.*?```", "", page.read_text(), flags=re.DOTALL)
    return re.sub(r"`[^`]*`|\]\([^)]*\)", "", text)


def found(patterns: list[str], text: str) -> Iterator[str]:
    for pattern in patterns:
        yield from (match[0] for match in re.finditer(rf"(?<!\w)(?:{pattern})(?!\w)", text, re.IGNORECASE))


def test_the_terms_are_sorted_and_have_one_line_each() -> None:
    names = list(terms())
    assert len(names) > 20
    assert names == sorted(names, key=str.lower)
    assert len(names) == GLOSSARY.read_text().count("\n| ") - 1


def test_every_term_is_used() -> None:
    used = words(" ".join(path.read_text() for path in TEXTS))
    assert [term for term in terms() if not re.search(rf"(?<!\w){re.escape(term.lower())}s?(?!\w)", used)] == []


def test_retired_words_are_in_no_page() -> None:
    uses = {page: list(found(RETIRED_WORDS, prose(page))) for page in PAGES}
    assert {str(page.relative_to(ROOT)): words for page, words in uses.items() if words} == {}
