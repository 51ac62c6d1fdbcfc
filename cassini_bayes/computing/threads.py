"""Linear algebra on one thread, in this process and those it starts.

Work is spread over processes and over parts of a batch; more threads on small matrices would only
compete (three times as slow on two cores).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from threadpoolctl import threadpool_limits

VARIABLES: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What the libraries look at when they are loaded."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit the libraries that are loaded, and through the environment those loaded later."""
    before = {name: os.environ.get(name) for name in VARIABLES}
    os.environ.update(dict.fromkeys(VARIABLES, "1"))
    try:
        with threadpool_limits(1):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
