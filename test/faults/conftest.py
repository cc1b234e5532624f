"""Fixtures of the tests that break runs, which take minutes: for a release, unless they are marked for CI."""

from pathlib import Path

import pytest

from test.ros.conftest import ROOT, Process, domain, parameters, start

__all__ = ["domain", "parameters", "start"]
PENDULUM = ROOT / "config" / "pendulum_nac.yaml"


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run the pendulum in one process; other tests show that a run over topics is bit-identical."""
    folder = tmp_path_factory.mktemp("runs") / "undisturbed"
    process = Process("rkhs", "train", PENDULUM, "--quiet", "--runner", "inline", "--out", folder)
    assert process.finish()[0] == 0
    return folder


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--kills", type=int, default=40, help="kills in all of the test that kills nodes")


@pytest.fixture
def kills(request: pytest.FixtureRequest) -> int:
    return int(request.config.getoption("--kills"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents and "ci" not in item.keywords:
            item.add_marker(pytest.mark.nightly)
