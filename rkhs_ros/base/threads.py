"""Limit linear algebra to one thread.

At the sizes used here more threads are slower, and they change the order of sums and thus the last bits.
"""

from __future__ import annotations

from functools import cache

from threadpoolctl import ThreadpoolController


def use_one_thread() -> int:
    """Limit linear algebra to one thread, overriding the environment; return the largest number of threads in use."""
    loaded = _loaded()
    loaded.limit(limits=1)
    return max((library["num_threads"] for library in loaded.info()), default=1)


@cache
def _loaded() -> ThreadpoolController:
    """Return the loaded linear-algebra libraries; cached, because the search covers the whole process."""
    return ThreadpoolController().select(user_api="blas")
