"""ROS domain of a run, and the file with it in the run's folder."""

import os
from pathlib import Path

import pytest

from rkhs_ros.app.launcher import DOMAIN, domain_of, reserved_domain
from rkhs_ros.base.files import locked


@pytest.fixture(autouse=True)
def undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(DOMAIN, raising=False)


def test_parallel_runs_have_distinct_domains_in_their_folders(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    with reserved_domain(one):
        assert domain_of(one) == int(os.environ.pop(DOMAIN))
        with reserved_domain(other):
            assert domain_of(other) == int(os.environ[DOMAIN]) != domain_of(one)
        os.environ[DOMAIN] = ""  # removed at the end
    assert DOMAIN not in os.environ
    for folder in (one, other):
        with pytest.raises(ValueError, match="expected the folder of an active run over topics, got none"):
            domain_of(folder)


def test_a_rejected_run_preserves_the_domain_of_the_active_one(tmp_path: Path) -> None:
    with reserved_domain(tmp_path):
        domain = domain_of(tmp_path)
        with (
            locked(tmp_path),  # like the learner of the run
            pytest.raises(ValueError, match="expected a free run folder, got one in use by another process"),
            reserved_domain(tmp_path),
        ):
            pass
        assert domain_of(tmp_path) == domain
