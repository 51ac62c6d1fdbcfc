"""How well the balance of momentum closes, and how well it would with a channel corrected.

The balance holds in the inertial frame for any event (C the inertial-to-body matrix):

    Cᵀ(I ω + T I_w ρ) = constant + Σ_k ∫ Cᵀ q_k F ds_k + ∫ Cᵀ τ dt,
    s = on-time + pulses (τ_f − τ_r)

Each channel enters linearly, so its columns of every axis stand once in a Gram matrix, and a
mistake (another order, sign, factor) is another set of weights on them: true = matrix · recorded.
Nominal values are not the truth, so the balance leans on departures at a price, wide enough for
everything the catalogue of effects holds and for a torque that nobody catalogued. What is left, in
units of the rows' noise, and the price together are the misfit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.plausibility.departures import (
    CUT_MODES,
    DRIFT_MODES,
    FREE,
    SWING_MODES,
    WIDTHS,
    Columns,
    Correction,
    Nominal,
    corrected,
    departures_of,
    free_columns,
)
from cassini_bayes.events.plausibility.rows import Rows
from cassini_bayes.spacecraft.attitude import direction_cosines
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

WARM_UP_S: Final = 5.0  # of firing: the median of the catalogue's warmup_time_s
DRIFT_LEVELS: Final = (0.05, 0.25, 1.0)
"""Shares of its width that a torque which nothing explains may have: inferred from each event
(docs/topics/plausibility.md). Steps of four to five are judgement."""
USUAL_DRIFT: Final = 1e-4
"""N m s per √s: the median of the priors', whose logarithm has a width of 1."""
LEAST_STRENGTH: Final = 1e-9
"""Of a free column, in units of noise: nothing is known of it. A guard against division by 0."""
MOST_NOISE_SHARE: Final = 0.5  # of what a correction moves, that is no noise: judgement
LEAST_MOVE: Final = 1e-18  # (N m s)²: a guard against division by 0
LEAST_CYCLES: Final = 4.0
"""Of a swing in an event: what is slower is drift."""
LEAST_NOISE: Final = 1e-5
"""N m s of a row: a hundredth of what 0.05 rpm of a wheel is. Noise-free data would divide by 0."""
LEAST_SPAN: Final = 1e-9  # s, or s of firing: a guard against division by 0
LEAST_IMPULSE: Final = 1e-9  # N m s, of events that fire nothing: the same
SHARED: Final = 3.0
"""Rows that a rounding error counts for (by trial, on pulses of 30 to 250 ms in steps of 125)."""
RESTING: Final = 3  # printed values of a wheel at rest: one, its neighbours, and no motion
MOST_SIGMAS: Final = 5.0
"""Widths to which departures are held where it is asked how much momentum stays open: what nobody
believes explains nothing (judgement)."""
NOISE_SIGMAS: Final = 3.0
"""Departures that fit noise are a χ² of their number: what noise may make of it, in its σ."""
NEARLY_FREE: Final = 1e-3
"""Price of departures thirty times as wide."""
MAY_LACK: Final = ("cut", "swing")


