"""Symptoms in words and numbers: drifts, what they go with, whiteness, closure at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.criticism.innovations import EventRows

Array = NDArray[np.float64]
AXES: Final = "xyz"
WINDOW_ROWS: Final = 61
CLOSURE_ROWS: Final = 50
LAGS: Final = 20
DRIFT_Z: Final = 4.5
CORRELATION_Z: Final = 4.0
MOST: Final = 24


@dataclass(frozen=True)
class Symptom:
    """One thing that the baseline does not explain; ``z`` in standard deviations."""

    event: str
    axis: str
    where: str
    what: str
    z: float


def find_symptoms(rows: Sequence[EventRows], thrusters: Sequence[str]) -> tuple[Symptom, ...]:
    """All symptoms of all events, the strongest first."""
    found: list[Symptom] = []
    for own in rows:
        for axis in range(3):
            found += [*_drift(own, axis, thrusters), *_correlations(own, axis, thrusters)]
            found += [*_whiteness(own, axis), *_closure(own, axis)]
    return tuple(sorted(found, key=lambda symptom: -abs(symptom.z))[:MOST])


def running_mean(values: Array, width: int) -> Array:
    """Mean over up to ``width`` rows about each row."""
    ones = np.ones(min(width, len(values)))
    counts = np.convolve(np.ones(len(values)), ones, mode="same")
    return np.asarray(np.convolve(values, ones, mode="same") / counts)


def drivers(own: EventRows, thrusters: Sequence[str]) -> dict[str, Array]:
    """What the innovations may go with, as columns over the rows."""
    columns: dict[str, Array] = {}
    for k in range(own.on_time_s.shape[1]):
        on_time = _filled(own.on_time_s[:, k])
        columns[f"the on-time of {thrusters[k].upper()}"] = on_time
        columns[f"firings of {thrusters[k].upper()}"] = np.gradient(
            running_mean(on_time, WINDOW_ROWS)
        )
    for w in range(own.wheel_rad_s.shape[1]):
        speed = running_mean(own.wheel_rad_s[:, w], WINDOW_ROWS)
        columns[f"the rate of wheel {w + 1} in order"] = speed
        columns[f"the acceleration of wheel {w + 1} in order"] = np.gradient(speed)
    smooth = np.stack([running_mean(own.rate_rad_s[:, c], WINDOW_ROWS) for c in range(3)], axis=1)
    for c in range(3):
        columns[f"the {AXES[c].upper()} rate"] = smooth[:, c]
        other = (c + 1) % 3
        columns[f"the product of {AXES[c].upper()} and {AXES[other].upper()} rates"] = (
            smooth[:, c] * smooth[:, other]
        )
    columns["time"] = own.time_s
    return columns


def _filled(counter: Array) -> Array:
    """A counter at every row, where it is not read in all of them."""
    known = np.flatnonzero(np.isfinite(counter))
    if len(known) == 0:
        return np.zeros_like(counter)
    return np.asarray(np.interp(np.arange(len(counter)), known, counter[known]))


def correlation(own: EventRows, axis: int, column: Array) -> float:
    """Correlation with a driver times √n: about standard normal where there is none."""
    centred = column - column.mean()
    norm = float(np.sqrt((centred**2).sum()))
    white = own.white[:, axis] - own.white[:, axis].mean()
    spread = float(white.std())
    return float(white @ centred / (norm * spread)) if norm > 0 and spread > 0 else 0.0


def _drift(own: EventRows, axis: int, thrusters: Sequence[str]) -> list[Symptom]:
    """The largest change of the smoothed innovations between two times."""
    smooth = running_mean(own.residual_n_m_s[:, axis], WINDOW_ROWS)
    low, high = int(smooth.argmin()), int(smooth.argmax())
    first, last = min(low, high), max(low, high)
    change = float(smooth[last] - smooth[first])
    sigma = float(np.median(np.abs(np.diff(own.residual_n_m_s[:, axis]))) / 0.954)
    z = change / (sigma * np.sqrt(2.0 / WINDOW_ROWS) + 1e-30)
    if abs(z) < DRIFT_Z + 1.5:  # the largest of many windows
        return []
    part = slice(first, last + 1)
    with_what = ""
    if last - first > WINDOW_ROWS:
        rise = smooth[part]
        fits = {}
        for k in range(own.on_time_s.shape[1]):
            driver = _filled(own.on_time_s[:, k])[part]
            if np.ptp(driver) > 0:
                fits[thrusters[k].upper()] = abs(float(np.corrcoef(driver, rise)[0, 1]))
        if fits and max(fits.values()) > 0.9:
            with_what = f", in step with {max(fits, key=lambda name: fits[name])} firings"
    verb = "gains" if change > 0 else "loses"
    start, stop = own.time_s[first], own.time_s[last]
    what = (
        f"between t = {start:.0f} and {stop:.0f} s the {AXES[axis].upper()} axis {verb} "
        f"{abs(change):.2g} N m s more than predicted{with_what}"
    )
    return [Symptom(own.event, AXES[axis], f"t={start:.0f}..{stop:.0f} s", what, float(z))]


def _correlations(own: EventRows, axis: int, thrusters: Sequence[str]) -> list[Symptom]:
    scores = {
        name: correlation(own, axis, column) for name, column in drivers(own, thrusters).items()
    }
    name = max(scores, key=lambda key: abs(scores[key]))
    if abs(scores[name]) < CORRELATION_Z:
        return []
    sign = "with" if scores[name] > 0 else "against"
    what = f"the {AXES[axis].upper()} innovations go {sign} {name}"
    return [Symptom(own.event, AXES[axis], "all", what, scores[name])]


def autocorrelation(white: Array, lags: int = LAGS) -> Array:
    """Autocorrelation (lags,) from lag 1."""
    centred = white - white.mean()
    power = float(centred @ centred)
    return np.array([float(centred[k:] @ centred[:-k]) / power for k in range(1, lags + 1)])


def _whiteness(own: EventRows, axis: int) -> list[Symptom]:
    """Portmanteau of the first lags: standardised, so about normal where rows are independent."""
    if len(own.time_s) <= 2 * LAGS:
        return []
    found = autocorrelation(own.white[:, axis])
    n = len(own.time_s)
    z = float((n * (found**2).sum() - LAGS) / np.sqrt(2.0 * LAGS))
    if z < CORRELATION_Z:
        return []
    what = f"the {AXES[axis].upper()} innovations are not white (lag 1: {found[0]:+.2f})"
    return [Symptom(own.event, AXES[axis], "all", what, z)]


def _closure(own: EventRows, axis: int) -> list[Symptom]:
    """Momentum at the end against the beginning."""
    rows = min(CLOSURE_ROWS, len(own.time_s) // 4)
    if rows < 2:
        return []
    residual, white = own.residual_n_m_s[:, axis], own.white[:, axis]
    gap = float(residual[-rows:].mean() - residual[:rows].mean())
    z = float((white[-rows:].mean() - white[:rows].mean()) / np.sqrt(2.0 / rows))
    if abs(z) < CORRELATION_Z:
        return []
    what = f"momentum about {AXES[axis].upper()} does not close at the end by {gap:+.2g} N m s"
    return [Symptom(own.event, AXES[axis], "end", what, z)]
