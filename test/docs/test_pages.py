"""The code blocks of the documentation run, and its links have targets."""

import runpy
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from urllib.parse import unquote

import domain_coordinator
import numpy as np
import pytest

from rkhs_ros.app.cli import parsed
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import policy_arrays
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from test.docs.pages import (
    INTO,
    NOT_RUN,
    PAGES,
    ROOT,
    RUN,
    TIMEOUT_S,
    Block,
    anchors,
    blocks,
    commands,
    links,
    run_page,
)

# The pages that a first user follows. The others run before a release.
FIRST = ("README", "start", "library", "custom_task", "custom_algorithm", "your_robot", "recordings", "other_learners")
WITH_CODE = [
    pytest.param(page, marks=pytest.mark.ci if page.stem in FIRST else pytest.mark.nightly)
    for page in PAGES
    if any(block.is_run for block in blocks(page))
]


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Set a free ROS domain for the nodes that a page starts."""
    with domain_coordinator.domain_id() as number:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
        yield number


@pytest.mark.ros
@pytest.mark.timeout(TIMEOUT_S + 20)
@pytest.mark.parametrize("page", WITH_CODE, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_code_blocks_of_a_page_run(page: Path, tmp_path: Path, domain: int) -> None:
    result = run_page(page, tmp_path)
    assert result.returncode == 0, f"{result.stdout}\n{result.stderr}"


@pytest.mark.parametrize("page", [page for page in PAGES if page.stem not in FIRST], ids=lambda page: page.stem)
def test_the_commands_and_the_python_blocks_of_a_page_are_valid(page: Path) -> None:
    for block in blocks(page):
        if block.language == "python" and not INTO.fullmatch(block.comment):
            compile(block.code, f"{page.name}:{block.line}", "exec")
        for command in commands(block) if block.language == "bash" else ():
            try:
                parsed(command)
            except ValueError as error:
                pytest.fail(f"{page.name}:{block.line}: rkhs {' '.join(command)}: {error}")


def test_commands_of_a_block_are_found_and_invalid_ones_rejected() -> None:
    code = "A=1 rkhs list  # a comment\nmkdir a && rkhs train x.yaml \\\n  --sed 3 > a/b\nls rkhs/ | cat\n"
    first, second = commands(Block("bash", code, "", 1))
    assert (first, second) == (["list"], ["train", "x.yaml", "--sed", "3"])
    parsed(first)
    with pytest.raises(ValueError, match="--sed"):
        parsed(second)


def test_a_block_that_fails_fails_the_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    for number, (language, code) in enumerate(
        [("python", "assert 1 == 2"), ("bash", "false\ntrue"), ("bash", "a | b")]
    ):
        page.write_text(f"# A page\n\n```{language}\n{code}\n```\n")
        folder = tmp_path / str(number)
        folder.mkdir()
        assert run_page(page, folder).returncode != 0


def test_a_block_that_is_not_run_states_why() -> None:
    def bad(block: Block) -> bool:
        return block.language in RUN and block.comment.startswith("<!-- not") and not NOT_RUN.fullmatch(block.comment)

    found = [f"{page}:{b.line}" for page in PAGES for b in blocks(page) if bad(b) or not b.language]
    assert found == []


def test_links_have_targets() -> None:
    broken = []
    for page, link in ((each, link) for each in PAGES for link in links(each)):
        if link.startswith(("http:", "https:", "mailto:")):
            continue
        name, _, anchor = unquote(link).partition("#")
        target = (page.parent / name).resolve() if name else page
        good = target.exists() and (not anchor or (target.suffix == ".md" and anchor in anchors(target)))
        broken += [] if good else [f"{page}: {link}"]
    assert broken == []


def test_the_page_of_settings_is_up_to_date() -> None:
    script = ROOT / "docs" / "make_settings.py"
    page = runpy.run_path(str(script))["page"]()
    assert (ROOT / "docs" / "settings.md").read_text() == page, "run python docs/make_settings.py"
    assert "`algorithm.centres` `80`" in page


def test_every_array_is_described() -> None:
    policy = Function.constant(RBF((1.0,)), 1, 1)
    spaces = Spaces.unbounded(1, 1)
    described = {
        "run_folder.md": [f.name for f in fields(Episodes)],
        "policy_file.md": [*policy_arrays(GaussianPolicy(policy, ConstantVariance(np.ones(1)))), *vars(spaces)],
    }
    for name, words in described.items():
        page = (ROOT / "docs" / name).read_text()
        assert [word for word in words if f"`{word}`" not in page] == []