@dataclass(frozen=True, eq=False)
class Momentum:
    """Gram matrix (p, p) of an event's columns in N m s and how noisy a row is."""

    columns: Columns
    flat: Array  # (3 n, p) what the rows hold, the momentum at the start taken off
    gram: Array
    steps: Array  # (p, p) Gram matrix of second differences over neighbouring rows
    rows: int
    per_row: int  # equations that a row brings
    counts: int  # second differences
    rounding: Array  # (K,) s², variance that a rounded counter brings to a row
    rest: Array  # (W,) (rad/s)², the same of a wheel that rests between two printed values
    on_time_s: Array  # (K,) gained in all rows
    pulses: Array  # (K,)
    most_noise: float = np.inf  # where rates are as recorded

    def noise(self, nominal: Nominal, correction: Correction) -> float:
        """Standard deviation of a row on one axis, N m s: from second differences of the total.

        Of all exchanges of thrusters the least: firings of the wrong thruster are no noise.
        """
        targets = corrected(self.columns, nominal.exchanges, correction)
        square = float(np.einsum("ph,ph->h", targets, self.steps @ targets).min())
        rounded = np.sum(nominal.torques**2 @ self.rounding + nominal.spins**2 @ self.rest) / 3.0
        bent = square / (6.0 * self.per_row * self.counts)
        found = float(np.sqrt(max(bent + float(rounded), LEAST_NOISE**2)))
        as_recorded = np.array_equal(correction.rate, np.eye(3))
        return min(found, self.most_noise) if as_recorded else found

    def swing_hz(self, nominal: Nominal, time_s: Array) -> float:
        """The frequency at which what stays open oscillates most, 0 where rows are too few."""
        correction = Correction.nothing(nominal)
        target, _, design, strength, axes, pull, _ = self._closed(nominal, correction)
        left = (self.flat @ (target + design @ (axes @ (pull / (strength + 1.0))))).reshape(-1, 3)
        span_s, row_s = float(time_s[-1] - time_s[0]), float(np.median(np.diff(time_s)))
        lines = np.arange(LEAST_CYCLES / span_s, 0.5 / row_s, 0.5 / span_s)
        if not len(lines):
            return 0.0
        waves = np.exp(-2j * np.pi * np.outer(lines, time_s - time_s[0]))
        return float(lines[np.argmax(np.sum(np.abs(waves @ left) ** 2, axis=1))])

    def _closed(
        self, nominal: Nominal, correction: Correction
    ) -> tuple[Array, Sequence[str], Array, Array, Array, Array, float]:
        """What is to be closed, names and weights of departures, and their normal equations.

        Eigenvalues, eigenvectors and right-hand side of these, in units of the noise; its variance.
        """
        target = corrected(self.columns, nominal.exchanges[:, :1], correction)[:, 0]
        names, design = self._present(*departures_of(nominal, correction))
        variance = self.noise(nominal, correction) ** 2
        strength, axes = np.linalg.eigh(design.T @ self.gram @ design / variance)
        pull = -axes.T @ (design.T @ (self.gram @ target)) / variance
        return target, names, design, np.maximum(strength, 0.0), axes, pull, variance

    def fit(self, nominal: Nominal, correction: Correction) -> MomentumFit:
        """What it costs to close the balance."""
        target, names, design, strength, axes, pull, variance = self._closed(nominal, correction)
        # least misfit at price λ: const − Σ pull²/(strength + λ)
        gain = pull**2 * (1.0 / (strength + NEARLY_FREE) - 1.0 / (strength + 1.0))
        by_noise = strength / (strength + NEARLY_FREE) - strength / (strength + 1.0)
        free = target + design @ (axes @ (pull / (strength + NEARLY_FREE)))
        rest = float(free @ self.gram @ free) / variance - self.per_row * self.rows
        # of the sum, and as much again of the noise that it is measured in
        rest -= NOISE_SIGMAS * np.sqrt(4.0 * self.per_row * self.rows)
        solution = axes @ (pull / (strength + 1.0))
        # what nobody believes explains nothing
        vector = target + design @ np.clip(solution, -MOST_SIGMAS, MOST_SIGMAS)
        open_nms = np.sqrt(max(float(vector @ self.gram @ vector), 0.0) / self.rows)
        factors = 1.0 + FREE * solution[np.array(names) == "factor"]
        chance = by_noise.sum() + NOISE_SIGMAS * np.sqrt(2.0 * np.sum(by_noise**2))
        excess = max(float(gain.sum() - chance), 0.0) + max(rest, 0.0)
        share, spread = self._impulse(names, nominal, correction)
        # departures make up for what is open: more thrust is a negative one
        impulse = 1.0 - float(share @ solution)
        excess += vanishing(impulse, spread)
        return MomentumFit(excess, float(open_nms), factors, impulse)

    def _present(self, names: Sequence[str], design: Array) -> tuple[tuple[str, ...], Array]:
        """Departures without those of cut tails or a swing that an event has not."""
        known = self.gram.diagonal() > 0.0
        kept = np.any(design[known] != 0.0, axis=0) | ~np.isin(names, MAY_LACK)
        return tuple(np.array(names)[kept].tolist()), design[:, kept]

    def evidence(self, nominal: Nominal, noise: float) -> float:
        """−2 log of the evidence of rows with a noise in N m s, but for a constant."""
        return min(
            each.cost for each in self._levels(nominal, np.zeros((self.columns.size, 0)), noise)
        )

    def gains(self, nominal: Nominal, corrections: Sequence[Correction]) -> tuple[Array, Array]:
        """By how much corrections raise the evidence, as 2 log, and their sizes (1 where fixed).

        A correction moves what is to be closed by a column, once or, where its size is free, by as
        much as fits best; a factor is 1 and the size. One that moves it by little more than noise
        gains nothing: of wheels that keep their rates beside a body at rest nothing is known.
        """
        nothing = Correction.nothing(nominal)
        noise = self.noise(nominal, nothing)
        target = nominal.exchanges[:, 0]
        moves = np.stack([self._move(nominal, target, each) for each in corrections], axis=1)
        free = np.array([each.is_free for each in corrections])
        recorded, left, sizes = [], [], []
        for level in self._levels(nominal, moves, noise):
            size = np.where(free, -level.common / np.maximum(level.strength, LEAST_STRENGTH), 1.0)
            closed = size * (2.0 * level.common + size * level.strength)
            impulse = level.impulse + level.moved * size
            gone = [vanishing(each, level.spread) for each in impulse.tolist()]
            recorded.append(level.cost + vanishing(level.impulse, level.spread))
            left.append(level.cost + closed + np.array(gone))
            sizes.append(size)
        best = np.argmin(left, axis=0)
        gains = min(recorded) - np.min(left, axis=0)
        gains[self._noise_share(moves) > MOST_NOISE_SHARE] = -np.inf
        return gains, np.array(sizes)[best, np.arange(len(best))]

    def _noise_share(self, moves: Array) -> Array:
        """Share (C,) of white noise in the squares of columns (p, C), from second differences."""
        square, bends = (
            np.einsum("pc,pc->c", moves, each @ moves) for each in (self.gram, self.steps)
        )
        noise = bends * self.rows / (6.0 * self.counts)
        return np.asarray(noise / np.maximum(square, LEAST_MOVE))

    def _levels(self, nominal: Nominal, moves: Array, noise: float) -> Iterator[_Level]:
        """The balance with each size of the torque that wanders, and columns ``moves`` (p, C)."""
        names, design = self._present(*nominal.departures)
        weights = np.concatenate([design, moves, nominal.exchanges[:, :1]], axis=1)
        inner = weights.T @ (self.gram @ weights) / noise**2
        number, wanders = len(names), np.array(names) == "drift"
        nothing = Correction.nothing(nominal)
        share, spread = self._impulse(names, nominal, nothing)
        right = np.column_stack([inner[:number, number:], share])
        for level in DRIFT_LEVELS:
            scale = np.where(wanders, level, 1.0)[:, None]
            covariance = np.eye(number) + scale * inner[:number, :number] * scale.T
            factor = np.linalg.cholesky(covariance)
            solved = solve_triangular(factor, scale * right, lower=True, check_finite=False)
            impulse, solved = solved[:, -1] @ solved[:, :-1], solved[:, :-1]
            # what departures do not take of the columns
            rest = inner[number:, number:] - solved.T @ solved
            volume = 2.0 * float(np.log(np.diag(factor)).sum())
            price = float(np.log(level * WIDTHS["drift"] / USUAL_DRIFT) ** 2)
            yield _Level(
                float(rest[-1, -1]) + volume + price,
                np.diag(rest)[:-1],
                rest[:-1, -1],
                1.0 + float(impulse[-1]),
                impulse[:-1],
                spread,
            )

    def _move(self, nominal: Nominal, target: Array, correction: Correction) -> Array:
        """Weights (p,) by which a correction moves what is to be closed, at a size of 1."""
        for _, weights in free_columns(nominal, correction):
            return weights
        return corrected(self.columns, target[:, None], correction)[:, 0] - target

    def _impulse(
        self, names: Sequence[str], nominal: Nominal, correction: Correction
    ) -> tuple[Array, float]:
        """What 1 σ of each departure (J,) adds to the impulse of all firings, and its variance.

        Both as shares of the impulse.
        """
        size = np.linalg.norm(nominal.torques, axis=0)
        pulses = size * (correction.thruster @ self.pulses)
        on = correction.on_time * size * (correction.thruster @ self.on_time_s)
        on = on + nominal.tail_s * pulses
        kinds = np.array(names)
        share = np.zeros(len(names))
        share[kinds == "common"] = WIDTHS["common"] * on.sum()
        share[kinds == "tail"] = WIDTHS["tail"] * pulses.sum()
        share[kinds == "thrust"] = WIDTHS["thrust"] * on
        share[kinds == "own tail"] = WIDTHS["own tail"] * pulses
        share /= max(float(on.sum()), LEAST_IMPULSE)
        # a tail may grow by more than there is of it, but not shrink
        less = np.where(kinds == "tail", min(1.0, nominal.tail_s / WIDTHS["tail"]), 1)
        return share, float(np.sum((less * share) ** 2))


