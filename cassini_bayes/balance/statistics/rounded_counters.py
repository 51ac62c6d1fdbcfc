"""Cumulative on-times as they were, from counters that are rounded.

A counter shows C_m + δ_m after firing run m: C_m the commanded on-time so far, δ_m its rounding,
bounded by half a step and independent of that of other readings, so that it does not add up. With
all pulses alike, C_m = w n_m, only the roundings tell on-time from pulse count: a regression on the
readings takes them for the difference between thrust and tail-off, and finds too little thrust
(errors in variables). The remedy is to regress on what is expected of C_m given all readings
(regression calibration), and to count what that leaves open as noise.

Where commands come in a control cycle's quantum and every reading agrees with a multiple of it, C_m
is known exactly. Otherwise the on-time of firing m has the variance v_m about n w, so that with σ²
= step²/12

    Δu_m = n_m w + e_m + δ_m − δ_{m−1},   Var(Δu) = diag(v) + σ² tridiag(−1, 2, −1),

w by least squares and v_m = v n_m times how far the firing departs, as of Student's t, v by all the
thrusters; E[Δc | u] = n w + diag(v) Var⁻¹ (Δu − n w). What stays open of the levels C_m is a
random walk of steps v_m seen with white noise σ²: precision (1 + Dᵀ Q⁻¹ D)/σ², D the differences
and Q = diag(v)/σ². Where steps are not short beside the firings, an error of v is one of thrust.
Then only some of the readings are used: what lies between two of them counts as one firing, and the
precision has ones for these readings alone. Its pulses share its on-time as all readings say.

Pulses about one axis are alike, so w is another one for every set of thrusters that fire together
(:func:`_longer`). Roundings of widths that are nearly multiples of the step repeat, so σ² is what
they are over long times (:func:`_lasting`).
Derivation: ``docs/topics/telemetry-likelihood.md`` §7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.linalg import cholesky_banded, solveh_banded

from cassini_bayes.balance.statistics.counters import (
    LEAST_RUNS,
    Firings,
    are_quantised,
    cut_phase,
    firings,
    single_widths,
    whole_cycles,
)
from cassini_bayes.computing.arrays import Array, Flags, Places

# Least step that counts as rounding, s: what is finer leaves a hundredth of a rate sample's noise.
LEAST_STEP_S: Final = 5e-4
# Widths' variances tried, in units of the rounding's: from none to no rounding at all.
SPREADS: Final = np.concatenate([[0.0], np.logspace(-3.0, 5.0, 33)])
SPREAD_ERROR: Final = 0.3  # of the widths' variance, as some dozens of firings tell it
MOST_BIAS: Final = 1e-3  # of thrust, by an error of the widths' variance
FREEDOM: Final = 4.0  # degrees of freedom of widths: two pulses in a row count as one long one
ROUNDS: Final = 6  # of expectation and maximisation: the spread has settled to some percent
LOG_SPREAD: Final = 1.0  # by which logarithms of the variances of two thrusters' widths may differ
LEAST_WEIGHT: Final = 1e-3  # of a spread that is tried again in the next round
NEARBY: Final = 2  # spreads beside these that are tried as well
LEAST_LIKELIHOOD: Final = 1e-300  # beside the best: of a spread that is out of question
COMPANY_ROUNDS: Final = 2  # of widths by company, and of spreads beside them
COMPANY_STEPS: Final = 20  # of expectation and maximisation, of the scatter between companies
LEAST_TOGETHER: Final = 3  # firings in one company, for a width of their own
LEAST_GAP: Final = 2  # steps between readings of two kinds of pulses: one width shows two values
LEAST_DIFFERENCE: Final = 0.1  # of a step, by which thrusters' pulses of one kind differ
LEAST_SCATTER: Final = 1e-4  # between companies, over σ²: one of no size has no precision
HARMONICS: Final = 6  # of a rounding: 90 % of its variance, and all that lasts
LEAST_LASTING: Final = 0.2  # of it over long times: widths are not quite what is expected


@dataclass(frozen=True)
class OnTimes:
    """On-times expected of rounded counters.

    ``on_time_s`` (m, K) takes the place of the readings; ``rounding`` (K,) says what they leave
    open of every thruster.
    """

    on_time_s: Array
    rounding: tuple[Rounding, ...]


@dataclass(frozen=True, eq=False)
class Rounding:
    """What a rounded counter leaves open of its levels: precision (1 + Dᵀ Q⁻¹ D)/σ².

    ``step_s`` is the step of the counter, 0 where it is known, ``variance_s2`` is σ²: step²/12
    where roundings owe nothing to each other. ``ratio`` (m − 1,) is Q, the variance
    over σ² of what is gained in every interval between two readings, of no length where nothing is
    known of the widths. The 1 is there for about every ``every``-th level alone
    (:func:`read_levels`). ``width_s`` is the mean width of a pulse.
    """

    step_s: float = 0.0
    variance_s2: float = 0.0
    ratio: Array = field(default_factory=lambda: np.zeros(0))
    every: float = 1.0
    width_s: float = np.inf

    @property
    def unsure_s2(self) -> float:
        """Variance of a usual firing's on-time, given both readings and those of all others, s²."""
        fired = self.ratio[self.ratio > 0.0]
        if len(fired) == 0:
            return 2.0 * self.variance_s2
        usual = float(np.median(fired))
        return 2.0 * self.variance_s2 * usual / (usual + 2.0)


