"""The glossary lists terms that are in use, in order."""

import re

from test.docs.pages import PAGES, ROOT

GLOSSARY = ROOT / "docs" / "glossary.md"
SOURCES = [path for package in ("rkhs_ros", "sim_nodes") for path in sorted((ROOT / package).rglob("*.py"))]
TEXTS = [*SOURCES, *(page for page in PAGES if page != GLOSSARY)]


def terms() -> dict[str, str]:
    _, _, *rows = re.findall(r"^\| *(.+?) *\| *(.+?) *\|$", GLOSSARY.read_text(), re.MULTILINE)
    return dict(rows)


def words(text: str) -> str:
    """Return a text in lower case with single spaces, with names split into words."""
    return " ".join(text.replace("_", " ").lower().split())


def test_the_terms_are_sorted_and_have_one_line_each() -> None:
    names = list(terms())
    assert len(names) > 20
    assert names == sorted(names, key=str.lower)
    assert len(names) == GLOSSARY.read_text().count("\n| ") - 1


def test_every_term_is_used() -> None:
    used = words(" ".join(path.read_text() for path in TEXTS))
    assert [term for term in terms() if not re.search(rf"(?<!\w){re.escape(term.lower())}s?(?!\w)", used)] == []