@dataclass(frozen=True, eq=False)
class MomentumFit:
    """What closing the balance costs, what stays open (RMS, N m s), factors of free wheels.

    ``impulse`` is the share of the nominal impulse that departures leave of all firings.

    ``excess`` is the misfit with departures at their price less the misfit with all of them
    nearly free, less what noise alone may make of that, and what even then stays beyond noise.
    """

    excess: float
    open_nms: float
    factors: Array
    impulse: float


@dataclass(frozen=True, eq=False)
class _Level:
    """A balance with one size of the torque that wanders, and C columns that may move it.

    ``cost`` is −2 log of its evidence but for a constant; ``strength`` and ``common`` (C,) are
    inner products of the columns with themselves and with what is to be closed, departures
    projected out; ``impulse`` is the share of the nominal impulse that the best departures leave of
    all firings, a column moves it by ``moved`` (C,), and ``spread`` is the variance of its prior.
    """

    cost: float
    strength: Array
    common: Array
    impulse: float
    moved: Array
    spread: float


def vanishing(level: float, variance: float) -> float:
    """What it costs beyond the normal prior that firing falls to ``level`` of its nominal impulse.

    A normal prior of ± 15 % lets it fall to nothing for the price of seven standard deviations,
    and with it all momentum that a mistake left open. Its logarithm is what has a width, of
    ``variance``.
    """
    level = min(max(level, 1e-3), 1.0)
    return float((np.log(level) ** 2 - (level - 1.0) ** 2) / variance) if variance > 0.0 else 0.0


