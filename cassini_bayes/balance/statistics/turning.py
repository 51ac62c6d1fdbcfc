"""From inertial into body axes: columns turned row by row, compiled."""

from __future__ import annotations

from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.computing.compilation import compiled_sums


@compiled_sums
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
