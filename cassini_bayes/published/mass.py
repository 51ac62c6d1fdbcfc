"""Spacecraft mass implied by Tables 3.a to 3.h of paper 001, and the rule behind their ΔV.

The ground software computes ΔVz = −F T / M (paper 001 eq. 22), with F the printed thrust, T the
total Z on-time and M a mass that is not printed. So every table gives a = F/M = |ΔVz| / T within
the rounding of ΔVz (0.01 mm/s) and T (0.01 s), and M = F/a within the rounding of F (0.01 N).
The FSDS and flight columns follow |ΔVz| = a (T + k N), N the number of Z pulses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.published.printed import Interval, Operand
from cassini_bayes.published.wheel_bias import Z_THRUSTERS, WheelBiasTable

_M_PER_MM: Final = 1e-3


@dataclass(frozen=True)
class TableMass:
    """Mass behind one table.

    Attributes
    ----------
    columns
        Ground-software columns that the estimate rests on.
    acceleration_m_s2
        F/M with the rounding of ΔVz and on-time: known to 0.04–0.3 %.
    mass_kg
        Printed thrust over the middle of ``acceleration_m_s2``.
    mass_at_printed_thrust_kg
        Mass interval if the printed thrust were exact.
    mass_interval_kg
        Mass interval with the rounding of thrust as well.
    """

    event: str
    columns: tuple[str, ...]
    acceleration_m_s2: Interval
    mass_kg: float
    mass_at_printed_thrust_kg: Interval
    mass_interval_kg: Interval


@dataclass(frozen=True)
class LineFit:
    """Least-squares line with standard errors; units as the function says that returns it."""

    slope: float
    slope_se: float
    intercept: float
    intercept_se: float
    residual_sd: float


@dataclass(frozen=True)
class PulseTermFit:
    """|ΔVz|/a = slope · (T + k N): slope (–), k in s per Z pulse, with standard errors.

    ``residual_sd_s`` is the residual standard deviation of |ΔVz|/a. With the slope held at one,
    ``slope`` is 1 and ``slope_se`` 0.
    """

    slope: float
    slope_se: float
    extra_on_time_s: float
    extra_on_time_se_s: float
    residual_sd_s: float


def acceleration(table: WheelBiasTable, column: str) -> Operand:
    """F/M in m/s² that a ground-software column implies: |ΔVz| / total Z on-time."""
    on_time = table.cell("on_time_z_total", column).operand
    return -table.cell("delta_v_z", column).operand.scaled(_M_PER_MM) / on_time


def table_mass(table: WheelBiasTable) -> TableMass:
    """Mass of one event from its ideal and calibrated columns.

    Both columns share F and M, so their intervals of F/M are intersected. Where they exclude each
    other the ideal column stands alone: in Table 3.b ΔVz of the calibrated column is not that of
    its on-times, while ideal, FSDS and flight agree.
    """
    ideal, calibrated = (acceleration(table, c).interval for c in ("ideal", "calibrated"))
    agree = ideal.meets(calibrated)
    found = ideal.intersect(calibrated) if agree else ideal
    thrust = table.cell("thrust", "all_columns")
    return TableMass(
        event=table.event,
        columns=("ideal", "calibrated") if agree else ("ideal",),
        acceleration_m_s2=found,
        mass_kg=thrust.value / found.middle,
        mass_at_printed_thrust_kg=Interval(thrust.value, thrust.value) / found,
        mass_interval_kg=thrust.interval / found,
    )


def monotone_mass_intervals(masses: Sequence[TableMass]) -> tuple[Interval, ...]:
    """Narrow mass intervals (kg) by the fact that a spacecraft never gains mass.

    ``masses`` in order of time. An event's mass is at most every earlier upper bound and at least
    every later lower bound. InputError where the intervals exclude a monotone decrease.
    """
    upper = np.minimum.accumulate([m.mass_interval_kg.high for m in masses])
    lower = np.maximum.accumulate([m.mass_interval_kg.low for m in reversed(masses)])[::-1]
    return tuple(Interval(float(lo), float(hi)) for lo, hi in zip(lower, upper, strict=True))


def mass_trend(tables: Sequence[WheelBiasTable]) -> LineFit:
    """Straight line through the table masses against time.

    slope in kg/day, intercept in kg on the day of the first event.
    """
    first = tables[0].header_date
    days = np.array([(table.header_date - first).days for table in tables], dtype=np.float64)
    return _line(days, np.array([table_mass(table).mass_kg for table in tables]))


def consistent_accelerations(tables: Sequence[WheelBiasTable]) -> dict[str, float]:
    """F/M (m/s²) by event, the middle of what both ground-software columns allow."""
    return {table.event: table_mass(table).acceleration_m_s2.middle for table in tables}


def calibrated_accelerations(tables: Sequence[WheelBiasTable]) -> dict[str, float]:
    """F/M (m/s²) by event as |ΔVz|/T of the calibrated column alone, contradictory or not."""
    return {table.event: acceleration(table, "calibrated").nominal for table in tables}


def _columns(tables: Sequence[WheelBiasTable], column: str) -> tuple[Array, Array, Array]:
    """|ΔVz| (m/s), total Z on-time (s) and Z pulses of one column, one entry per event."""
    rows = ("delta_v_z", "on_time_z_total", *(f"pulses_{name}" for name in Z_THRUSTERS))
    values = np.array([[table.cell(row, column).value for row in rows] for table in tables])
    return -values[:, 0] * _M_PER_MM, values[:, 1], values[:, 2:].sum(axis=1)


def fit_pulse_term(
    tables: Sequence[WheelBiasTable],
    column: str,
    acceleration_m_s2: Mapping[str, float],
    *,
    unit_slope: bool,
) -> PulseTermFit:
    """Regress |ΔVz|/a on Z on-time and Z pulses, through the origin, unweighted.

    |ΔVz|/a = slope · T + (slope · k) · N, ordinary least squares over all events of a column; the
    standard error of k by the delta method. ``unit_slope`` holds the slope at one.
    """
    speed, t, n = _columns(tables, column)
    y = speed / np.array([acceleration_m_s2[table.event] for table in tables])
    if unit_slope:
        (extra,), covariance, sd = _least_squares(n[:, None], y - t)
        return PulseTermFit(1.0, 0.0, float(extra), math.sqrt(covariance[0, 0]), sd)
    (slope, both), covariance, sd = _least_squares(np.column_stack([t, n]), y)
    extra = float(both / slope)
    gradient = np.array([-extra / slope, 1.0 / slope])
    extra_se = math.sqrt(float(gradient @ covariance @ gradient))
    return PulseTermFit(float(slope), math.sqrt(covariance[0, 0]), extra, extra_se, sd)


def fit_predicted_delta_v(
    tables: Sequence[WheelBiasTable],
    column: str,
    acceleration_m_s2: Mapping[str, float],
    extra_on_time_s: float,
    *,
    intercept: bool,
) -> LineFit:
    """Regress |ΔVz| of a column on a (T + k N), both in m/s, k given.

    slope dimensionless; intercept and residual in m/s. Without ``intercept`` the line passes
    through the origin and the returned intercept and its error are 0.
    """
    factor = np.array([acceleration_m_s2[table.event] for table in tables])
    speed, on_time, pulses = _columns(tables, column)
    return _line(factor * (on_time + extra_on_time_s * pulses), speed, intercept=intercept)


def _line(x: Array, y: Array, *, intercept: bool = True) -> LineFit:
    design = np.column_stack([x, np.ones_like(x)] if intercept else [x])
    weights, covariance, sd = _least_squares(design, y)
    errors = np.sqrt(np.diagonal(covariance))
    level, level_se = (float(weights[1]), float(errors[1])) if intercept else (0.0, 0.0)
    return LineFit(float(weights[0]), float(errors[0]), level, level_se, sd)


def _least_squares(design: Array, y: Array) -> tuple[Array, Array, float]:
    """Ordinary least squares: weights, their covariance, residual standard deviation."""
    freedom = y.size - design.shape[1]
    if freedom < 1:
        wanted = f"more than {design.shape[1]} events"
        raise InputError("least squares", wanted, str(y.size), "give more events")
    weights = np.asarray(np.linalg.lstsq(design, y, rcond=None)[0], dtype=np.float64)
    variance = float(np.sum((y - design @ weights) ** 2)) / freedom
    return weights, variance * np.linalg.inv(design.T @ design), math.sqrt(variance)