def momentum_of(
    rows: Rows,
    nominal: Nominal,
    along: Array | None = None,
    swing_hz: float = 0.0,
    bias_rad_s: Array | None = None,
) -> Momentum:
    """Columns of an event's rows and their Gram matrices.

    ``nominal``: its torques and tails are what pulses bring. ``swing_hz``: of a boom that may
    oscillate; 0: of none.
    ``bias_rad_s``: (3,) that rates may be off by, 1 σ; without it that of :data:`WIDTHS`.
    ``along``: a body axis (3,) along which nothing is known, so that rows speak of the plane across
    it alone: the columns are those of a wheel that says nothing.
    """
    turn = direction_cosines(rows.attitude).transpose(0, 2, 1)
    count, wheels, thrusters = len(turn), rows.wheel_rpm.shape[1], rows.on_time_s.shape[1]
    columns = Columns(wheels, thrusters)
    table = np.zeros((count, 3, columns.size))
    middle = 0.5 * (turn[1:] + turn[:-1])

    def accumulated(increments: Array) -> Array:
        """∫ Cᵀ e_a dx_j, as (n, 3, 3 J)."""
        steps = middle[:, :, :, None] * increments[:, None, None, :]
        sums = np.cumsum(steps, axis=0)
        whole = np.concatenate([np.zeros((1, *sums.shape[1:])), sums])
        return whole.reshape(count, 3, -1)

    def carried(values: Array) -> Array:
        """Cᵀ e_a x_j, as (n, 3, 3 J)."""
        return (turn[:, :, :, None] * values[:, None, None, :]).reshape(count, 3, -1)

    time = rows.time_s - rows.time_s[0]
    warm = np.exp(-(rows.on_time_s - rows.on_time_s[0]) / WARM_UP_S)
    fired = accumulated(np.diff(rows.on_time_s, axis=0))
    modes = brownian_modes(time, DRIFT_MODES)
    of = columns.of
    table[:, :, of["rate"]] = carried(rows.rate_rad_s)
    table[:, :, of["wheel"]] = carried(RAD_S_PER_RPM * rows.wheel_rpm)
    table[:, :, of["rate around"]] = carried(_around(rows.rate_rad_s))
    table[:, :, of["wheel around"]] = carried(RAD_S_PER_RPM * _around(rows.wheel_rpm))
    # what a row has fired more than the rows around it, whose mean rate does not show it
    thrust_s = nominal.thrust_s(rows)
    table[:, :, of["fire beside"]] = carried(thrust_s - _around(thrust_s))
    table[:, :, of["fire"]] = fired
    table[:, :, of["pulse"]] = accumulated(np.diff(rows.pulses, axis=0))
    table[:, :, of["warm up"]] = accumulated(-WARM_UP_S * np.diff(warm, axis=0))
    table[:, :, of["flow"]] = np.gradient(fired, time, axis=0) if thrusters else fired
    table[:, :, of["torque"]] = accumulated(np.diff(time)[:, None])
    table[:, :, of["fixed"]] = carried(np.ones((count, 1)))
    off = np.full(3, WIDTHS["bias"]) if bias_rad_s is None else bias_rad_s
    table[:, :, of["bias"]] = turn * off
    jumped = np.arange(count)[:, None] >= largest_jumps(rows.wheel_rpm)
    table[:, :, of["jump"]] = carried(jumped.astype(np.float64))
    flow = np.gradient(rows.wheel_rpm, time, axis=0)
    table[:, :, of["wheel flow"]] = carried(RAD_S_PER_RPM * flow)
    table[:, :, of["drift"]] = np.einsum("ia,nj->niaj", np.eye(3), modes).reshape(count, 3, -1)
    shots = np.cumsum(close_pulses(rows) @ (nominal.torques**2).T, axis=0)
    walks = np.stack([brownian_modes(clock, CUT_MODES) for clock in shots.T], axis=1)
    table[:, :, of["cut"]] = np.einsum("nia,naj->niaj", turn, walks).reshape(count, 3, -1)
    table[:, :, of["swing"]] = carried(swing_modes(time, swing_hz))
    start = np.broadcast_to(np.eye(3), (count, 3, 3))
    per_row = 3
    if along is not None:
        axis = np.einsum("nij,j->ni", turn, along / np.linalg.norm(along))
        table -= axis[:, :, None] * np.einsum("ni,nip->np", axis, table)[:, None, :]
        start = start - axis[:, :, None] * axis[:, None, :]
        per_row = 2
    flat = table.reshape(3 * count, -1)
    # the momentum at the start is not known: nothing along it is looked at
    unknown = np.linalg.qr(start.reshape(3 * count, 3))[0]
    flat = flat - unknown @ (unknown.T @ flat)
    smooth = np.ones(count - 2, dtype=bool)
    for row in largest_jumps(rows.wheel_rpm).tolist():
        smooth[max(row - 2, 0) : row] = False  # a wheel that jumps is no noise
    bends = (table[2:] - 2.0 * table[1:-1] + table[:-2])[smooth].reshape(-1, columns.size)
    gram, steps = flat.T @ flat, bends.T @ bends
    counts, roundings = int(np.count_nonzero(smooth)), (rounding_of(rows), rest_of(rows.wheel_rpm))
    on_time_s, pulses = (each[-1] - each[0] for each in (rows.on_time_s, rows.pulses))
    return Momentum(
        *(columns, flat, gram, steps, count, per_row, counts, *roundings, on_time_s, pulses)
    )


