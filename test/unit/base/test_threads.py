import os
import subprocess
import sys
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from rkhs_ros.base.threads import use_one_thread

SHOW = "from threadpoolctl import *; print({p['num_threads'] for p in threadpool_info() if p['user_api'] == 'blas'})"
BEFORE, AFTER = "import numpy, scipy.linalg, rkhs_ros; rkhs_ros.RBF", "import rkhs_ros; rkhs_ros.RBF"


@pytest.mark.parametrize("script", [BEFORE, AFTER], ids=["numpy first", "rkhs_ros first"])
@pytest.mark.parametrize("variable", ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NONE"])
def test_linear_algebra_uses_one_thread_for_any_environment_and_import_order(script: str, variable: str) -> None:
    inherited = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    root = str(Path(__file__).parents[3])
    environment = {**inherited, variable: "2", "PYTHONPATH": os.pathsep.join([root, inherited.get("PYTHONPATH", "")])}
    shown = subprocess.run(
        [sys.executable, "-c", f"{script}; {SHOW}"], env=environment, capture_output=True, text=True, check=True
    )
    assert shown.stdout == "{1}\n"


def test_a_later_thread_limit_is_overridden() -> None:
    with threadpool_limits(2, user_api="blas"):
        assert use_one_thread() == 1
        assert {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"} == {1}
