"""What innovations go with: exact tests against drivers, whiteness, closure at the end.

If the model is true the innovations r of the linear model are normal with covariance
C = 1 − X (XᵀX + P)⁻¹ Xᵀ. So a contrast u of the innovations about one body axis has
z = uᵀ r / √(uᵀ C u), standard normal whatever was fitted, and the joint distribution of all
z is known: that gives the family-wise band. A driver that the model can take up itself leaves
uᵀ C u near zero and has no test.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.stats import norm

from cassini_bayes.balance.linearised import InnovationRows, Linear
from cassini_bayes.balance.part_columns import spread
from cassini_bayes.computing.arrays import Array

AXES: Final = "xyz"
WINDOW_ROWS: Final = 61
"""Of running means: judgement, a minute at 1 Hz lowers noise eightfold and keeps what thrusters do
in a bias of twenty."""
LEAST_SMOOTHED: Final = 3  # rows: one and its neighbours
CLOSURE_ROWS: Final = 50  # at either end: noise a seventh of a row's (judgement)
LAGS: Final = 40  # rows: judgement, longer than the answer of any filter or dead-band at 1 Hz
PROBABILITY: Final = 0.95  # of the bands
POINTWISE: Final = float(norm.ppf(0.5 + 0.5 * PROBABILITY))
LEAST_SHARE: Final = 1e-4
"""Of a driver that the model cannot take up: a difference of large numbers below it (judgement)."""
MOST_DRIVERS: Final = 6  # in a record
LEAST_SD: Final = 1e-9  # of a column over its largest value: what does not change but by rounding
_DRAWS: Final = 4_000  # for a 95 % quantile good to a percent


@dataclass(frozen=True)
class Tested:
    """One contrast of an event's innovations about a body axis.

    ``value`` is uᵀ r in the contrast's own unit, ``sd`` its standard deviation if the model is
    true; NaN where the model takes the contrast up itself.
    """

    event: str
    axis: str
    driver: str
    value: float
    sd: float

    @property
    def z(self) -> float:
        """Value over its standard deviation."""
        return self.value / self.sd


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation (LAGS,) of an event's innovations about a body axis from a lag of one row.

    What fitting takes out is put back, so that it is zero on average if the model is true.
    ``rows`` is the number n of rows: one standard deviation is 1/√n.
    """

    event: str
    axis: str
    rows: int
    value: Array

    @property
    def portmanteau_z(self) -> float:
        """(n Σ ρ² − L)/√(2 L) over the L lags: about standard normal for independent rows."""
        count = len(self.value)
        return float((self.rows * (self.value**2).sum() - count) / np.sqrt(2.0 * count))


@dataclass(frozen=True)
class InnovationTests:
    """Tests of one model's innovations, with the half-widths of their bands.

    ``family_z`` holds the largest |z| of all drivers, axes and events with probability 95 %,
    ``family_lag_z`` likewise all lags, in units of 1/√n.
    """

    drivers: tuple[Tested, ...]
    whiteness: tuple[Whiteness, ...]
    closure: tuple[Tested, ...]
    family_z: float
    family_lag_z: float


def innovation_tests(
    linear: Linear, rows: Sequence[InnovationRows], rng: np.random.Generator
) -> InnovationTests:
    """Test innovations against all drivers, for whiteness, and at the end.

    Parameters
    ----------
    linear, rows
        The linear model and its innovations (:func:`innovations.innovations`).
    rng
        For the family-wise band: 4,000 draws of all z together.
    """
    factor = cho_factor(linear.gram(), lower=True)
    tested, white = _tests(linear, rows, factor, [drivers(event) for event in rows])
    closure, _ = _tests(linear, rows, factor, [_ends(event) for event in rows])
    whiteness = _whiteness(linear, rows, factor[0])
    return InnovationTests(
        tuple(tested),
        tuple(whiteness),
        tuple(closure),
        family_band(white, rng),
        float(norm.ppf(0.5 + 0.5 * PROBABILITY ** (1.0 / max(LAGS * len(whiteness), 1)))),
    )