def brownian_modes(clock: Array, number: int) -> Array:
    """Karhunen–Loève modes (n, number) of a Brownian motion, of variance 1 per tick of a clock."""
    span = max(float(clock[-1]), LEAST_SPAN)
    orders = np.arange(number) + 0.5
    modes = np.sin(np.pi * np.outer(clock / span, orders)) * np.sqrt(2.0 * span) / (np.pi * orders)
    return np.asarray(modes)


def swing_modes(time_s: Array, swing_hz: float) -> Array:
    """Cosine and sine (n, 4) of a boom's swing, and both with an amplitude that changes evenly."""
    if not swing_hz:
        return np.zeros((len(time_s), SWING_MODES))
    phase = 2.0 * np.pi * swing_hz * time_s
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    along = 2.0 * time_s[:, None] / max(float(time_s[-1]), LEAST_SPAN) - 1.0
    return np.asarray(np.concatenate([waves, along * waves], axis=1))


def close_pulses(rows: Rows) -> Array:
    """Pulses (n, K) of each row that may have followed another at once.

    The next pulse cuts the tail of the one before, by how much counters do not show. Alone is the
    first of an interval that follows one without pulses.
    """
    gained = np.diff(rows.pulses, axis=0, prepend=rows.pulses[:1])
    quiet = np.concatenate([np.ones_like(gained[:1]), gained[:-1]]) == 0.0
    quiet[0] = True
    return np.asarray(np.maximum(gained - quiet, 0.0))


