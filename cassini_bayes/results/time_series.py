"""The momentum balance of telemetry row by row: measured, predicted, noise, and what is left.

The columns and weights are those of the likelihood (:mod:`cassini_bayes.balance.telemetry_terms`),
at posterior draws. An event with thrusters shows the momentum gained, ``I ω + H_w − R h0``, against
what thrusters and torque delivered; one without shows the body's own momentum ``I ω`` against what
is left of the conserved total, ``R h0 + ∫ torque − H_w``. The residual is the same in both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes.balance.statistics import Carry, Samples, settle
from cassini_bayes.balance.statistics.columns import Rows
from cassini_bayes.balance.telemetry_terms import (
    TelemetryTerms,
    balance_weights,
    noise_covariance,
)
from cassini_bayes.events.telemetry import read_chunks
from cassini_bayes.model.event_reduction import ReducedEvent, samples_of
from cassini_bayes.model.joint import JointModel, full_parameters, joint_physics
from cassini_bayes.priors.quantiles import NORMAL_90
from cassini_bayes.results.joint_draws import JointSample, draw_all
from cassini_bayes.spacecraft import Spacecraft

Array = NDArray[np.float64]
Places = NDArray[np.int64]
MOST_ROWS: Final = 2_000
DRAWS: Final = 100


@dataclass(frozen=True)
class Balance:
    """One event's balance at n posterior draws and r thinned rows, body axes.

    ``measured`` and ``predicted`` (n, r, 3) are its sides in N m s; ``covariance`` (n, 3, 3) is
    that of a row's white noise, ``walk`` (n,) the squared density of the torque noise, N² m² s.
    ``by_rate`` (n, 3, 3) and ``by_wheel`` (n, 3, W) are the momentum per measured rate, kg m².
    """

    terms: TelemetryTerms
    rows: Rows
    every: int  # one row in this many is kept
    measured: Array
    predicted: Array
    covariance: Array
    walk: Array
    by_rate: Array
    by_wheel: Array

    @property
    def residual(self) -> Array:
        """Measured minus predicted (n, r, 3), N m s."""
        return self.measured - self.predicted

    @property
    def drift(self) -> Array:
        """Cosines (r, M) that standard normals turn into the momentum of a unit torque noise."""
        duration = self.terms.statistics.duration_s
        order = np.arange(1, len(self.terms.statistics.mode_gram) + 1) * np.pi
        phase = self.rows.time_s[:, None] / duration * order
        return np.asarray(np.sqrt(2.0 * duration) * np.cos(phase) / order)


@dataclass(frozen=True)
class EventSeries:
    """One event's balance at up to ``MOST_ROWS`` rows, body axes, N m s; arrays are (n, 3).

    ``measured`` and ``predicted`` are means over posterior draws, ``predicted_sd`` the spread of
    the prediction over them, ``residual`` the mean of measured minus predicted, ``noise_sd`` what
    white channel noise and torque noise let it be.
    """

    event: str
    kind: str
    quantity: str
    time_s: Array  # (n,)
    measured: Array
    predicted: Array
    predicted_sd: Array
    residual: Array
    residual_sd: Array  # over posterior draws
    noise_sd: Array
    every: int  # one row in this many is kept

    def table(self) -> pd.DataFrame:
        """The series as columns, one row per time; the event's id in the first column."""
        columns: dict[str, object] = {"event": self.event, "time_s": self.time_s}
        for name in ("measured", "predicted", "predicted_sd", "residual", "noise_sd"):
            for axis, values in zip("xyz", getattr(self, name).T, strict=True):
                columns[f"{name}_{axis}_n_m_s"] = values
        return pd.DataFrame(columns)

    @property
    def inside(self) -> Array:
        """Share of rows per axis (3,) whose residual lies within the 90 % band of the noise."""
        return np.asarray((np.abs(self.residual) <= NORMAL_90 * self.noise_sd).mean(0))


def event_series(
    model: JointModel,
    events: tuple[ReducedEvent, ...],
    z: Array,
    rng: np.random.Generator,
) -> tuple[EventSeries, ...]:
    """Series of every telemetry event from posterior points z (n, d), of which some are used."""
    chosen = z[shown_places(len(z))]
    sample = draw_all(model, chosen, rng)
    return tuple(_series(balance) for balance in balances(model, events, chosen, sample))


def shown_places(n: int) -> Places:
    """Places of the posterior draws that are shown: at most ``DRAWS`` of n, evenly spaced."""
    return np.linspace(0, n - 1, min(DRAWS, n)).round().astype(np.int64)


