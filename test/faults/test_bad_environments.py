"""An environment that fails, hangs or crashes ends a run over topics with one line; after a repair the run resumes."""

import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from test.faults.runs import curve
from test.ros.conftest import Process

Start = Callable[..., Process]
TASKS = Path(__file__).with_name("bad_tasks.py")
TIMEOUT_S = 8
SMALL = ("episodes_per_iteration=2", "evaluation_episodes=2", f"timeout={TIMEOUT_S}")
FINITE = "expected finite numbers of at most 1e+100 in size, got"
OFTEN = ["the run was resumed 5 times within 300 s or without a further iteration"]
FAULTS = {
    "nan reward": f"bad_tasks:Bad-v0: reward of environment 0 in step 11: {FINITE} nan",
    "os._exit": "the simulator node, of bad_tasks:Bad-v0, ended with exit code 3",
    "os._exit like a node": "the simulator node, of bad_tasks:Bad-v0, ended with exit code 1 before the learner",
    "segmentation fault": "the simulator node, of bad_tasks:Bad-v0, was killed by signal 11",
    "hang": f"the simulator node did not answer within {TIMEOUT_S} s",
}


def wait_for(condition: Callable[[], bool]) -> float:
    """Wait for a condition and return its monotonic time, in seconds."""
    while not condition():
        time.sleep(0.02)
    return time.monotonic()


@pytest.mark.timeout(180)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_bad_environment_ends_the_run_with_one_line_and_a_repaired_one_resumes(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONFAULTHANDLER", raising=False)
    shutil.copy(TASKS, tmp_path)
    out = tmp_path / "run"
    settings = (*SMALL, f"environment.options.fault={fault}")
    arguments = ("--env", "bad_tasks:Bad-v0", "--quiet", "--iterations", 5, "--out", out, "--set", *settings)
    run = start("rkhs", "train", *arguments)
    bad_since = wait_for(lambda: len(curve(out)) == 3 or run.popen.poll() is not None)
    ended = wait_for(lambda: run.popen.poll() is not None)
    code, said, err = run.finish()
    assert (code, said) == (1, ""), err
    is_resumed = fault in ("os._exit", "segmentation fault", "hang")
    expected = [FAULTS[fault]] * 6 + OFTEN if is_resumed else [FAULTS[fault]]
    assert [line for line in err.splitlines() if line.startswith("error:")] == [f"error: {each}" for each in expected]
    assert "Traceback" not in err
    if not is_resumed:
        assert err.count("\n") == 2  # the error, and how to go on
        assert ended - bad_since < TIMEOUT_S + 5
    assert len(curve(out)) == 3
    assert (out / "policy.npz").is_file()
    Path("mended").touch()
    code, _, err = start("rkhs", "train", "--quiet", "--resume", out, "--env", "bad_tasks:Bad-v0").finish()
    assert (code, err) == (0, "")
    assert len(curve(out)) == 6
