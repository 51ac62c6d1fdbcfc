"""Columns for the effective on-time of pulses, whose pulse parameters are not yet known.

The effective time g(w; τ) of a pulse of width w is not linear in τ = (τ_d, τ_r, τ_f), and rows are
summed before τ is known. So it is written as a sum of products of known functions of the width and
functions of τ. With g₀ that of the reference parameters, and few widths w_j,

    g(w; τ) = g₀(w) + Σ_j b_j(w) [g(w_j; τ) − g₀(w_j)],

where the functions b_j are those that fit best, in least squares, over a range of τ_r and τ_f. That
is exact at the reference and at the widths w_j. Over the priors of τ_r and τ_f any pulse
is right within some 4e-5 s (rms); slopes at the reference leave 1e-3 s for a pulse of 15 ms.
A last column is 1 for every pulse: pulses that go on for longer need it, all others leave it idle.
(docs/topics/telemetry-likelihood.md §1)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array, Flags
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.spacecraft.pulses import PulseShape

# Below and above the rise time, where the effective time bends, and a pulse that has reached its
# thrust. (Two widths leave 1.5e-4 s and make likelihood calls a fifth faster; in three biases with
# pulses of 7 to 125 ms the slopes at the truth then have 1.4 times their scatter.)
WIDTHS_S: Final = (0.012, 0.04, 0.5)
# Pulses from here on have reached their thrust: one width is enough, to 8e-5 s (rms), and columns
# that have nothing to tell cost nothing.
LONG_S: Final = 0.12
# (20 µs)² of a firing, 0.3 ms after some hundred: less than what torque noise does in a minute
LEAST_SCATTER_S2: Final = 4e-10
FEW: Final = 6  # pulses of a firing, whose widths are looked for one by one
USUAL: Final = 24  # widths of pulses that weights of longer pulses are fitted over (judgement)
GRID_S: Final = 1e-3  # of sums of their widths, and by how much these may be off (one standard
SMOOTH_S: Final = 1.5e-3  # deviation): commands are no exact sample of those seen elsewhere
SURELY: Final = 5.0  # standard deviations by which a sum is too small for widths of the event
ANY: Final = 128  # widths that stand for all: 1.5 ms apart where pulses last 100 ms
LEAST_CHANCE: Final = 1e-4  # of the likeliest sum: below it no widths of the event add up to it
PULSE_COLUMNS: Final = ("reference", *(f"{1e3 * width:g}_ms" for width in WIDTHS_S), "count")
# Multiples of the reference time constants at which the functions of the width are fitted: what
# priors allow (two standard deviations are 0.25 of τ_rise and 0.8 of τ_fall), and beyond.
_RISES: Final = np.linspace(0.6, 1.4, 9)
_FALLS: Final = np.linspace(0.2, 2.0, 7)
_SLOPE_S: Final = 1e-3  # of a firing's on-time, by which columns are compared
_STEEPEST: Final = 700.0  # exponent at which one value has all the weight, in their range
_HALVINGS: Final = 50  # of that range, to rounding


@dataclass(frozen=True)
class PulseBasis:
    """Effective times of pulses as columns, which depend on widths, times weights of τ.

    ``reference_s`` are the τ_delay, τ_rise, τ_fall at which the first column is exact, in s.
    ``widths_s`` are what single pulses are like, all as likely; none if that is not known.
    ``unsure_s`` is how well the on-time of a firing is known, one standard deviation.
    """

    shape: PulseShape
    reference_s: tuple[float, float, float]
    widths_s: tuple[float, ...] = ()
    unsure_s: float = 0.0

    @cached_property
    def nodes_s(self) -> Array:
        """The widths w_j; of an event without short pulses its median width alone, s."""
        if self.widths_s and min(self.widths_s) >= LONG_S:
            return np.median(self.widths_s, keepdims=True)
        return np.array(WIDTHS_S)

    def columns(self, width_s: Array) -> Array:
        """g₀, b_j and 1 (…, C) at widths (…), s; zero for widths w_j that are not needed."""
        gained = self._gained(np.asarray(width_s)[..., None], *self._range)
        value = self.shape.effective_time(width_s, *self.reference_s)
        columns = _filled(np.concatenate([value[..., None], gained @ self._fit], axis=-1))
        columns[..., -1] = 1.0
        return columns

    def expected_columns(self, mean_s: Array, count: Array) -> Array:
        """Mean of the columns (R, C) of ``count`` (R,) pulses whose mean width is known, s.

        The effective time is not linear in the width: short and long pulses deliver less than as
        many of their mean width. Of a few pulses the sum tells which widths they may have: those
        of the event that add up to it. Of many, or where none add up to it, widths w_q have
        probabilities that go as exp(λ w_q), with λ such that Σ p_q w_q is the mean m; each of n
        pulses then has 1 − 1/n of that scatter. A few pulses that are too short together for
        those of the event have any widths (:attr:`_of_any_width`).
        """
        alike = self.columns(mean_s)
        for inside, basis in self._scatters(mean_s, count):
            widths = np.array(basis.widths_s)
            chance, share = basis._chances(mean_s[inside], count[inside])
            mixed = chance @ self.columns(widths) - self.columns(chance @ widths)
            mixed += self.columns(mean_s[inside]) - alike[inside]
            alike[inside] += share[:, None] * mixed
        return alike

    def slopes(self, mean_s: Array, count: Array) -> Array:
        """Slopes (R, C) of what is expected of firings in their on-time; (1, 0, …) of long ones.

        A counter's error is multiplied by them: pulses shorter than their rise gain faster than
        their on-time.
        """
        step = _SLOPE_S / count
        below, above = np.maximum(mean_s - step, 0.0), mean_s + step
        gained = self.expected_columns(above, count) - self.expected_columns(below, count)
        return np.asarray(gained / (above - below)[:, None])

    def scatter(self, mean_s: Array, count: Array) -> Array:
        """Covariance (R, C, C), s², of what columns of unlike pulses gain beyond what is expected.

        Of widths w with a known sum: each pulse scatters as the part of the columns does that is
        not linear in w (right for many; the true variance is 1.0 to 1.7 times it for three to
        sixteen). Of two pulses, the second has what the first leaves.
        """
        result = np.zeros((len(count), len(PULSE_COLUMNS), len(PULSE_COLUMNS)))
        for inside, basis in self._scatters(mean_s, count):
            widths = np.array(basis.widths_s)
            chance, share = basis._chances(mean_s[inside], count[inside])
            columns = self.columns(widths)
            away = widths - (chance @ widths)[:, None]  # near an end of the range not the mean
            off = columns - (chance @ columns)[:, None]
            by_width = np.einsum("rq,rq,rqc->rc", chance, away, off)
            variance = np.maximum((chance * away**2).sum(axis=1), np.finfo(float).tiny)
            off = off - away[:, :, None] * (by_width / variance[:, None])[:, None]
            off *= np.sqrt(count[inside, None, None])
            two = (count[inside] == 2.0) & (share == 1.0)
            left_s = np.maximum(2.0 * mean_s[inside][two, None] - widths, 0.0)
            both = columns + self.columns(left_s)
            off[two] = both - np.einsum("rq,rqc->rc", chance[two], both)[:, None]
            result[inside] = np.einsum("rq,rqc,rqd->rcd", chance, off, off)
        most = np.einsum("tc,rcd,td->rt", self._weights, result, self._weights, optimize=True)
        result[most.max(axis=1) < LEAST_SCATTER_S2] = 0.0
        return result

    def _scatters(self, mean_s: Array, count: Array) -> list[tuple[Flags, PulseBasis]]:
        """Which firings (R,) have pulses that may be of unlike widths, and the basis with these."""
        if not self.widths_s:
            return []
        least, several = min(self.widths_s), count > 1.0
        within = (mean_s > least) & (mean_s < max(self.widths_s))
        short = count * (least - mean_s) > SURELY * self._smooth_s
        short &= (mean_s > 0.0) & (count <= FEW)
        each = [(several & within, self), (several & short, self._of_any_width)]
        return [(firings, basis) for firings, basis in each if firings.any()]

    @cached_property
    def _of_any_width(self) -> PulseBasis:
        """The same with all widths as likely, up to twice the least of the event's pulses."""
        widths = 2.0 * min(self.widths_s) * (np.arange(ANY) + 0.5) / ANY
        return replace(self, widths_s=tuple(widths.tolist()))

    def _chances(self, mean_s: Array, count: Array) -> tuple[Array, Array]:
        """Probabilities (R, Q) of widths in firings, and the share (R,) of their scatter."""
        widths = np.array(self.widths_s)
        chance, share = _tilted(widths, mean_s), 1.0 - 1.0 / count
        for n, sums in self._sums.items():
            own = np.flatnonzero(count == n)
            others_s = n * mean_s[own, None] - widths
            found = np.interp(others_s / GRID_S, np.arange(len(sums)) - self._reach, sums, 0.0, 0.0)
            possible = found.mean(axis=1) > LEAST_CHANCE * sums.max()
            own, found = own[possible], found[possible]
            chance[own], share[own] = found / found.sum(axis=1, keepdims=True), 1.0
        return chance, share

    @cached_property
    def _reach(self) -> int:
        """Steps of the grid that a sum is smoothed over, on either side."""
        return int(np.ceil(5.0 * self._smooth_s / GRID_S))

    @property
    def _smooth_s(self) -> float:
        return float(np.hypot(SMOOTH_S, self.unsure_s))

    @cached_property
    def _sums(self) -> dict[int, Array]:
        """How likely the other n − 1 of n pulses add up to so much, on a grid, by n."""
        one = np.bincount(np.round(np.array(self.widths_s) / GRID_S).astype(np.int64))
        offset = GRID_S * np.arange(-self._reach, self._reach + 1)
        others, result = np.exp(-0.5 * (offset / self._smooth_s) ** 2), {}
        for n in range(2, FEW + 1):
            result[n] = others = np.convolve(others, one / one.sum())
        return result

    def longer(self, tau_s: Sequence[Array], offset_s: Array) -> Array:
        """What weights gain if every pulse goes on for longer, by ``offset_s`` (n, K): (n, K, C).

        Those whose sum of columns is nearest to g(w + offset) − g(w), in least squares over widths
        w of the event's pulses. A negative offset leaves nothing of pulses that are shorter.
        """
        if not offset_s.any():
            return np.zeros((*offset_s.shape, len(PULSE_COLUMNS)))
        widths, fit = self._usual_widths
        own = [np.asarray(tau)[..., None, None] for tau in tau_s]
        longer = self.shape.longer_time(widths, offset_s[..., None], *own)
        gained = longer - self.shape.effective_time(widths, *own)
        return np.asarray(gained @ fit)

    @cached_property
    def _usual_widths(self) -> tuple[Array, Array]:
        """Widths (Q,) of pulses, of all kinds if the event's are not known, and weights (Q, C).

        Values (Q,) at the widths times these are the weights of the columns nearest to them.
        """
        widths = np.geomspace(WIDTHS_S[0], WIDTHS_S[-1], USUAL)
        if self.widths_s:
            widths = np.quantile(self.widths_s, np.linspace(0.0, 1.0, USUAL))
        return widths, np.asarray(np.linalg.pinv(self.columns(widths), rcond=1e-6).T)

    def of_thrusters(self, tau_s: Sequence[Array], offset_s: Array) -> Array:
        """Weights (n, K, C), at τ (n,), of pulses longer by ``offset_s`` (n, K); times in s."""
        return np.asarray(self.weights(tau_s)[..., None, :] + self.longer(tau_s, offset_s))

    def weights(self, tau_s: Sequence[Array]) -> Array:
        """1, what pulses of the widths w_j gain, and 0, (…, C) at pulse parameters (…), s."""
        gained = self._gained(self.nodes_s, *(np.asarray(tau)[..., None] for tau in tau_s))
        return _filled(np.concatenate([np.ones_like(gained[..., :1]), gained], axis=-1))

    def _gained(self, width_s: Array, delay_s: Array, rise_s: Array, fall_s: Array) -> Array:
        """Effective time beyond that at the reference; the arguments broadcast."""
        reference = self.shape.effective_time(width_s, *self.reference_s)
        return self.shape.effective_time(width_s, delay_s, rise_s, fall_s) - reference

    @cached_property
    def _range(self) -> tuple[Array, Array, Array]:
        delay, rise, fall = self.reference_s
        rises, falls = np.meshgrid(rise * _RISES, fall * _FALLS)
        return np.full(rises.size, delay), rises.ravel(), falls.ravel()

    @cached_property
    def _weights(self) -> Array:
        """Weights (T, C) at every point of the range, the reference among them."""
        delay, rise, fall = self._range
        at_reference = np.eye(1, len(PULSE_COLUMNS))
        return np.concatenate([at_reference, self.weights((delay, rise, fall))])

    @cached_property
    def _fit(self) -> Array:
        """The b_j of a width (T, J) per gain at every point of the range."""
        by_width = self._gained(self.nodes_s[:, None], *self._range)
        return np.asarray(np.linalg.pinv(by_width, rcond=1e-9))


def _filled(columns: Array) -> Array:
    """All of :data:`PULSE_COLUMNS` (…, C), zero where there are fewer widths, and the count."""
    missing = len(PULSE_COLUMNS) - columns.shape[-1]
    return np.concatenate([columns, np.zeros((*columns.shape[:-1], missing))], axis=-1)


def _tilted(values: Array, mean: Array) -> Array:
    """Probabilities (R, Q) ∝ exp(λ v) of values (Q,) with given means (R,) inside their range."""
    unit = values.max() - values.min()
    scaled, wanted = (values - values.min()) / unit, (mean - values.min()) / unit
    low, high = np.full(len(mean), -_STEEPEST), np.full(len(mean), _STEEPEST)
    for _ in range(_HALVINGS):
        slope = 0.5 * (low + high)
        weights = np.exp(slope[:, None] * (scaled - (slope > 0.0)[:, None]))
        weights /= weights.sum(axis=1, keepdims=True)
        above = weights @ scaled > wanted
        low, high = np.where(above, low, slope), np.where(above, slope, high)
    return np.asarray(weights)