KNOWN: Final = Rounding()


def expected_on_times(on_time_s: Array, pulses: Array, step_s: float, quantum_s: float) -> OnTimes:
    """What is expected of the commanded on-times, given rounded readings.

    Parameters
    ----------
    on_time_s, pulses
        (m, K) readings of the cumulative counters, in order.
    step_s
        Their step, s; 0 where they are not rounded.
    quantum_s
        What commands may be multiples of (a control cycle), s; 0 for any width.
    """
    thrusters = range(on_time_s.shape[1])
    if step_s < LEAST_STEP_S:
        return OnTimes(np.array(on_time_s, dtype=np.float64), (KNOWN,) * len(thrusters))
    if are_quantised(on_time_s, pulses, step_s, quantum_s):
        phase_s = cut_phase(on_time_s, step_s, quantum_s)
        gained = whole_cycles(on_time_s - on_time_s[0], quantum_s, phase_s)
        return OnTimes(on_time_s[0] + gained, (KNOWN,) * len(thrusters))
    return _smoothed(on_time_s, pulses, step_s)


def _smoothed(on_time_s: Array, pulses: Array, step_s: float) -> OnTimes:
    """Expected cumulative on-times (m, K), and what stays open."""
    change, begun = np.diff(on_time_s, axis=0), np.diff(pulses, axis=0)
    fired = [firings(*each) for each in zip(change.T, begun.T, strict=True)]
    telling = [k for k, own in enumerate(fired) if len(own.seconds) >= LEAST_RUNS]
    white = step_s**2 / 12.0
    result = np.array(on_time_s, dtype=np.float64)
    left = [Rounding(step_s, white) if len(own.active) > 0 else KNOWN for own in fired]
    company = _company((change > 0.0) | (begun > 0.0), [fired[k] for k in telling])
    kinds = kinds_of(single_widths(on_time_s, on_time_s, pulses), step_s)
    told = _spreads_by_company([fired[k] for k in telling], company, kinds, white)
    for k, (spreads, longer) in zip(telling, told, strict=True):
        expected, _ = _expected(fired[k], longer, spreads, white)
        lasting = _lasting(expected, white * spreads, step_s)
        spreads, rounding = spreads / lasting, white * lasting
        expected, every = _expected(fired[k], longer, spreads, rounding)
        gained, ratio = _by_interval(fired[k], change[:, k], begun[:, k], expected, spreads)
        left[k] = Rounding(step_s, rounding, ratio, every, _mean_pulse(fired[k]))
        result[1:, k] = on_time_s[0, k] + np.cumsum(gained)
    return OnTimes(result, tuple(left))


