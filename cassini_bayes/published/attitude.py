"""Reconstructed attitude and rates of the real spacecraft, as stored.

Three pieces of the C-kernels of Cassini (spacecraft −82000; kernels 11344_11349ra and
05357_05362ra), as sliced into the test data of the ISIS/ALE camera-model library (US Geological
Survey, public domain) and decoded from SPICE's text transfer format. Quaternions have the cosine
first and take J2000 to spacecraft; angular velocities are in J2000 axes, as C-kernels store them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.published.printed import csv_rows, package_text

COLUMNS: Final = (
    "sclk_s",
    *(f"ck_q{i}" for i in range(4)),
    *(f"ck_av_{axis}_rad_s" for axis in "xyz"),
)
PIECES: Final[Mapping[str, str]] = {
    "2005-357 a": "attitude_2005_357_a.csv",
    "2005-357 b": "attitude_2005_357_b.csv",
    "2011-344": "attitude_2011_344.csv",
}


@dataclass(frozen=True, eq=False)
class AttitudeRecord:
    """One stretch of records, in order of time: spacecraft clock, quaternions, rates.

    ``attitude`` are Euler parameters J2000 → body, scalar last, of unit norm; ``rate_rad_s`` the
    angular velocity in body axes.
    """

    name: str
    time_s: Array  # (n,)
    attitude: Array  # (n, 4)
    rate_rad_s: Array  # (n, 3)


def attitude_records() -> tuple[AttitudeRecord, ...]:
    """All pieces, in this package's convention.

    A C-kernel quaternion (q0, q) stands for the matrix 1 + 2 q0 [q×] + 2 [q×]², this package's
    for (q4² − q·q) 1 + 2 q qᵀ − 2 q4 [q×]: (−q, q0) is the same rotation.
    """
    return tuple(_record(name, file) for name, file in PIECES.items())


def _record(name: str, file: str) -> AttitudeRecord:
    rows = csv_rows(package_text(file), COLUMNS, where=file)
    table = np.array([[float(row[column]) for column in COLUMNS] for row in rows])
    scalar, vector = table[:, 1], table[:, 2:5]
    vector = vector / np.hypot(scalar, np.linalg.norm(vector, axis=1))[:, None]
    scalar = scalar / np.linalg.norm(table[:, 1:5], axis=1)
    return AttitudeRecord(
        name,
        table[:, 0] - table[0, 0],
        np.column_stack([-vector, scalar]),
        _into_body(scalar, vector, table[:, 5:8]),
    )


def _into_body(scalar: Array, vector: Array, inertial: Array) -> Array:
    """Vectors (n, 3) in J2000 axes turned into body axes: v + 2 q0 q×v + 2 q×(q×v)."""
    once = np.cross(vector, inertial)
    return np.asarray(inertial + 2.0 * scalar[:, None] * once + 2.0 * np.cross(vector, once))