def largest_jumps(wheel_rpm: Array) -> NDArray[np.int64]:
    """Row (W,) at which each wheel's rate jumps most: by its step less those before and after."""
    steps = np.diff(wheel_rpm, axis=0)
    around = 0.5 * (steps[:-2] + steps[2:])
    return np.asarray(np.argmax(np.abs(steps[1:-1] - around), axis=0) + 2)


def rounding_of(rows: Rows) -> Array:
    """Variance (K,) in s² that rounding brings to a cumulative on-time.

    A counter in coarse steps shows pulses without on-time (on-time without a pulse may be a long
    one that goes on). Its error is
    spread evenly over a step and stays until the next firing, so it is no noise of single rows,
    which second differences would find; being shared by rows, it counts :data:`SHARED` times.
    """
    on, pulses = np.diff(rows.on_time_s, axis=0), np.diff(rows.pulses, axis=0)
    empty = (pulses > 0.0) & (on == 0.0)
    # a pulse that begins as the row is taken has its on-time in the next one
    rounded = (empty[:-1] & (on[1:] == 0.0)).any(axis=0)
    # counters gain whole steps: the least difference of two gains is one
    gains = [np.unique(np.round(np.append(column, 0.0), 6)) for column in on.T]
    step = [float(np.diff(each).min(initial=np.inf)) for each in gains]
    return np.where(rounded, SHARED * np.square(step) / 12.0, 0.0)


def is_resting(wheel_rpm: Array) -> NDArray[np.bool_]:
    """Whether each wheel (W,) shows :data:`RESTING` values at most in its rows (n, W)."""
    return np.array([len(np.unique(column)) <= RESTING for column in wheel_rpm.T], dtype=bool)


def rest_of(wheel_rpm: Array) -> Array:
    """Variance (W,) in (rad/s)² that rounding brings to the rate of a wheel at rest (n, W) in rpm.

    What such a wheel is off by stays while its printed value stays, and second differences do not
    see it: a twelfth of a step's square counts for as many rows as a value is shown in a row, in
    the mean. A wheel that shows one value alone is off by a constant, which costs nothing.
    """
    result = np.zeros(wheel_rpm.shape[1])
    for w, column in enumerate(wheel_rpm.T):
        values = np.unique(column)
        if 1 < len(values) <= RESTING:
            shown = len(column) / (1 + np.count_nonzero(np.diff(column)))
            step = RAD_S_PER_RPM * float(np.diff(values).min())
            result[w] = shown * step**2 / 12.0
    return result


def _around(values: Array) -> Array:
    """The mean of the rows before and after each row.

    Departures of inertias act on it in place of the row itself: they must not find that a smaller
    inertia makes a noisy channel quieter.
    """
    ends = (values[[1]], 0.5 * (values[:-2] + values[2:]), values[[-2]])
    return np.concatenate(ends)