def strongest(tests: InnovationTests) -> list[dict[str, Any]]:
    """What the innovations of every event go with most, one driver each, largest |z| first."""
    result: dict[str, Tested] = {}
    for tested in sorted((t for t in tests.drivers if np.isfinite(t.z)), key=lambda t: -abs(t.z)):
        result.setdefault(tested.driver, tested)
    return [
        {"driver": t.driver, "event": t.event, "axis": t.axis, "z": t.z, "band_z": tests.family_z}
        for t in list(result.values())[:MOST_DRIVERS]
    ]


def running_mean(values: Array, width: int) -> Array:
    """Mean over up to ``width`` rows about each row."""
    ones = np.ones(min(width, len(values)))
    counts = np.convolve(np.ones(len(values)), ones, mode="same")
    return np.asarray(np.convolve(values, ones, mode="same") / counts)


def mean_of_others(values: Array, width: int) -> Array:
    """Mean over an odd number of up to ``width`` rows about each row, without it.

    Of a channel that is in the innovations too: its own noise is in none of its means. Less than
    three rows are as they are.
    """
    count = len(values)
    if count < LEAST_SMOOTHED:
        return values
    around = np.ones(min(width, count - 1 + count % 2))  # an odd number: the row in the middle
    around[len(around) // 2] = 0.0
    counts = np.convolve(np.ones(count), around, mode="same")
    return np.asarray(np.convolve(values, around, mode="same") / counts)


def filled(counter: Array) -> Array:
    """A counter at every row, where it is not read in all of them."""
    known = np.flatnonzero(np.isfinite(counter))
    if len(known) == 0:
        return np.zeros_like(counter)
    return np.asarray(np.interp(np.arange(len(counter)), known, counter[known]))


def drivers(event: InnovationRows) -> dict[str, Array]:
    """What innovations may go with: columns over the rows, without those that do not change.

    Wheel speeds and body rates are running means of 61 rows without the row itself, whose noise is
    in its innovation; firing rates and accelerations are slopes of running means.
    """
    columns: dict[str, Array] = {}
    for k, name in enumerate(event.thrusters[: event.on_time_s.shape[1]]):
        on_time = filled(event.on_time_s[:, k])
        columns[f"on-time of {name.upper()}"] = on_time
        columns[f"firing rate of {name.upper()}"] = _slope(event, on_time)
    for w, number in enumerate(event.wheels):
        columns[f"speed of wheel {number}"] = mean_of_others(event.wheel_rad_s[:, w], WINDOW_ROWS)
        columns[f"acceleration of wheel {number}"] = _slope(event, event.wheel_rad_s[:, w])
    smooth = np.stack([mean_of_others(rate, WINDOW_ROWS) for rate in event.rate_rad_s.T], axis=1)
    for c, name in enumerate("XYZ"):
        columns[f"rate about {name}"] = smooth[:, c]
    for c, name in enumerate("XYZ"):
        other = (c + 1) % 3
        columns[f"product of {name} and {'XYZ'[other]} rates"] = smooth[:, c] * smooth[:, other]
    if event.on_time_s.shape[1]:
        columns["time since a firing"] = _since_firing(event)
    columns["time"] = event.time_s
    changing = {name: column - column.mean() for name, column in columns.items()}
    return {
        name: column / column.std()
        for name, column in changing.items()
        if column.std() > LEAST_SD * np.abs(columns[name]).max()
    }


def _since_firing(event: InnovationRows) -> Array:
    """Time since any thruster's on-time last rose, s; since the first row before that."""
    total = np.sum([filled(event.on_time_s[:, k]) for k in range(event.on_time_s.shape[1])], axis=0)
    fired = np.concatenate([[True], np.diff(total) > 0.0])
    last = np.maximum.accumulate(np.where(fired, np.arange(len(total)), 0))
    return np.asarray(event.time_s - event.time_s[last])


def _slope(event: InnovationRows, values: Array) -> Array:
    return np.asarray(np.gradient(running_mean(values, WINDOW_ROWS), event.time_s))


def _ends(event: InnovationRows) -> dict[str, Array]:
    """Mean of the last rows less mean of the first, in N m s."""
    count = min(CLOSURE_ROWS, len(event.time_s) // 4)
    if count < 2:
        return {}
    column = np.zeros(len(event.time_s))
    column[:count], column[-count:] = -1.0 / count, 1.0 / count
    return {"end against start": column}


def _tests(
    linear: Linear,
    rows: Sequence[InnovationRows],
    factor: tuple[Array, bool],
    columns: Sequence[Mapping[str, Array]],
) -> tuple[list[Tested], Array]:
    """Contrasts column × body axis of every event, and the covariance (t, t) of their z."""
    tested: list[Tested] = []
    projections, own_covariance = [], []
    for event, part, named in zip(rows, linear.columns.parts, columns, strict=True):
        if not named:
            continue
        table = np.stack(list(named.values()), axis=1)  # (n, k)
        n, k = table.shape
        blocks = part.values.reshape(n, 3, -1)
        mixed = np.einsum("nk,nbp->kbp", table, blocks, optimize=True)
        along = np.einsum("ab,kbp->akp", event.noise_factor, mixed).reshape(3 * k, -1)
        projections.append(spread(along, part.places, linear.columns.width))
        noise = event.noise_factor @ event.noise_factor.T
        own_covariance.append(np.kron(noise, table.T @ table))
        values = (event.residual_n_m_s.T @ table).reshape(-1)
        for i, value in enumerate(values):
            axis, driver = AXES[i // k], list(named)[i % k]
            tested.append(Tested(event.event, axis, driver, float(value), float("nan")))
    if not tested:
        return [], np.zeros((0, 0))
    stacked = np.concatenate(projections)
    covariance = -stacked @ cho_solve(factor, stacked.T)
    place, scale = 0, []
    for block in own_covariance:
        stop = place + len(block)
        covariance[place:stop, place:stop] += block
        scale.append(np.diagonal(block))
        place = stop
    variance = np.diagonal(covariance)
    has_test = variance > LEAST_SHARE * np.concatenate(scale)
    sd = np.where(has_test, np.sqrt(np.maximum(variance, 0.0)), np.nan)
    tested = [replace(t, sd=float(s)) for t, s in zip(tested, sd, strict=True)]
    kept = np.ix_(has_test, has_test)
    return tested, covariance[kept] / np.outer(sd[has_test], sd[has_test])


def family_band(covariance: Array, rng: np.random.Generator) -> float:
    """Half-width that holds all of some correlated standard normals with probability 95 %."""
    if len(covariance) == 0:
        return POINTWISE
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = rng.standard_normal((_DRAWS, len(root))) @ root.T
    return float(np.quantile(np.abs(draws).max(axis=1), PROBABILITY))


def _whiteness(linear: Linear, rows: Sequence[InnovationRows], lower: Array) -> list[Whiteness]:
    """Autocorrelations with the smooth part that fitting took out put back on average."""
    whiteness = []
    root = solve_triangular(np.tril(lower), np.eye(len(lower)), lower=True)
    for event, part in zip(rows, linear.columns.parts, strict=True):
        n = len(event.time_s)
        if n <= 2 * LAGS:
            continue
        # the event's unknowns alone, whose covariance has this root
        taken = part.values @ np.asarray(np.linalg.qr(root[:, part.places], mode="r")).T
        taken = np.einsum("ab,nbp->anp", event.noise_factor, taken.reshape(n, 3, -1))
        for a, axis in enumerate(AXES):
            lags = _autocorrelation(event.residual_n_m_s[:, a], taken[a])
            whiteness.append(Whiteness(event.event, axis, n, lags))
    return whiteness


def _autocorrelation(residual: Array, taken: Array) -> Array:
    power = float((residual**2).sum() + (taken**2).sum())
    lagged = [
        float(residual[k:] @ residual[:-k] + np.einsum("np,np->", taken[k:], taken[:-k]))
        for k in range(1, LAGS + 1)
    ]
    return np.array(lagged) / power