def _company(fires: Flags, fired: Sequence[Firings]) -> list[Places]:
    """With which thrusters each thruster's firings (R,) came, as a number for every such set.

    ``fires`` (m, K) tells in which intervals each did.
    """
    sets = []
    for own in fired:
        together = np.zeros((len(own.seconds), fires.shape[1]), dtype=bool)
        np.logical_or.at(together, own.number, fires[own.active])
        sets.append(np.unique(together, axis=0, return_inverse=True)[1].ravel())
    return sets


@dataclass(frozen=True)
class Kinds:
    """Two kinds of pulses of an event, short ones and long ones.

    ``width_s`` (2,) are means of single pulses of all thrusters, ``variance_s2`` (2,) those of
    widths about them.
    """

    width_s: Array
    variance_s2: Array

    def pulses(self, own: Firings) -> Array:
        """How many (R, 2) of either kind add up to what is nearest to the on-time of firings."""
        short, long = self.width_s
        longer = np.round((own.seconds - own.pulses * short) / (long - short))
        longer = np.clip(longer, 0.0, own.pulses)
        return np.stack([own.pulses - longer, longer], axis=1)

    def longer(self, own: Firings, rounding: float) -> tuple[Array, Array]:
        """By how much firings (R,) last longer than pulses of one width, s; how unsure, over σ².

        A thruster's pulses of a kind have a width of their own, Gaussian about that of all. Of a
        kind in less than :data:`LEAST_TOGETHER` firings that width is not known well.
        """
        of_kind = self.pulses(own)
        alike = np.ones_like(own.seconds)
        solved = np.stack([_solve(each, alike, rounding) for each in of_kind.T], axis=1)
        covariance = np.linalg.inv(of_kind.T @ solved + np.diag(1.0 / self.variance_s2))
        width = covariance @ (solved.T @ own.seconds + self.width_s / self.variance_s2)
        rare = (of_kind > 0.0).sum(axis=0) < LEAST_TOGETHER
        unsure = of_kind**2 @ np.where(rare, np.diag(covariance), 0.0) / rounding
        return of_kind @ width - own.pulses * _mean_pulse(own), unsure


def kinds_of(alone: Array, step_s: float) -> Kinds | None:
    """Two kinds of pulses, if a gap between readings of single ones is wider than roundings are.

    ``alone`` (m,) are what counters of a step show of single pulses, s.
    """
    shown, often = np.unique(np.round(alone / step_s), return_counts=True)
    usual = shown[often >= LEAST_TOGETHER]
    gaps = np.diff(usual)
    if len(gaps) == 0 or gaps.max() < LEAST_GAP:
        return None
    place = int(np.argmax(gaps))
    is_long = alone > 0.5 * step_s * (usual[place] + usual[place + 1])
    groups = alone[~is_long], alone[is_long]
    scatter = np.array([np.var(group) for group in groups]) - step_s**2 / 6.0
    least = (LEAST_DIFFERENCE * step_s) ** 2
    return Kinds(np.array([group.mean() for group in groups]), np.maximum(scatter, least))


