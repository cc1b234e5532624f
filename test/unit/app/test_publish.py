"""``rkhs export`` for policies, and ``rkhs publish``."""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.policies.policy import load
from test.unit.conftest import Result, assert_refused

pytestmark = pytest.mark.slow  # draws
ROOT = Path(__file__).parents[3]
SMALL = ("iterations=2", "episodes_per_iteration=3", "horizon=15")
Run = Callable[..., Result]


def train(rkhs: Run, folder: str, *settings: str) -> Path:
    """Train for a moment."""
    config = ROOT / "config" / "pendulum_nac.yaml"
    done = rkhs("train", config, "--runner", "inline", "--quiet", "--out", folder, "--set", *SMALL, *settings)
    assert done.code == 0, done.err
    return Path(folder)


@pytest.fixture
def run(rkhs: Run) -> Path:
    return train(rkhs, "run", "evaluation_episodes=4")


@pytest.fixture
def without_onnx(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)


def card(folder: Path) -> str:
    return (folder / "README.md").read_text()


def test_a_policy_is_exported_as_onnx(run: Path, rkhs: Run) -> None:
    pytest.importorskip("onnxruntime")
    done = rkhs("export", run, "policy.onnx")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith(
        "Exported the policy: policy.onnx\nChecked on 10000 random observations: relative error "
    )
    assert done.out.endswith(" µs per call (median, one thread)\n")
    assert Path("policy.onnx").is_file()


@pytest.mark.usefixtures("without_onnx")
def test_a_missing_extra_gives_one_line(run: Path, rkhs: Run) -> None:
    message = "onnx: expected an installed package, got none. Run pip install onnx onnxruntime"
    assert_refused(rkhs("export", run, "policy.onnx"), message)
    assert not Path("policy.onnx").exists()


def test_export_needs_one_known_format(rkhs: Run) -> None:
    assert_refused(rkhs("export", "run"), "export: expected a file to write or --lerobot DIR, got neither")
    both = rkhs("export", "run", "a.onnx", "--lerobot", "b")
    assert_refused(both, "export: expected a file to write or --lerobot DIR, got file and lerobot")
    assert_refused(rkhs("export", "run", "a.pt"), "a.pt: expected a file that ends in .onnx or .html, got .pt")
    assert_refused(rkhs("export", "run", "a.onnx"), "run: expected an existing file or folder, got none")


def test_a_published_folder_describes_and_loads_the_policy(
    run: Path, rkhs: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    (run / "film.gif").write_bytes(b"a film")
    done = rkhs("publish", run)
    folder = run / "published"
    assert done.code == 0
    assert done.out.splitlines() == sorted(map(str, folder.iterdir()))
    for name in ("policy.npz", "config.yaml", "film.gif", "policy.png", "curve.png"):
        assert (folder / name).read_bytes() == (run / name).read_bytes()
        assert f"({name})" in card(folder)
    returns = np.genfromtxt(run / "curve.csv", delimiter=",", names=True)["evaluation_return"]
    assert f"| Return, discounted by 0.99 | {returns[-1]:.5g} [" in card(folder)
    assert "mean of the last evaluation episodes (4)" in card(folder)
    assert "| Training | rkhs_nac, 6 episodes, 90 steps, seed 0 |" in card(folder)
    assert "numpy" in card(folder)
    observation = np.array([0.3, -0.2])
    monkeypatch.chdir(folder)
    known = {"observation": observation}
    exec(card(Path()).partition("```python\n")[2].partition("```")[0], known)
    assert np.array_equal(known["action"], load("policy.npz")(observation))


@pytest.mark.usefixtures("without_onnx")
def test_a_film_is_rendered_and_a_missing_extra_is_noted(run: Path, rkhs: Run) -> None:
    done = rkhs("publish", run, "public")
    assert done.code == 0
    assert done.err.startswith("note: policy.onnx is missing. onnx: expected an installed package")
    assert done.err.count("\n") == 1
    assert (Path("public") / "film.gif").read_bytes().startswith(b"GIF")
    assert "policy.onnx" not in card(Path("public"))
    assert_refused(rkhs("publish", run, "public"), "public: expected a new or empty folder")


def test_a_run_without_evaluation_is_published_with_its_exploration_return(rkhs: Run) -> None:
    train(rkhs, "blind", "evaluation_episodes=4", "evaluate_every=0")
    (Path("blind") / "film.gif").write_bytes(b"a film")
    assert rkhs("publish", "blind", "out").code == 0
    assert "last exploration episodes (3)" in card(Path("out"))


def test_a_run_without_a_policy_is_not_published(run: Path, rkhs: Run) -> None:
    (run / "policy.npz").unlink()
    (run / "best_policy.npz").unlink()
    assert_refused(rkhs("publish", run), "run/policy.npz: expected a policy, got none since the run has not finished")
    assert_refused(rkhs("publish", "nothing"), "nothing: expected the folder of a run")


@pytest.mark.parametrize(
    ("missing", "message"),
    [("curve.csv", "expected at least one iteration, got none"), ("episodes.npz", "expected an existing file")],
)
def test_a_damaged_run_is_not_published_in_part(missing: str, message: str, run: Path, rkhs: Run) -> None:
    (run / missing).unlink()
    assert_refused(rkhs("publish", run), f"run/{missing}: {message}")
    assert not (run / "published").exists()


def test_a_published_policy_is_not_replaced_by_a_new_run(run: Path, rkhs: Run) -> None:
    (run / "film.gif").write_bytes(b"a film")
    assert rkhs("publish", run).code == 0
    folder = run / "published"
    content = (folder / "policy.npz").read_bytes()
    message = f"{folder / 'curve.csv'}: expected the learning curve of {folder / 'policy.npz'}, got none"
    assert_refused(rkhs("train", "--resume", folder, "--runner", "inline", "--quiet"), message)
    assert (folder / "policy.npz").read_bytes() == content
