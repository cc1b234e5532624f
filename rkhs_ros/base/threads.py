"""Limit linear algebra to one thread.

At the sizes used here more threads are slower, and they change the order of sums and thus the last bits.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit linear algebra to one thread within the context, overriding the environment."""
    with _loaded().limit(limits=1):
        yield


@cache
def _loaded() -> ThreadpoolController:
    """Return the loaded linear-algebra libraries; cached, because the search covers the whole process."""
    import scipy.linalg  # noqa: F401  # numpy and scipy load all the linear algebra in use

    return ThreadpoolController().select(user_api="blas")