def _spreads_by_company(
    fired: Sequence[Firings],
    company: Sequence[Places],
    kinds: Kinds | None,
    rounding: float,
) -> list[tuple[Array, Array]]:
    """Variances (R,) over σ² (:func:`_spreads`) of firings beside what is usual in their company.

    With each how much longer (R,), s, a firing is for it (:func:`_longer`). What is usual in a
    company that hardly ever came is not known: there its pulses have the scatter between companies
    of the thruster for which it is largest, as one controller commands all.
    """
    nothing = [(np.zeros_like(own.seconds),) * 2 for own in fired]
    by_kind = nothing if kinds is None else [kinds.longer(own, rounding) for own in fired]
    fired = [
        own._replace(seconds=own.seconds - more)
        for own, (more, _) in zip(fired, by_kind, strict=True)
    ]
    spreads = _spreads(fired, rounding)
    longer, scatter = [np.zeros_like(own.seconds) for own in fired], 0.0
    for _ in range(COMPANY_ROUNDS):
        each = zip(fired, spreads, company, strict=True)
        found = [_longer(own, spread, sets, rounding) for own, spread, sets in each]
        longer, scatter = [more for more, _ in found], max((s for _, s in found), default=0.0)
        if not any(more.any() for more in longer):
            break
        beside = [
            own._replace(seconds=own.seconds - more)
            for own, more in zip(fired, longer, strict=True)
        ]
        spreads = _spreads(beside, rounding)
    spreads = [
        spread + np.where(_is_usual(sets), 0.0, own.pulses**2 * scatter / rounding)
        for own, spread, sets in zip(fired, spreads, company, strict=True)
    ]
    return [
        (spread + unsure, more + of_kind)
        for spread, more, (of_kind, unsure) in zip(spreads, longer, by_kind, strict=True)
    ]


def _is_usual(company: Places) -> Flags:
    """Whether the company of a firing (R,) is one that has a width of its own."""
    return np.asarray(np.bincount(company)[company] >= LEAST_TOGETHER)


def _longer(own: Firings, spreads: Array, company: Places, rounding: float) -> tuple[Array, float]:
    """By how much firings (R,) are longer than usual, by what thrusters they came with, s.

    Pulses about one axis are alike, and a thruster serves several. Those of a set of thrusters last
    γ longer than all, γ Gaussian about 0 with a variance s² that is inferred by expectation and
    maximisation. With A the covariance of firings and Z their pulses by sets,

        (Zᵀ A⁻¹ Z + 1/s²) γ = Zᵀ A⁻¹ (u − n w).

    With it s², none where sets cannot be compared.
    """
    usual = np.unique(company[_is_usual(company)])
    if len(usual) == 0 or len(np.unique(company)) < 2:
        return np.zeros_like(own.seconds), 0.0
    sets = own.pulses[:, None] * (company[:, None] == usual)
    solved, whole = (_solve(each, spreads, rounding) for each in (sets, own.pulses))
    gram, by_count = sets.T @ solved, sets.T @ whole
    square, unit = rounding, np.eye(len(usual))
    for _ in range(COMPANY_STEPS):
        covariance = np.linalg.inv(gram + unit / square)
        # the mean width, by generalised least squares with the sets' scatter in the covariance
        weights = whole - solved @ (covariance @ by_count)
        width = float(weights @ own.seconds / (weights @ own.pulses))
        gamma = covariance @ (solved.T @ own.seconds - width * by_count)
        square = max(float(np.mean(gamma**2 + np.diag(covariance))), LEAST_SCATTER * rounding)
    return np.asarray(sets @ gamma), square if len(usual) > 1 else 0.0


def _lasting(expected: Array, variance_s2: Array, step_s: float) -> float:
    """Variance of roundings over long times, over that of independent ones.

    The rounding of C is a sawtooth; its harmonic h has the share 6/(πh)² of the variance. From one
    reading to another the on-times gain D, with variances v: the correlation is
    Σ_h 6/(πh)² exp(−2π²h²v/step²) cos(2πhD/step). Widths that are nearly multiples of the step and
    hardly scatter leave the same rounding again and again.

    Parameters
    ----------
    expected, variance_s2
        (R,) on-times of firings, s, and their variances.
    """
    order = np.arange(1, HARMONICS + 1)
    share = 6.0 / (np.pi * order) ** 2
    phase = 2.0 * np.pi * order * expected[:, None] / step_s
    kept = np.exp(-0.5 * (2.0 * np.pi * order / step_s) ** 2 * variance_s2[:, None] + 1j * phase)
    before, total = np.zeros(HARMONICS, dtype=np.complex128), 0.0
    for one in kept:
        before = one * (before + 1.0)
        total += float(share @ before.real)
    return max(1.0 + 2.0 * total / (len(kept) + 1), LEAST_LASTING)


