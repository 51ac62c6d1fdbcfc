"""Columns turned from inertial into body axes row by row, compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Places = NDArray[np.int64]
Function = TypeVar("Function", bound=Callable[..., Any])

# nogil: other threads may evaluate other points meanwhile
OPTIONS: Final[dict[str, Any]] = {
    "error_model": "numpy",
    "fastmath": {"reassoc", "contract"},
    "nogil": True,
}


def _compiled(function: Function) -> Function:
    try:
        return cast(Function, njit(cache=True, **OPTIONS)(function))
    except RuntimeError:  # the package's folder cannot be written: compile in every process
        return cast(Function, njit(**OPTIONS)(function))


@_compiled
def turned_into_body(
    body: Array, inertial: Array, index: Places, out: Array
) -> None:  # pragma: no cover - compiled
    """Inertial columns in body axes: out[t] = body[t] @ inertial[index[t]].

    Parameters
    ----------
    body
        (n, 3, 3) inertial to body at every row.
    inertial
        (m, 3, C) columns after each change.
    index
        (n,) how many changes are over by every row.
    out
        (n, 3, C) result.
    """
    for t in range(body.shape[0]):
        held = inertial[index[t]]
        for c in range(3):
            x, y, z = body[t, c, 0], body[t, c, 1], body[t, c, 2]
            for a in range(held.shape[1]):
                out[t, c, a] = x * held[0, a] + y * held[1, a] + z * held[2, a]
