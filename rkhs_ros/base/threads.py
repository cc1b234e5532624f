"""One thread for linear algebra: at our sizes more are slower, and other sums end in other last bits."""

from __future__ import annotations

from functools import cache

from threadpoolctl import ThreadpoolController


def use_one_thread() -> int:
    """Have linear algebra use one thread, whatever was set; return how many it uses at most."""
    loaded = _loaded()
    loaded.limit(limits=1)
    return max((library["num_threads"] for library in loaded.info()), default=1)


@cache
def _loaded() -> ThreadpoolController:
    """Return the libraries of linear algebra that are loaded, for which the whole process has to be searched."""
    return ThreadpoolController().select(user_api="blas")