def _mean_pulse(fired: Firings) -> float:
    """Mean width of a thruster's pulses, s."""
    return float(fired.seconds.sum() / fired.pulses.sum())


def _expected(
    fired: Firings, longer: Array, spreads: Array, rounding: float
) -> tuple[Array, float]:
    """On-times (R,) expected of firings, and how many lie between two readings that are used.

    ``longer`` (R,) is what is usual of firings beside their pulses of one width, s, ``rounding``
    the variance of a rounding over long times, s².
    """
    seconds, count = fired.seconds - longer, fired.pulses
    usual = max(_mean_pulse(fired) * float(count.mean()), LEAST_STEP_S)
    every = _spacing(float(spreads.mean()), np.sqrt(rounding) / usual)
    starts = read_levels(len(seconds) + 1, every)[:-1]
    together, pulses, own = (np.add.reduceat(each, starts) for each in (seconds, count, spreads))
    width = _mean_width(together, pulses, own, rounding)
    # sums of several firings by the readings that are used, and within them by all
    sums = pulses * width + _departing(together, pulses, width, own, rounding)
    within = count * width + _departing(seconds, count, width, spreads, rounding)
    lacking = (sums - np.add.reduceat(within, starts)) / pulses
    beyond = count * np.repeat(lacking, np.diff(starts, append=len(seconds)))
    return within + beyond + longer, every


def _by_interval(
    fired: Firings, change: Array, begun: Array, *of_firings: Array
) -> tuple[Array, ...]:
    """What firings (R,) have, shared out to a thruster's counter intervals (m − 1,).

    Within a firing by what the readings show; where it is too short to show anything, by pulses.
    """
    active, run = fired.active, fired.number
    shown = np.where(fired.seconds[run] > 0.0, change[active], begun[active])
    share = shown / np.bincount(run, shown)[run]
    result = np.zeros((len(of_firings), len(change)))
    result[:, active] = np.array(of_firings)[:, run] * share
    return tuple(result)


def _spreads(fired: Sequence[Firings], rounding: float) -> list[Array]:
    """Variances (R,) of firings' on-times over σ²: of one spread, times how far each departs.

    By expectation and maximisation for widths that are Student's t: a pulse that is twice as long
    as all others is believed, and does not make the others uncertain. The spread is its mean over
    what all thrusters say (:func:`_shared`), and not where its likelihood is largest: few firings
    often say "none at all".
    """
    if not fired:
        return []
    scaled, near = [own.pulses for own in fired], slice(None)
    for _ in range(ROUNDS):
        tried = SPREADS[near]
        log_p = np.array(
            [
                [_log_likelihood(own.seconds, own.pulses, s * each, rounding) for s in tried]
                for own, each in zip(fired, scaled, strict=True)
            ]
        )
        weights = _shared(log_p, tried)
        spread = weights @ tried
        scaled = [
            own.pulses * _departures(own, s * each, s, rounding)
            for own, each, s in zip(fired, scaled, spread, strict=True)
        ]
        likely = np.searchsorted(SPREADS, tried[(weights > LEAST_WEIGHT).any(axis=0)])
        near = slice(max(likely[0] - NEARBY, 0), likely[-1] + NEARBY + 1)
    return [s * each for s, each in zip(spread, scaled, strict=True)]