def balances(
    model: JointModel,
    events: Sequence[ReducedEvent],
    z: Array,
    sample: JointSample,
    most_rows: int = MOST_ROWS,
) -> Iterator[Balance]:
    """Balance of every telemetry event at z (n, d) and what was drawn there, row by row.

    Rows are thinned evenly to at most ``most_rows``; the files are read again.
    """
    full = full_parameters(model, z)
    physics = joint_physics(model, full)
    place = len(model.event_ids) - len(model.telemetry)
    for terms, event, own in zip(model.telemetry, events, sample.own, strict=True):
        unknowns = own
        if terms.fires:
            unknowns = np.concatenate([_thrusts(sample, place), own], axis=1)
            place += 1
        rows, every = _rows(terms, event, model.spacecraft, most_rows)
        weights = balance_weights(terms, physics, model.linear.common_mean_n)
        measured, predicted = _both_sides(terms, rows, weights, unknowns)
        yield Balance(
            terms=terms,
            rows=rows,
            every=every,
            measured=measured,
            predicted=predicted,
            covariance=noise_covariance(terms, physics, full),
            walk=full["torque_noise_n_m_s05"] ** 2,
            by_rate=physics.momentum_per_rate,
            by_wheel=physics.wheel_weights[..., list(terms.wheel_places)],
        )


def _thrusts(sample: JointSample, place: int) -> Array:
    assert sample.thrusts is not None  # the event fires
    return sample.thrusts.thrust_n[:, place]


def _rows(
    terms: TelemetryTerms, event: ReducedEvent, spacecraft: Spacecraft, most_rows: int
) -> tuple[Rows, int]:
    """The columns at evenly thinned rows of the balance, streamed in constant memory."""
    statistics = terms.statistics
    every = max(1, -(-statistics.rows // most_rows))
    parts = []
    carry, seen = Carry.start(statistics.layout), 0
    for samples, final in _with_end(samples_of(c) for c in read_chunks(event.event, spacecraft)):
        rows, carry = settle(samples, carry, statistics.layout, terms.sampling, final)
        parts.append(rows.part(slice((-seen) % every, None, every)))
        seen += len(rows.time_s)
    return Rows.joined(parts), every


def _with_end(samples: Iterator[Samples]) -> Iterator[tuple[Samples, bool]]:
    """Every item with whether it is the last."""
    previous: Samples | None = None
    for item in samples:
        if previous is not None:
            yield previous, False
        previous = item
    if previous is not None:
        yield previous, True


def _both_sides(
    terms: TelemetryTerms, rows: Rows, weights: Array, unknowns: Array
) -> tuple[Array, Array]:
    """Both sides of the balance (n, rows, 3): weights (n, B, 3), unknowns (n, P − 1)."""
    layout, pattern = terms.statistics.layout, terms.pattern
    owner = np.repeat(np.arange(len(pattern.start) - 1), np.diff(pattern.start))
    last = len(pattern.start) - 2
    factor = np.concatenate([unknowns, np.ones((len(unknowns), 1))], axis=1)
    is_measured = owner == last
    in_wheels = (
        is_measured & (pattern.row >= layout.wheel.start) & (pattern.row < layout.wheel.stop)
    )
    first = pattern.thrusters
    initial = (owner >= first) & (owner < first + 3)
    masks = {
        "measured": is_measured,
        "wheels": in_wheels,
        "initial": initial,
        "delivered": ~is_measured & ~initial,
    }
    sums = {
        name: _applied(rows, layout.size, pattern.row, weights, factor[:, owner], mask)
        for name, mask in masks.items()
    }
    if terms.fires:
        return sums["measured"] - sums["initial"], sums["delivered"]
    body = sums["measured"] - sums["wheels"]
    return body, sums["initial"] + sums["delivered"] - sums["wheels"]


def _series(balance: Balance) -> EventSeries:
    """Means and spreads of one event over posterior draws."""
    terms, measured, predicted = balance.terms, balance.measured, balance.predicted
    variance = np.diagonal(balance.covariance, axis1=-2, axis2=-1).mean(0)
    drift = balance.walk.mean() * (balance.drift**2).sum(-1)
    return EventSeries(
        event=terms.id,
        kind=terms.statistics.kind,
        quantity="momentum gained" if terms.fires else "momentum of the body, I ω",
        time_s=balance.rows.time_s,
        measured=measured.mean(0),
        predicted=predicted.mean(0),
        predicted_sd=predicted.std(0),
        residual=balance.residual.mean(0),
        residual_sd=balance.residual.std(0),
        noise_sd=np.sqrt(variance + drift[:, None]),
        every=balance.every,
    )


def _applied(
    rows: Rows,
    size: int,
    column: NDArray[np.int64],
    weights: Array,
    factor: Array,
    mask: NDArray[np.bool_],
) -> Array:
    """Σ_b factor_b weight_b column_b over the masked entries, (draws, rows, 3)."""
    coefficients = np.zeros((len(weights), 3, size))
    for b in np.flatnonzero(mask):
        coefficients[:, :, column[b]] += factor[:, b, None] * weights[:, b]
    vectors = rows.vector.shape[2]
    by_vector = np.einsum("tcv,ncv->ntc", rows.vector, coefficients[..., :vectors], optimize=True)
    return np.asarray(
        by_vector + np.einsum("ts,ncs->ntc", rows.scalar, coefficients[..., vectors:])
    )
