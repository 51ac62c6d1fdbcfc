"""The specific impulse behind the printed hydrazine of paper 001, against duty cycle.

Equations (19) and (21) give hydrazine from on-times, thrust and duration, which the tables print;
the coefficients of (19) are printed nowhere. They follow from the printed masses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from cassini_bayes.computing.arrays import Array
from cassini_bayes.published import WheelBiasTable, wheel_bias_tables
from cassini_bayes.report.study_page import markdown_table
from cassini_bayes.simulation.kernel import STANDARD_GRAVITY_M_S2
from cassini_bayes.studies.bias_comparison import PRINTED, UNITS, printed_rows

THRUSTERS_PER_UNIT: Final = np.array([2.0 if "_" in unit else 1.0 for unit in UNITS])
START: Final = (180.0, 10.0, 100.0)
GROUPS: Final = {
    "ideal and calibrated": ("ideal", "calibrated"),
    "FSDS": ("fsds",),
    "flight": ("flight",),
}


@dataclass(frozen=True)
class PrintedHydrazine:
    """One column of one table: on-times (units,) in s, thrust, duration, hydrazine in g."""

    on_time_s: Array
    thrust_n: float
    duration_s: float
    hydrazine_g: float


@dataclass(frozen=True)
class SpecificImpulse:
    """I_sp(μ) = P0 − P1 exp(−P2 μ) in s, and the rms difference to the printed hydrazine in g."""

    coefficients: tuple[float, ...]
    rms_g: float

    def at(self, duty: float) -> float:
        """I_sp at a duty cycle, s."""
        return float(_isp(np.array(self.coefficients), np.array(duty)))


def printed_hydrazine(table: WheelBiasTable, column: str) -> PrintedHydrazine:
    """What equation (21) needs of one column, and its result as printed."""
    rows = printed_rows(table, column)
    thrust, duration = table.get("thrust", "all_columns"), table.get("duration", "all_columns")
    assert thrust is not None
    assert duration is not None
    return PrintedHydrazine(rows[: len(UNITS)], thrust.value, duration.value, float(rows[-1]))


def _isp(coefficients: Array, duty: Array) -> Array:
    if coefficients.size == 1:
        return np.full_like(duty, coefficients[0])
    return np.asarray(coefficients[0] - coefficients[1] * np.exp(-coefficients[2] * duty))


def hydrazine_g(printed: PrintedHydrazine, coefficients: Array) -> float:
    """Equation (21): Σ F T/(g I_sp(T/duration)) over all thrusters, g."""
    isp = _isp(coefficients, printed.on_time_s / printed.duration_s)
    impulse = printed.thrust_n * THRUSTERS_PER_UNIT * printed.on_time_s
    return float(1000.0 * np.sum(impulse / (STANDARD_GRAVITY_M_S2 * isp)))


def fit_specific_impulse(
    printed: Sequence[PrintedHydrazine], start: Sequence[float]
) -> SpecificImpulse:
    """Least squares for the coefficients: one number (constant) or three (with duty cycle)."""

    def residuals(coefficients: Array) -> Array:
        return np.array([hydrazine_g(p, coefficients) - p.hydrazine_g for p in printed])

    result = least_squares(residuals, start, x_scale=np.abs(start))
    rms = float(np.sqrt(np.mean(result.fun**2)))
    return SpecificImpulse(tuple(float(x) for x in result.x), rms)


def propellant_section() -> tuple[str, list[list[str]]]:
    """Fits for the ground software's, the test bed's and flight's columns, as a table."""
    header = [
        "columns",
        *("constant I_sp [s]", "rms [g]"),
        *("P0 [s]", "P1 [s]", "P2", "rms [g]"),
        *("I_sp at 0.5 % [s]", "at 2 % [s]"),
    ]
    assert {column for columns in GROUPS.values() for column in columns} == set(PRINTED)
    rows = []
    for name, columns in GROUPS.items():
        printed = [printed_hydrazine(t, c) for t in wheel_bias_tables() for c in columns]
        constant = fit_specific_impulse(printed, START[:1])
        full = fit_specific_impulse(printed, START)
        rows.append(
            [
                name,
                *(f"{constant.coefficients[0]:.1f}", f"{constant.rms_g:.3f}"),
                *(f"{x:.1f}" for x in full.coefficients),
                f"{full.rms_g:.3f}",
                *(f"{full.at(duty):.1f}" for duty in (0.005, 0.02)),
            ]
        )
    return markdown_table(header, rows), [header, *rows]
