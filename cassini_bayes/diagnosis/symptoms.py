"""Symptoms in words and numbers: drifts, what they go with, whiteness, closure at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.balance.linearised import InnovationRows
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.correlations import (
    AXES,
    WINDOW_ROWS,
    InnovationTests,
    Tested,
    Whiteness,
    filled,
    running_mean,
)

DRIFT_Z: Final = 6.0
"""Of the largest of many windows of a random path: judgement, so that a flight with nothing hidden
names none."""
LEAST_Z: Final = 4.0  # of a single test among some fifty: a false one in 300 records
IN_STEP: Final = 0.9  # correlation of a drift with a thruster's on-time: judgement, 80 % of it
MOST: Final = 24  # symptoms in a record: more are not read
MEDIAN_STEP: Final = 0.954
"""Median of |x − y| of two independent standard normals: √2 × 0.6745."""


@dataclass(frozen=True)
class Symptom:
    """One thing that the baseline does not explain; ``z`` in standard deviations."""

    event: str
    axis: str
    where: str
    what: str
    z: float


def find_symptoms(rows: Sequence[InnovationRows], tests: InnovationTests) -> tuple[Symptom, ...]:
    """All symptoms of all events, the strongest first.

    Parameters
    ----------
    rows
        Innovations of every event.
    tests
        Their tests (:func:`correlations.innovation_tests`).
    """
    symptoms = [symptom for event in rows for axis in range(3) for symptom in _drift(event, axis)]
    for event in rows:
        for axis in AXES:
            symptoms += _correlation(
                [t for t in tests.drivers if (t.event, t.axis) == (event.event, axis)],
                tests.family_z,
            )
    symptoms += [symptom for white in tests.whiteness for symptom in _whiteness(white)]
    symptoms += [symptom for tested in tests.closure for symptom in _closure(tested)]
    return tuple(sorted(symptoms, key=lambda symptom: -abs(symptom.z))[:MOST])


def _drift(event: InnovationRows, axis: int) -> list[Symptom]:
    """The largest change of the smoothed innovations between two times."""
    smooth = running_mean(event.residual_n_m_s[:, axis], WINDOW_ROWS)
    low, high = int(smooth.argmin()), int(smooth.argmax())
    first, last = min(low, high), max(low, high)
    change = float(smooth[last] - smooth[first])
    sigma = float(np.median(np.abs(np.diff(event.residual_n_m_s[:, axis]))) / MEDIAN_STEP)
    z = change / (sigma * np.sqrt(2.0 / WINDOW_ROWS) + 1e-30)
    if abs(z) < DRIFT_Z:
        return []
    verb = "gains" if change > 0 else "loses"
    start, stop = event.time_s[first], event.time_s[last]
    what = (
        f"between t = {start:.0f} and {stop:.0f} s the {AXES[axis].upper()} axis {verb} "
        f"{abs(change):.2g} N m s more than predicted{_in_step(event, smooth, first, last)}"
    )
    return [Symptom(event.event, AXES[axis], f"t={start:.0f}..{stop:.0f} s", what, float(z))]


def _in_step(event: InnovationRows, smooth: Array, first: int, last: int) -> str:
    """The thruster whose on-time rises most like the drift, as the end of a sentence."""
    if last - first <= WINDOW_ROWS:
        return ""
    part = slice(first, last + 1)
    fits = {}
    for k, name in enumerate(event.thrusters[: event.on_time_s.shape[1]]):
        on_time = filled(event.on_time_s[:, k])[part]
        if np.ptp(on_time) > 0:
            fits[name.upper()] = abs(float(np.corrcoef(on_time, smooth[part])[0, 1]))
    if not fits or max(fits.values()) < IN_STEP:
        return ""
    return f", in step with {max(fits, key=lambda name: fits[name])} firings"


def _correlation(tested: Sequence[Tested], family_z: float) -> list[Symptom]:
    """The driver that an axis goes with most, where it leaves the family-wise band."""
    able = [t for t in tested if np.isfinite(t.z)]
    if not able:
        return []
    most = max(able, key=lambda t: abs(t.z))
    if abs(most.z) < family_z:
        return []
    sign = "with" if most.z > 0 else "against"
    what = f"the {most.axis.upper()} innovations go {sign} the {most.driver}".replace(
        "the time", "time"
    )
    return [Symptom(most.event, most.axis, "all", what, most.z)]


def _whiteness(white: Whiteness) -> list[Symptom]:
    z = white.portmanteau_z
    if z < LEAST_Z:
        return []
    what = f"the {white.axis.upper()} innovations are not white (lag 1: {white.value[0]:+.2f})"
    return [Symptom(white.event, white.axis, "all", what, z)]


def _closure(tested: Tested) -> list[Symptom]:
    """Momentum at the end against the beginning."""
    if not abs(tested.z) > LEAST_Z:
        return []
    what = (
        f"momentum about {tested.axis.upper()} does not close at the end by {tested.value:+.2g} "
        f"± {tested.sd:.1g} N m s (1 σ)"
    )
    return [Symptom(tested.event, tested.axis, "end", what, tested.z)]
