"""The glossary lists terms that are in use, and retired words do not occur."""

import re
from collections.abc import Iterator
from pathlib import Path

from test.docs.pages import PAGES, ROOT

GLOSSARY = ROOT / "docs" / "glossary.md"
SOURCES = [path for package in ("rkhs_ros", "sim_nodes") for path in sorted((ROOT / package).rglob("*.py"))]
TEXTS = [*SOURCES, *(page for page in PAGES if page != GLOSSARY)]
FOLDERS = ("rkhs_ros", "rkhs_interfaces", "sim_nodes", "launch", "config", "benchmarks", "docs", "test")
KINDS = (".py", ".md", ".rst", ".yaml", ".json", ".ipynb", ".svg", ".msg", ".srv")
FILES = [
    path
    for folder in FOLDERS
    for path in sorted((ROOT / folder).rglob("*"))
    if path.suffix in KINDS and "_build" not in path.parts
]

# Patterns of whole words. A letter in brackets keeps a text search from matching this list.
RETIRED_NAMES = [
    r"Model[P]ractice",
    r"No[P]ractice",
    r"[P]racticeRobotNode",
    r"[P]racticeLink",
    r"practice_[r]obots?",
    r"practi[c]e\.(form|iterations|episodes|centres|narrow|noise|reward|end|change|\w+_decay|exploration_minimum)",
    r"is_[p]ractising",
    r"World[M]odel",
    r"world_[m]odel",
    r"Known[P]arts",
    r"known_[p]arts",
    r"Imagined[R]unner",
    r"(last_)?imagined_[r]eturns?",
    r"(last_)?train_[r]eturns?(_sd)?",
    r"(last_)?mean_policy_[r]eturns?",
    r"(are_)?places_[a]like",
    r"_made_[r]eady",
    r"best_[s]tretched",
    r"best_[s]lice",
    r"rows_at_[o]nce",
    r"Separate[R]ows",
    r"Vector[R]ows",
    r"(_has_)?room_[f]or(_both)?(?=\()",
    r"Look[O]n",
    r"look_[o]n",
    r"look_[a]way",
    r"pass_[o]ver",
    r"told_(names|of_gate|of_nodes)(?=\()",
    r"tell_(fatal|failures|end|what_it_waits_for)(?=\()",
    r"(is_|first_)?noise_[f]ree",
    r"(is|make)_[v]oid",
    r"[v]oid_(reason|every|episodes?)",
    r"MOST_[V]OIDS",
    r"printed_[r]egression",
    r"require_all_[h]eeded",
    r"parse_[v]aried",
    r"user_[a]nswer",
    r"note_[h]orizon",
    r"surroundings_[k]ept",
    r"any_[t]ask",
    r"own_(task|kernel|algorithm)[.]md",
    r"Remote[W]orld",
    r"remote_[w]orld",
    r"Shows[M]otion",
    r"Robot[M]otion",
]
STREAM = 'stream_seed(experience.seed, "practice"'  # its name determines random numbers
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
    assert len(names) > 40
    assert names == sorted(names, key=str.lower)
    assert len(names) == GLOSSARY.read_text().count("\n| ") - 1


def test_every_term_is_used() -> None:
    used = words(" ".join(path.read_text() for path in TEXTS))
    assert [term for term in terms() if not re.search(rf"(?<!\w){re.escape(term.lower())}s?(?!\w)", used)] == []


def test_retired_words_are_in_no_page() -> None:
    uses = {page: list(found(RETIRED_WORDS, prose(page))) for page in PAGES}
    assert {str(page.relative_to(ROOT)): words for page, words in uses.items() if words} == {}


def test_retired_words_are_in_no_source() -> None:
    sources = [path for path in FILES if path.suffix in (".py", ".json") and path != Path(__file__)]
    uses = {path: list(found(RETIRED_WORDS, path.read_text().replace(STREAM, ""))) for path in sources}
    assert {str(path.relative_to(ROOT)): words for path, words in uses.items() if words} == {}


def test_retired_names_are_in_no_file() -> None:
    uses = {path: list(found(RETIRED_NAMES, path.read_text())) for path in [*FILES, *PAGES, ROOT / "CHANGELOG.rst"]}
    assert {str(path.relative_to(ROOT)): names for path, names in uses.items() if names} == {}


def test_only_whole_words_are_found() -> None:
    assert list(found([r"old_[n]ame"], "an old_name, old_names")) == ["old_name"]
    assert list(found([r"(?<!in )practi[cs]e"], "in practice, practise")) == ["practise"]
