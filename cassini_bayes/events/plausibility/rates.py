"""Do body rates and the turns of the attitude tell the same motion?"""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility.rows import Rows, conventions
from cassini_bayes.events.telemetry import TelemetryEvent

LONGEST_STEP_S: Final = 120.0
"""Rates sampled more seldom say nothing about turns."""
LEAST_TURN_RAD: Final = 0.02
"""Attitudes that span less say too little about rates."""
RATE_MISFIT: Final = 0.2
LEAST_CORRELATION: Final = 0.35
"""Of turns with rates: below it, noise hides how one follows the other."""
MOST_RATE_FACTOR: Final = 5.0


def _turned_rad(attitude: Array) -> Array:
    """Small turns (n − 1, 3) in body axes from one attitude to the next."""
    old, new = attitude[:-1], attitude[1:]
    scalar = np.einsum("ij,ij->i", old, new)
    vector = old[:, 3:] * new[:, :3] - new[:, 3:] * old[:, :3] - np.cross(old[:, :3], new[:, :3])
    vector *= np.where(scalar < 0.0, -1.0, 1.0)[:, None]
    size = np.linalg.norm(vector, axis=1)
    angle = 2.0 * np.arctan2(size, np.abs(scalar))
    return np.asarray(vector * (angle / np.where(size > 0.0, size, 1.0))[:, None])


def _rate_fit(rows: Rows, attitude: Array) -> tuple[float, float]:
    """Least-squares factor of integrated rates onto turns, and the share it leaves."""
    step_s = np.diff(rows.time_s)[:, None]
    turns = np.cumsum(_turned_rad(attitude), axis=0)
    rates = np.cumsum(0.5 * (rows.rate_rad_s[1:] + rows.rate_rad_s[:-1]) * step_s, axis=0)
    factor = float(np.sum(turns * rates) / max(np.sum(rates * rates), 1e-300))
    left = np.sqrt(np.sum((turns - factor * rates) ** 2) / np.sum(turns * turns))
    return factor, float(left)


def check_rates(event: TelemetryEvent, rows: Rows) -> None:
    """Compare turns with integrated rates; only their sizes where the spacecraft hardly turned."""
    turns = np.cumsum(_turned_rad(rows.attitude), axis=0)
    if np.diff(rows.time_s).max() > LONGEST_STEP_S:
        return
    if np.abs(turns).max() < LEAST_TURN_RAD:
        _check_rate_unit(event, rows)
        return
    factor, left = _rate_fit(rows, rows.attitude)
    if left < RATE_MISFIT and abs(factor - 1.0) < RATE_MISFIT:
        return
    where, expected = str(event.telemetry), "body rates whose integral is the turn of the attitude"
    if left < RATE_MISFIT:
        units = {"deg/s": np.pi / 180.0, "mrad/s": 1e-3, "rad/s times 57.3": 180.0 / np.pi}
        near = [name for name, value in units.items() if abs(factor / value - 1.0) < 0.1]
        raise InputError(
            where,
            expected,
            f"turns that are {factor:.4g} times it{f': rates look like {near[0]}' if near else ''}",
            "give rate_…_rad_s in rad/s, about the body axes",
        )
    for what, attitude in conventions(rows.attitude):
        other, rest = _rate_fit(rows, attitude)
        if rest < RATE_MISFIT and abs(other - 1.0) < RATE_MISFIT:
            raise InputError(where, expected, what, "give J2000 → body, scalar last, in q1 to q4")
    raise InputError(
        where,
        expected,
        f"a turn of which {100.0 * left:.3g} % is another",
        "check the axes and signs of rate_…_rad_s and the convention of q1 to q4",
    )


def _followed(rows: Rows, attitude: Array) -> tuple[float, float, float]:
    """Σ turn · rate, Σ rate², Σ turn² of turns and rates about their means, a gyro bias aside."""
    turned = _turned_rad(attitude) / np.diff(rows.time_s)[:, None]
    rates = 0.5 * (rows.rate_rad_s[1:] + rows.rate_rad_s[:-1])
    turned, rates = turned - turned.mean(axis=0), rates - rates.mean(axis=0)
    return float(np.sum(turned * rates)), float(np.sum(rates * rates)), float(np.sum(turned**2))


def _check_rate_unit(event: TelemetryEvent, rows: Rows) -> None:
    """Refuse rates that no noise can keep so far from the turns in the dead-band.

    With noise in both, the true factor lies between the two regressions: of turns on rates, and of
    rates on turns inverted.
    """
    where, expected = str(event.telemetry), "body rates whose integral is the turn of the attitude"
    common, own, other = _followed(rows, rows.attitude)
    enough = LEAST_CORRELATION * np.sqrt(own * other)
    if common < 0.5 * enough:
        for what, attitude in conventions(rows.attitude):
            if _followed(rows, attitude)[0] > 1.3 * enough:
                raise InputError(where, expected, what, "give J2000 → body, scalar last")
    if common <= enough:
        return
    least, most = common / own, other / common
    if most < 1.0 / MOST_RATE_FACTOR or least > MOST_RATE_FACTOR:
        raise InputError(
            where,
            expected,
            f"turns that are {least:.3g} to {most:.3g} times it; rates in deg/s would make them"
            f" {np.pi / 180.0:.3g} times",
            "give rate_…_rad_s in rad/s, about the body axes",
        )
