"""The momentum balance of telemetry row by row: measured, predicted, noise, and what is left.

The columns and weights are those of the likelihood
(:mod:`cassini_bayes.balance.telemetry_weights`), at posterior draws. An event with thrusters shows
the momentum gained, ``I ω + H_w − R h0``, against what thrusters and torque delivered; one without
shows the body's own momentum ``I ω`` against what is left of the conserved total,
``R h0 + ∫ torque − H_w``. The residual is the same in both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain, pairwise
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.balance.open_counters import OpenScales, patterns_at, step_variances
from cassini_bayes.balance.statistics import Carry, settle
from cassini_bayes.balance.statistics.columns import Rows
from cassini_bayes.balance.statistics.walk import cosines, walk_scales
from cassini_bayes.balance.telemetry_balance import TelemetryBalance
from cassini_bayes.balance.telemetry_noise import noise_covariance, open_scales
from cassini_bayes.balance.telemetry_weights import balance_weights
from cassini_bayes.computing.arrays import Array, Flags, Places, joined
from cassini_bayes.model.draws import Draws, draw
from cassini_bayes.model.posterior import Model
from cassini_bayes.model.telemetry import TORQUE_NOISE, TelemetryTerm, unknowns_of
from cassini_bayes.priors.quantiles import NORMAL_90

MOST_ROWS: Final = 2_000
DRAWS: Final = 100


@dataclass(frozen=True)
class BalanceRows:
    """One event's balance at n posterior draws and r thinned rows, body axes.

    ``measured`` and ``predicted`` (n, r, 3) are its sides in N m s; ``covariance`` (n, 3, 3) is
    that of a row's white noise, ``walk`` (n,) the squared density of the torque noise, N² m² s.
    ``by_rate`` (n, 3, 3) and ``by_wheel`` (n, 3, W) are the momentum per measured rate, kg m².
    """

    term: TelemetryTerm
    rows: Rows
    every: int  # one row in this many is kept
    measured: Array
    predicted: Array
    covariance: Array
    walk: Array
    by_rate: Array
    by_wheel: Array
    scales: OpenScales  # of what counters leave open

    def open_momentum(self, rng: np.random.Generator) -> Array:
        """Momentum (n, r, 3), N m s, drawn of what counters leave open."""
        total = np.zeros_like(self.measured)
        for torque, steps, variance, levels in self._patterns():
            gained = np.sqrt(variance) * rng.standard_normal(variance.shape)
            late = gained @ steps.T
            rounded = rng.standard_normal((len(total), levels.shape[2]))
            late += np.einsum("nl,rcl,nc->nr", rounded, levels, self.scales.pulse_weights)
            total += late[:, :, None] * torque[:, None]
        return total

    def open_variance(self) -> Array:
        """Variance (r, 3) of it, mean over draws."""
        total = np.zeros(self.measured.shape[1:])
        for torque, steps, variance, levels in self._patterns():
            of_levels = np.einsum("rcl,nc->nrl", levels, self.scales.pulse_weights)
            late = variance @ (steps.T**2) + (of_levels**2).sum(axis=2)
            total += (late[:, :, None] * torque[:, None] ** 2).mean(0)
        return total

    def _patterns(self) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Each couple: torque (n, 3), steps (r, s), variances of these (n, s), levels (r, C, l)."""
        statistics = self.term.event.statistics
        patterns = patterns_at(statistics.counters, statistics.duration_s, self.rows.time_s)
        for g, (steps, intervals, levels) in enumerate(patterns):
            variance = step_variances(statistics.counters, g, self.scales)
            yield self.scales.torque_n_m[..., g], steps, variance[:, intervals], levels

    @property
    def residual(self) -> Array:
        """Measured minus predicted (n, r, 3), N m s."""
        return self.measured - self.predicted

    @property
    def drift(self) -> Array:
        """Cosines (r, M) that standard normals turn into the momentum of a unit torque noise."""
        statistics = self.term.event.statistics
        count, duration = len(statistics.mode_gram), statistics.duration_s
        each = cosines(self.rows.time_s, duration, 1 + count)[:, 1:]
        return np.asarray(each * walk_scales(duration, count)[1:])


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


def event_series(model: Model, z: Array, rng: np.random.Generator) -> tuple[EventSeries, ...]:
    """Series of every telemetry event from posterior points z (n, d), of which some are used."""
    chosen = z[thinned_draws(len(z))]
    return tuple(_series(rows) for rows in balances(model, chosen, draw(model, chosen, rng)))


