"""One thread for linear algebra: at our sizes more are slower, and other sums end in other last bits."""

from __future__ import annotations

from threadpoolctl import threadpool_info, threadpool_limits


def use_one_thread() -> int:
    """Have the linear algebra that is loaded use one thread, whatever was set; return how many it uses at most."""
    threadpool_limits(1, user_api="blas")
    return max((library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"), default=1)
