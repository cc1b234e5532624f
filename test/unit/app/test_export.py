"""``rkhs export`` for policies."""

from collections.abc import Callable
from pathlib import Path

import pytest

from test.unit.conftest import Result, assert_refused

pytestmark = pytest.mark.slow  # draws
ROOT = Path(__file__).parents[3]
Run = Callable[..., Result]


@pytest.fixture
def run(rkhs: Run) -> Path:
    """Train for a moment."""
    config, small = ROOT / "config" / "pendulum_nac.yaml", ("iterations=2", "episodes_per_iteration=3", "horizon=15")
    done = rkhs("train", config, "--runner", "inline", "--quiet", "--out", "run", "--set", *small)
    assert done.code == 0, done.err
    return Path("run")


def test_a_policy_is_exported_as_onnx(run: Path, rkhs: Run) -> None:
    pytest.importorskip("onnxruntime")
    done = rkhs("export", run, "policy.onnx")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("Exported the policy: policy.onnx\nChecked on 1000 random observations: relative error ")
    assert Path("policy.onnx").is_file()


def test_export_needs_one_known_format(rkhs: Run) -> None:
    assert_refused(rkhs("export", "run"), "export: expected a file to write or --lerobot DIR, got neither")
    both = rkhs("export", "run", "a.onnx", "--lerobot", "b")
    assert_refused(both, "export: expected a file to write or --lerobot DIR, got file and lerobot")
    assert_refused(rkhs("export", "run", "a.pt"), "a.pt: expected a file that ends in .onnx or .html, got .pt")
    assert_refused(rkhs("export", "run", "a.onnx"), "run: expected an existing file or folder, got none")