def thinned_draws(n: int) -> Places:
    """Places of the posterior draws that are shown: at most ``DRAWS`` of n, evenly spaced."""
    return np.linspace(0, n - 1, min(DRAWS, n)).round().astype(np.int64)


def balances(
    model: Model, z: Array, draws: Draws, most_rows: int = MOST_ROWS
) -> Iterator[BalanceRows]:
    """Balance of every telemetry event at z (n, d) and what was drawn there, row by row.

    Rows are thinned evenly to at most ``most_rows``.
    """
    points, first = model.points(z), len(model.totals)
    places = slice(first, first + len(model.telemetry))
    thrust, integrated = model.fired_of_term[places], draws.integrated[places]
    for term, fired, drawn in zip(model.telemetry, thrust, integrated, strict=True):
        balance, physics = term.balance, term.physics(points)
        rows, every = _rows(term, most_rows)
        weights = balance_weights(balance, physics)
        unknowns = unknowns_of(draws.thrusts.thrust_n[:, fired], drawn)
        measured, predicted = _both_sides(balance, rows, weights, unknowns)
        yield BalanceRows(
            term=term,
            rows=rows,
            every=every,
            measured=measured,
            predicted=predicted,
            covariance=noise_covariance(balance, physics, points.parameters),
            walk=points.parameters[TORQUE_NOISE] ** 2,
            by_rate=physics.momentum_per_rate,
            by_wheel=balance.wheel_weights(physics),
            scales=open_scales(balance, physics),
        )


def _rows(term: TelemetryTerm, most_rows: int) -> tuple[Rows, int]:
    """The columns at evenly thinned rows of the balance, streamed in constant memory."""
    statistics = term.event.statistics
    every = max(1, -(-statistics.rows // most_rows))
    parts = []
    carry, done = Carry.start(statistics.layout), 0
    for samples, following in pairwise(chain(term.event.rows, [None])):
        assert samples is not None  # only the last one is followed by nothing
        final = following is None
        rows, carry = settle(samples, carry, statistics.layout, term.event.sampling, final)
        parts.append(rows.part(slice((-done) % every, None, every)))
        done += len(rows.time_s)
    return joined(parts), every


def _both_sides(
    balance: TelemetryBalance, rows: Rows, weights: Array, unknowns: Array
) -> tuple[Array, Array]:
    """Both sides of the balance (n, rows, 3): weights (n, B, 3), unknowns (n, P − 1)."""
    layout, pattern, places = balance.statistics.layout, balance.pattern, balance.unknowns
    owner = pattern.owner
    factor = np.concatenate([unknowns, np.ones((len(unknowns), 1))], axis=1)
    is_measured = owner == places.measured
    in_wheels = (
        is_measured & (pattern.row >= layout.wheel.start) & (pattern.row < layout.wheel.stop)
    )
    initial = (owner >= places.initial.start) & (owner < places.initial.stop)
    applied = partial(_applied, rows, layout.size, pattern.row, weights, factor[:, owner])
    measured, conserved = applied(is_measured), applied(initial)
    delivered = applied(~is_measured & ~initial)
    if balance.fires:
        return measured - conserved, delivered
    wheels = applied(in_wheels)
    return measured - wheels, conserved + delivered - wheels


def _series(balance: BalanceRows) -> EventSeries:
    """Means and spreads of one event over posterior draws."""
    event, measured, predicted = balance.term.event, balance.measured, balance.predicted
    variance = np.diagonal(balance.covariance, axis1=-2, axis2=-1).mean(0)
    drift = balance.walk.mean() * (balance.drift**2).sum(-1)
    return EventSeries(
        event=event.id,
        kind=event.kind,
        quantity="momentum gained" if event.fires else "momentum of the body, I ω",
        time_s=balance.rows.time_s,
        measured=measured.mean(0),
        predicted=predicted.mean(0),
        predicted_sd=predicted.std(0),
        residual=balance.residual.mean(0),
        residual_sd=balance.residual.std(0),
        noise_sd=np.sqrt(variance + drift[:, None] + balance.open_variance()),
        every=balance.every,
    )


def _applied(
    rows: Rows,
    size: int,
    column: Places,
    weights: Array,
    factor: Array,
    mask: Flags,
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
