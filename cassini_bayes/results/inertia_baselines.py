"""The papers' least squares for the inertia from slews (paper 000 eqs. 4-11).

Momentum conserved in the inertial frame from rest, axis by axis or all elements at once; rows and
bars as in :mod:`cassini_bayes.results.telemetry_baselines`.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.balance.inertia import ELEMENTS, PLACES
from cassini_bayes.balance.physics import Physics
from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.posterior import Model
from cassini_bayes.model.telemetry import TelemetryTerm
from cassini_bayes.results.baselines import assumed_points
from cassini_bayes.results.telemetry_baselines import PlainRows, plain_rows

AXIS_BY_AXIS: Final = "axis by axis"
ALL_AXES: Final = "all axes together"
PURE: Final = 0.2  # a slew about one axis: the other rates below this share of it
TURNING: Final = 0.1  # of the largest rate about the axis: slower rows tell nothing


def inertia_methods(model: Model) -> pd.DataFrame:
    """Inertia by the papers' methods from every slew, and from all slews together.

    Columns label, method, event ("" for all slews), element, estimate_kg_m2, bar_rss_kg_m2,
    bar_worst_kg_m2; an element that the rows do not determine is NaN.
    """
    physics = assumed_points(model, model.space.centre()).physics(())
    parts: list[tuple[str, Array, Array]] = []
    for term in model.telemetry:
        if term.event.kind == "slew":
            data = plain_rows(term.event)
            parts.append((term.id, data.rate_rad_s, momentum_exchanged(term, physics, data)))
    rows: list[dict[str, object]] = []
    for event_id, rate, exchanged in parts:
        rows += _inertia_rows(event_id, rate, exchanged)
    if len(parts) > 1:
        rate = np.concatenate([part[1] for part in parts])
        rows += _inertia_rows("", rate, np.concatenate([part[2] for part in parts], axis=1))
    return pd.DataFrame(rows)


def momentum_exchanged(term: TelemetryTerm, physics: Physics, data: PlainRows) -> Array:
    """Q = P(t) P(0)⁻¹ T I_w ρ(0) − T I_w ρ(t), (n, rows, 3) N m s (paper 000 eq. 6).

    The body is taken to be at rest on the first row.
    """
    weights = term.balance.wheel_weights(physics)
    momentum = np.einsum("niw,tw->nti", weights, data.wheel_rad_s)
    turned = data.attitude @ data.attitude[0].T
    return np.asarray(np.einsum("tij,nj->nti", turned, momentum[:, 0]) - momentum)


def axis_by_axis(rate: Array, exchanged: Array) -> Array:
    """Elements (n, 6) from the rows that turn about one axis (paper 000 eq. 7).

    A product of inertia is the mean of its two estimates; NaN where no row turns about an axis.
    """
    tensor = np.full((len(exchanged), 3, 3), np.nan)
    size = np.abs(rate)
    for axis in range(3):
        others = np.delete(size, axis, axis=1).max(1)
        along = size[:, axis]
        pure = (others < PURE * along) & (along > TURNING * along.max())
        if pure.sum() > 1:
            turning = rate[pure, axis]
            tensor[:, :, axis] = np.einsum("t,nti->ni", turning, exchanged[:, pure]) / (
                turning @ turning
            )
    both = np.stack([tensor, np.swapaxes(tensor, 1, 2)])
    known = np.isfinite(both)
    summed = np.where(known, both, 0.0).sum(0)
    mean = np.where(known.any(0), summed / np.maximum(known.sum(0), 1), np.nan)
    return np.stack([mean[:, i, j] for i, j in PLACES], axis=-1)


def all_axes(rate: Array, exchanged: Array) -> Array:
    """All six elements (n, 6) at once (paper 000 eqs. 10-11); NaN where they are not determined."""
    design = np.zeros((len(rate), 3, 6))
    for place, (i, j) in enumerate(PLACES):
        design[:, i, place] += rate[:, j]
        if i != j:
            design[:, j, place] += rate[:, i]
    flat = design.reshape(-1, 6)
    if np.linalg.matrix_rank(flat) < 6:
        return np.full((len(exchanged), 6), np.nan)
    answer = np.linalg.lstsq(flat, exchanged.reshape(len(exchanged), -1).T, rcond=None)[0]
    return np.asarray(answer.T)


def _inertia_rows(event: str, rate: Array, exchanged: Array) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for method, solve in ((AXIS_BY_AXIS, axis_by_axis), (ALL_AXES, all_axes)):
        values = solve(rate, exchanged)
        shifts = values[1:] - values[0]
        for place, element in enumerate(ELEMENTS):
            rows.append(
                {
                    "label": f"{method}, {event or 'all slews'}",
                    "method": method,
                    "event": event,
                    "element": element,
                    "estimate_kg_m2": values[0, place],
                    "bar_rss_kg_m2": float(np.sqrt((shifts[:, place] ** 2).sum())),
                    "bar_worst_kg_m2": float(np.abs(shifts[:, place]).sum()),
                }
            )
    return rows