def _shared(log_p: Array, tried: Array) -> Array:
    """Weights (K, S) of spreads for every thruster, by its own log likelihoods (K, S) and others'.

    One controller commands all: logarithms of their spreads are Gaussian about a common one, of
    which nothing is known before.
    """
    place = np.log(np.maximum(tried, SPREADS[1] / 2.0))
    alike = np.exp(-0.5 * (np.subtract.outer(place, place) / LOG_SPREAD) ** 2)
    alike /= alike.sum(axis=0)
    own = np.exp(log_p - log_p.max(axis=1)[:, None])
    by_common = np.log(np.maximum(own @ alike, LEAST_LIKELIHOOD))
    of_others = by_common.sum(axis=0) - by_common
    others = np.exp(of_others - of_others.max(axis=1)[:, None])
    weights = own * (others @ alike.T)
    return np.asarray(weights / weights.sum(axis=1)[:, None])


def _departing(
    seconds: Array, count: Array, width: float, spreads: Array, rounding: float
) -> Array:
    """What is expected of firings (R,) beyond pulses of a width: diag(v) Var⁻¹ (Δu − n w)."""
    return rounding * spreads * _solve(seconds - count * width, spreads, rounding)


def _departures(own: Firings, spreads: Array, spread: float, rounding: float) -> Array:
    """How much larger than usual the variances of firings (R,) are, by how far each departs."""
    width = _mean_width(own.seconds, own.pulses, spreads, rounding)
    departs = _departing(own.seconds, own.pulses, width, spreads, rounding)
    squares = departs**2 / (rounding * max(spread, SPREADS[1]) * own.pulses)
    return np.asarray((FREEDOM + squares) / (FREEDOM + 1.0))


def _spacing(ratio: float, rounding: float) -> float:
    """Firings between two readings that are used; ``rounding`` is σ over the mean firing w.

    The sum of L firings is expected at its mean and the share s = qL/(qL + 2) of what a reading
    departs from it. A variance of the widths that is off by a share δ changes s by δ s (1 − s), and
    thrust by as much times q σ²/(L w²).
    """
    if ratio == 0.0:
        return 1.0
    return float(max(rounding * np.sqrt(2.0 * SPREAD_ERROR / MOST_BIAS) - 2.0 / ratio, 1.0))


def read_levels(levels: int, every: float) -> Places:
    """Places (n,) of the readings that are used of so many: first, last, and evenly between.

    ``every`` is how many firings lie between two of them at least.
    """
    pieces = max(int((levels - 1) / every), 1)
    return np.unique(np.round(np.linspace(0.0, levels - 1.0, pieces + 1)).astype(np.int64))


def _banded(spreads: Array, rounding: float) -> Array:
    """Upper form of V + σ² tridiag(−1, 2, −1), V diagonal with spreads σ², the ends' roundings too.

    The reading before the first run is rounded like all others.
    """
    bands = np.zeros((2, len(spreads)))
    bands[0, 1:] = -rounding
    bands[1] = rounding * (spreads + 2.0)
    return bands


def _solve(values: Array, spreads: Array, rounding: float) -> Array:
    bands = _banded(spreads, rounding)
    if len(spreads) == 1:  # no band for the library's solver
        return np.asarray(values / bands[1])
    return np.asarray(solveh_banded(bands, values), dtype=np.float64)


def _mean_width(seconds: Array, count: Array, spreads: Array, rounding: float) -> float:
    """Generalised least squares of Δu = n w."""
    weighted = _solve(count, spreads, rounding)
    return float(weighted @ seconds / (weighted @ count))


def _log_likelihood(seconds: Array, count: Array, spreads: Array, rounding: float) -> float:
    """Restricted log likelihood of the widths' spread, w profiled out; constants left out."""
    bands = _banded(spreads, rounding)
    log_det = 2.0 * float(np.log(cholesky_banded(bands)[1]).sum())
    by_count = _solve(count, spreads, rounding)
    missed = seconds - count * _mean_width(seconds, count, spreads, rounding)
    square = float(missed @ _solve(missed, spreads, rounding))
    return float(-0.5 * (square + log_det + np.log(by_count @ count)))
