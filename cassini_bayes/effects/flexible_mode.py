"""A boom or propellant that moves against the body: an oscillation in the rates.

An appendage of moment of inertia φ J about a direction of the body moves at a rate ω + q; its
momentum φ J q is what the balance lacks, q a free oscillation and an answer D to the body's own
motion (:mod:`cassini_bayes.effects.appendage`), which firings and wheels drive:
J (c e^(−ζΩt) cos Ωt + s e^(−ζΩt) sin Ωt − φ D), whatever the controllers do. The free oscillation
is taken to start alike in every event, t from its first row. Frequency, damping and
direction are those of most evidence in what a model leaves (:mod:`.line_directions`); the fit has
departures of the first two in first order.

Noise of measured rates would drive D as well: errors in variables, by which a share φ of 0.004
comes out as 0.001 where rates have 2e-5 rad/s (docs/topics/criticism.md §2). So D is of the rates
that the balance of momentum shows, ω − J⁻¹ r with r what the baseline leaves; wheels tell them ten
times better. They lack what the appendage gives its body: then D has the frequency and damping of
the free spacecraft, and is 1 − φ times too small.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from hashlib import sha256
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from cassini_bayes.balance.linearised import EventRows, Linear
from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.balance.statistics import ExtraColumn, RowContext, Samples
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.effects.appendage import (
    KnownMotion,
    known_motion,
    oscillation_series,
    products_of_turns,
)
from cassini_bayes.effects.changes import AXES, with_columns
from cassini_bayes.effects.effect import FittedRows, Kind, Remainder, Setting, Values
from cassini_bayes.effects.firings import FiredIntervals
from cassini_bayes.effects.line_directions import (
    BODY_AXES,
    COLUMNS,
    AllDirections,
    of_turning,
    sizes_about,
)
from cassini_bayes.effects.line_shapes import (
    DAMPED,
    NONE,
    Dampings,
    Direction,
    Line,
    Posterior,
    Shapes,
    draw_shapes,
    posterior,
    shapes_of_cells,
    shapes_over_dampings,
)
from cassini_bayes.effects.wording import Clause, decimals_of, rounded
from cassini_bayes.priors.distributions import Distribution

SERIES: Final = ("flexible:cosine", "flexible:sine", "flexible:driven")
SLOPE_STEP: Final = 0.05
"""Of what the span can tell apart, for slopes by frequency and damping: judgement, a phase error of
0.3 rad at the end of the span, where a central difference is good to one percent."""
LEAST_CYCLES: Final = 4.0
"""In the longest event: judgement, what is slower is a drift that other causes explain."""
DAMPINGS: Final = (0.0, 0.001, 0.003, 0.01, 0.03)
"""Looked at: judgement, half a decade apart, from nothing to what dies within ten cycles."""
COARSE_DAMPINGS: Final = (0.0, 0.003)
"""Of the first look over all frequencies: two more would double its time (docs/results/
diagnosis-speed.md), and a line between them loses less than its neighbours differ."""
PEAKS: Final = (
    6  # lines that are looked at more closely: judgement, time against a weak line's loss
)
FINER_STEP: Final = 0.25  # of a line's width
FINER: Final = tuple(FINER_STEP * place for place in range(-3, 4))  # about each peak
LARGEST_ROOT: Final = 0.3
"""Of the damping, 0.09: an appendage that dies within two cycles is no oscillation (judgement)."""
MOST_EVALUATIONS: Final = 60  # for the last digits of frequency and damping
FASTEST: Final = 0.45  # cycles from row to row, of what trapezoids still show


@dataclass(frozen=True)
class BalancedRates:
    """Rates (N, 3) of an event, rad/s, as the balance of momentum shows them, NaN where not known.

    ``of`` is the digest of those that were measured, ``known`` the share of rows that have better.
    """

    of: str
    rate_rad_s: Array
    known: float

    @staticmethod
    def instead(measured_rad_s: Array, rate_rad_s: Array, known: float) -> BalancedRates:
        """Rates for those that were measured, both (N, 3)."""
        return BalancedRates(_digest(measured_rad_s), rate_rad_s, known)


@dataclass(frozen=True)
class Oscillation:
    """A damped oscillation about a unit vector in body axes, its frequency and damping clamped.

    Departures from them are counted in what ``span_s`` can tell apart: 1/T of the frequency,
    1/(ΩT) of the damping. ``step_s`` lies between the rates that show how the body moves.
    ``direction_sd_deg`` is the standard deviation of an oblique direction along each arc across it,
    0 for a body axis. ``log_looks`` is what the search costs, ``log_gain`` what it found, nats,
    about what the fit had left. Motion is that of ``balanced`` rates where an event has them;
    ``measured`` is the share of rows without.
    """

    frequency_hz: float
    damping: float
    direction: Direction
    direction_sd_deg: float = 0.0
    log_looks: float = 0.0
    log_gain: float = 0.0
    span_s: float = 3_600.0
    step_s: float = 1.0
    measured: float = 1.0
    balanced: tuple[BalancedRates, ...] = field(default=(), compare=False)
    shapes: Shapes | None = field(default=None, compare=False)

    @property
    def said(self) -> str:
        """What it swings about: a body axis by its name, or a unit vector in body axes."""
        if self.direction in BODY_AXES:
            return f"about {'XYZ'[BODY_AXES.index(self.direction)]}"
        parts = ", ".join(rounded(part, 2) for part in self.direction)
        off = rounded(self.direction_sd_deg, min(decimals_of(self.direction_sd_deg), 0))
        return f"about ({parts}) in body axes, ± {off}° (1 σ)"

    @property
    def record(self) -> Mapping[str, object]:
        """Direction in body axes and its standard deviation, degrees."""
        return {"direction": list(self.direction), "direction_sd_deg": self.direction_sd_deg}

    def columns(self, samples: Samples) -> tuple[ExtraColumn, ...]:
        """The three series (:func:`oscillation_series`) of an event and their slopes.

        Slopes are by frequency in units of 1/T and by damping in units of 1/(ΩT), T the span.
        """
        known = {rates.of: rates.rate_rad_s for rates in self.balanced}
        rate = known.get(_digest(samples.rate_rad_s), samples.rate_rad_s)
        motion = known_motion(samples.time_s, rate)
        over_trapezoids = _over_trapezoids(self.frequency_hz, motion.step_s)
        unit_hz = 1.0 / self.span_s
        unit_damping = 1.0 / (2.0 * np.pi * self.frequency_hz * self.span_s)

        def series(place: int, by_line: float, by_damping: float, context: RowContext) -> Array:
            line = self.frequency_hz + by_line * unit_hz, self.damping + by_damping * unit_damping
            motion_of = oscillation_series(context.time_s, motion, *line)[place]
            return np.asarray(motion_of if place < len(SERIES) - 1 else motion_of @ self.direction)

        def slope(place: int, by_line: float, by_damping: float, context: RowContext) -> Array:
            ahead = series(place, by_line, by_damping, context)
            return (ahead - series(place, -by_line, -by_damping, context)) / (2.0 * SLOPE_STEP)

        columns = []
        for place, name in enumerate(SERIES):
            by_line, by_damping = slope_names(name)
            columns += [
                ExtraColumn(own, values, over_trapezoids)
                for own, values in (
                    (name, partial(series, place, 0.0, 0.0)),
                    (by_line, partial(slope, place, SLOPE_STEP, 0.0)),
                    (by_damping, partial(slope, place, 0.0, SLOPE_STEP)),
                )
            ]
        return tuple(columns)


def slope_names(name: str) -> tuple[str, str]:
    """Names of the columns of a series' slopes by frequency and by damping."""
    return f"{name}:frequency", f"{name}:damping"


def _line(setting: Setting) -> Oscillation:
    assert isinstance(setting.search_result, Oscillation)  # the search comes before the fit
    return setting.search_result


def change(physics: Physics, _: Parameters, values: Values, setting: Setting) -> Physics:
    """What the balance lacks about the line's direction, its frequency and damping moved."""
    unit = np.array(_line(setting).direction)
    moment = unit @ physics.inertia_kg_m2 @ unit
    weights = values["cosine_rad_s"], values["sine_rad_s"], -values["inertia_fraction"]
    columns = {}
    for name, weight in zip(SERIES, weights, strict=True):
        by_line, by_damping = slope_names(name)
        momentum = (moment * weight)[..., None] * unit
        columns[name] = momentum
        columns[by_line] = momentum * values["frequency_shift"][..., None]
        columns[by_damping] = momentum * values["damping_shift"][..., None]
    return with_columns(physics, columns)


def report(values: Values, setting: Setting) -> Values:
    """An oscillation as the free body shows it: amplitude, frequency, damping.

    A body that gives makes its appendage faster by 1/√(1 − φ). What it gives is in its measured
    rates, but of a swing between rows straight lines show the share sinc² fΔ only, and the balance
    does not show it: so much the line is found with already in it. Rates that lack it drive an
    appendage 1/(1 − φ) times more.
    """
    line = _line(setting)
    frequency = line.frequency_hz + values["frequency_shift"] / line.span_s
    unit = 2.0 * np.pi * line.frequency_hz * line.span_s
    damping = line.damping + values["damping_shift"] / unit
    return _of_free_body(line, values, frequency, damping)


def drawn(setting: Setting, rng: np.random.Generator, draws: int) -> Values:
    """Sizes (n,) over all lines (:class:`.Shapes`), as :func:`report` has them."""
    line = _line(setting)
    if line.shapes is None:
        return {}
    swing, share, frequency, damping = draw_shapes(line.shapes, rng, draws)
    values = {
        "cosine_rad_s": swing[:, 0],
        "sine_rad_s": swing[:, 1],
        "inertia_fraction": share,
    }
    return _of_free_body(line, values, frequency, damping)


def _of_free_body(line: Oscillation, values: Values, frequency: Array, damping: Array) -> Values:
    """Sizes by those of the line: see :func:`report`."""
    shown = line.measured * np.sinc(frequency * line.step_s) ** 2
    fraction = values["inertia_fraction"] / (1.0 + (1.0 - shown) * values["inertia_fraction"])
    free = np.sqrt(1.0 - shown * fraction)
    return {
        "inertia_fraction": fraction,
        "frequency_hz": frequency / free,
        "damping": np.maximum(damping, 0.0) / free,
        "amplitude_rad_s": np.hypot(values["cosine_rad_s"], values["sine_rad_s"]),
    }


def driven_answers(
    fired: FiredIntervals,
    time_s: Array,
    change_rad_s: Array,
    line: tuple[float, float],
    step_s: float,
) -> tuple[Array, Array]:
    """Answers (n, s) of an appendage, rad/s, per unit of sin Ωδ, and the variances (s,) of that.

    A pulse drives the appendage from when it was fired: with δ the time from the middle of a slope
    of length Δ, from one measured rate to the next, its answer has sin Ωδ out of phase, of variance
    (1 − sin ΩΔ / ΩΔ) / 2. The middle is taken to be that of the counter interval.

    ``change_rad_s`` (s,) is what every firing changes in the body's rate about the axis, ``line``
    frequency (Hz) and damping, ``step_s`` lies between the rates that show the change as a slope.
    """
    omega, damping = 2.0 * np.pi * line[0], line[1]
    after = time_s[:, None] - 0.5 * (fired.start_s + fired.end_s)
    after = np.where(time_s[:, None] >= fired.end_s, after, 0.0)
    answers = change_rad_s * np.exp(-damping * omega * after) * np.sin(omega * after)
    variance = 0.5 * (1.0 - np.sinc(omega * step_s / np.pi)) * fired.scatter
    return answers, variance


def left_open(
    fired: FiredIntervals, rows: FittedRows, values: Values, setting: Setting
) -> tuple[Array, Array]:
    """What an appendage with a share of the inertia answers, out of phase."""
    line = _line(setting)
    samples = rows.samples
    step = float(np.median(np.diff(samples.time_s[np.isfinite(samples.rate_rad_s).all(1)])))
    inertia = np.broadcast_to(rows.physics.inertia_kg_m2, (1, 3, 3))[0]
    unit = np.array(line.direction)
    turned = unit @ np.linalg.solve(inertia, fired.momentum_n_m_s.T)
    shape = line.frequency_hz, line.damping
    answers, variance = driven_answers(fired, rows.time_s, turned, shape, step)
    moment = float(values["inertia_fraction"][0]) * float(unit @ inertia @ unit)
    return moment * answers[:, None] * unit[:, None], variance


def search(remainder: Remainder, priors: Mapping[str, Distribution]) -> Oscillation | None:
    """The line of most evidence in what a model leaves, by the priors of its size."""
    inertia = np.array([remainder.parameters[f"inertia_{axis}{axis}_kg_m2"] for axis in AXES])
    balanced = tuple(
        balanced_rates(samples, rows, inertia)
        for samples, rows in zip(remainder.samples, remainder.rows, strict=True)
    )
    motions = [
        known_motion(samples.time_s, rates.rate_rad_s)
        for samples, rates in zip(remainder.samples, balanced, strict=True)
    ]
    linear, rows = remainder.with_turns()
    scales = priors["cosine_rad_s"].scale, priors["inertia_fraction"].scale
    line = find_oscillation(rows, [*motions, *motions], linear, inertia, scales)
    if line is None:
        return None
    measured = 1.0 - float(np.mean([rates.known for rates in balanced]))
    return replace(line, balanced=balanced, measured=measured)


def balanced_rates(samples: Samples, rows: EventRows, inertia_kg_m2: Array) -> BalancedRates:
    """Rates of an event's samples, those of its rows less what the balance leaves over J (3,)."""
    rate = samples.rate_rad_s.copy()
    at = np.searchsorted(samples.time_s, rows.time_s)
    rate[at] -= rows.residual_n_m_s / inertia_kg_m2
    sampled = int(np.isfinite(samples.rate_rad_s).all(1).sum())
    return BalancedRates.instead(samples.rate_rad_s, rate, len(at) / max(sampled, 1))


def _digest(values: Array) -> str:
    return sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


def _over_trapezoids(frequency_hz: float, step_s: float) -> float:
    """Integral of a swing over that by trapezoids of its rows: tan x / x, x = π f Δ."""
    half = np.pi * min(frequency_hz * step_s, FASTEST)
    return float(np.tan(half) / half)


def find_oscillation(
    rows: Sequence[EventRows],
    motions: Sequence[KnownMotion],
    linear: Linear,
    inertia_kg_m2: Array,
    scales: tuple[float, float],
) -> Oscillation | None:
    """The oscillation of most evidence; None where the events are too short for any.

    All frequencies a line's width apart are tried with two dampings and with what the fit takes
    away left in the columns; the best of them and their neighbours with that taken off, about all
    directions; the best of these with all dampings; the best of all, about its direction, goes on
    to the maximum.

    Parameters
    ----------
    rows, motions, linear
        Innovations and known motion of every event, and the linear model that left them; of rows,
        or of turns over quiet pieces.
    inertia_kg_m2
        Moments (3,) about body axes.
    scales
        Prior scales of the amplitude (rad/s) and of the appendage's share φ of the inertia.
    """
    span = max(float(event.time_s[-1] - event.time_s[0]) for event in rows)
    highest = 0.5 / min(float(np.median(np.diff(event.time_s))) for event in rows)
    frequencies = np.arange(LEAST_CYCLES / span, highest, 1.0 / span)
    if len(frequencies) == 0:
        return None
    units = np.array([scales[0], *scales])
    size = sizes_about(np.array(BODY_AXES), inertia_kg_m2, units)
    looks = [_coarse(rows, motions, frequencies, damping, size) for damping in COARSE_DAMPINGS]
    peaks = _peaks(np.maximum.reduce([_about_any_direction(look) for look in looks]))
    factor = cho_factor(linear.gram())
    views = cache(partial(_views, rows, linear))

    @cache
    def of_directions(frequency_hz: float, damping: float) -> AllDirections:
        along = [views(axis) for axis in BODY_AXES]
        shape = frequency_hz, damping
        products = _products(rows, motions, along, factor, shape, np.eye(COLUMNS))
        return AllDirections(*products, inertia_kg_m2, units)

    def score(line: tuple[float, float]) -> float:
        return of_directions(*line).rough_evidence

    finer = [
        (float(frequencies[f] + s / span), damping)
        for f in peaks
        for damping in COARSE_DAMPINGS
        for s in FINER
    ]
    ranked = sorted(finer, key=score)[::-1]
    best = list(dict.fromkeys(frequency for frequency, _ in ranked))[:PEAKS]
    fits = [(frequency, damping) for frequency in best for damping in DAMPINGS]
    frequency, damping = max(fits, key=score)
    direction = of_directions(frequency, damping).best

    @cache  # the last digits and the sizes share lines
    def posterior_of(line: Line) -> Posterior:
        along = line[2]
        (columns,) = of_turning(np.array([along]))
        products = _products(rows, motions, [views(along)], factor, line[:2], columns)
        (own,) = sizes_about(np.array([along]), inertia_kg_m2, units)
        return posterior(*products, own)

    frequency, damping = _at_maximum(
        lambda f, d: float(posterior_of((f, d, direction)).log_evidence), frequency, damping, span
    )
    of_best = of_directions(frequency, damping)
    found = (frequency, damping, of_best.best)
    gain = float(posterior_of(found).log_evidence)
    # of all directions one is taken, of all lines one: what others have of the evidence is a cost
    of_direction = gain - of_best.log_evidence
    log_looks = float(np.log(len(frequencies) * len(DAMPINGS))) + of_direction
    step = float(np.median([motion.step_s for motion in motions]))
    of_found = shapes_over_dampings(posterior_of, found, span, units).less(of_direction)
    near = {line: of_directions(*line).about_axes for line in finer}
    others = _other_lines(found, span, near, (frequencies, looks, peaks), units)
    shapes = Shapes.joined([of_found, *others])
    sd = 0.0 if of_best.best in BODY_AXES else float(np.degrees(of_best.oblique_sd_rad))
    return Oscillation(*found, sd, log_looks, gain, span, step, shapes=shapes)


def _at_maximum(
    evidence: Callable[[float, float], float], frequency_hz: float, damping: float, span_s: float
) -> tuple[float, float]:
    """Frequency and damping of most evidence from some near it, to the last digits."""

    def loss(x: Array) -> float:
        return -evidence(frequency_hz + float(x[0]) / span_s, float(x[1]) ** 2)

    root = float(np.sqrt(damping))
    corners = np.array([[0.0, root], [0.1, root], [0.0, root + 0.01]])
    options = {"initial_simplex": corners, "maxfev": MOST_EVALUATIONS, "xatol": 1e-3, "fatol": 1e-3}
    bounds = ((-2.0, 2.0), (0.0, LARGEST_ROOT))
    result = minimize(loss, corners[0], method="Nelder-Mead", bounds=bounds, options=options)
    return frequency_hz + float(result.x[0]) / span_s, float(result.x[1] ** 2)


def _about_any_direction(look: Posterior) -> Array:
    """Log evidence (f,) about the best direction, roughly, by that (f, 3) about every axis.

    Whitened amplitudes along the axes, (3, 2) cosines and sines, gain half the square of their
    largest singular value where the line is oblique.
    """
    free = look.covariance[..., :2, :2]
    factor = np.linalg.cholesky(free)
    whitened = np.linalg.solve(factor, look.mean[..., :2, None])[..., 0]  # (f, 3, 2)
    largest = np.linalg.eigvalsh(np.swapaxes(whitened, 1, 2) @ whitened)[:, -1]
    own = 0.5 * np.linalg.slogdet(free)[1]
    oblique = 0.5 * largest + own.min(axis=1)
    return np.asarray(np.maximum(look.log_evidence.max(axis=1), oblique))


def _other_lines(
    found: Line,
    span_s: float,
    finer: Mapping[tuple[float, float], Posterior],
    coarse: tuple[Array, Sequence[Posterior], Sequence[int]],
    scales: Array,
) -> list[Shapes]:
    """All lines of the search but the one found: those about the peaks, and the rest.

    ``span_s`` is that of the longest event, ``finer`` has the posteriors (3,) about body axes of
    frequencies and dampings about the peaks, ``coarse`` the first look: frequencies (f,), the
    posterior (f, 3) at every damping, and the places of its peaks. Beside a peak and within two
    widths of the line found is no other line. Oblique lines are taken to have as much of the
    evidence as those about body axes.
    """
    frequencies, looks, peaks = coarse
    spacing = 1.0 / span_s
    width = 2.0 * float(np.hypot(spacing, found[1] * found[0]))
    of_axis = float(np.log(len(BODY_AXES)))
    # about another axis a line of the same frequency is another one, but that of an oblique one
    is_own = np.array([axis == found[2] or found[2] not in BODY_AXES for axis in BODY_AXES])
    is_rest = np.ones((len(frequencies), 3), dtype=bool)
    is_rest[np.ix_(np.abs(frequencies - found[0]) < width, is_own)] = False
    for f in peaks:
        is_rest[max(f - 1, 0) : f + 2] = False
    at = np.broadcast_to(frequencies[:, None], is_rest.shape)[is_rest]
    shapes = []
    for damping, look in zip(COARSE_DAMPINGS, looks, strict=True):
        rest = Posterior(*(values[is_rest] for values in look))
        of_all = Dampings(damping, *DAMPED) if damping > 0.0 else NONE
        shapes.append(shapes_of_cells(rest, at, of_all, spacing, scales).less(of_axis))
        near = [
            (line[0], Posterior(*(values[axis] for values in own)))
            for line, own in finer.items()
            if line[1] == damping
            for axis in range(len(BODY_AXES))
            if not is_own[axis] or abs(line[0] - found[0]) > width
        ]
        if near:
            at_peaks = np.array([frequency for frequency, _ in near])
            cells = at_peaks, of_all, FINER_STEP * spacing
            stacked = Posterior.stacked(own for _, own in near)
            shapes.append(shapes_of_cells(stacked, *cells, scales).less(of_axis))
    return shapes


def _coarse(
    rows: Sequence[EventRows],
    motions: Sequence[KnownMotion],
    frequencies: Array,
    damping: float,
    size: Array,
) -> Posterior:
    """Posterior (f, 3) of every frequency about every axis, columns as they are."""
    gram = np.zeros((len(frequencies), 3, 3, 3))
    projection = np.zeros((len(frequencies), 3, 3))
    for event, motion in zip(rows, motions, strict=True):
        directions = np.linalg.inv(event.noise_factor)  # column a: a unit of momentum, whitened
        lengths = (directions**2).sum(0)
        left = event.white @ directions
        if event.turns is not None:
            squares, along = products_of_turns(
                event.turns, motion.step_s, frequencies, damping, left
            )
            gram[:, :, :2, :2] += lengths[:, None, None] * squares
            projection[:, :, :2] += np.swapaxes(along, 1, 2)
            continue
        squares, along = motion.products(event.time_s, frequencies, damping, left)
        squares[:, :2, 2:] *= -1.0  # what the balance lacks is less the driven part
        squares[:, 2:, :2] *= -1.0
        along[:, 2:] *= -1.0
        for axis in range(3):
            places = np.array([0, 1, 2 + axis])
            gram[:, axis] += lengths[axis] * squares[:, places[:, None], places]
            projection[:, axis] += along[:, places, axis]
    return posterior(gram, projection, size)


def _peaks(scores: Array) -> list[int]:
    """Places of the highest scores (f,), no two of them neighbours."""
    peaks: list[int] = []
    for f in np.argsort(-scores).tolist():
        if all(abs(f - g) > 1 for g in peaks):
            peaks.append(f)
        if len(peaks) == PEAKS:
            break
    return peaks


class _View(NamedTuple):
    """What one event's rows show along a direction: whitened momentum is weighed with these.

    ``unit`` (3,) is a whitened unit, ``white`` (n,) and ``columns`` (n, k) innovations and those of
    the linear model's columns that the event has along it, at ``places`` (k,). Of turns all are
    along the modes of their pieces, where ``weights`` (n,) make noise white.
    """

    unit: Array
    white: Array
    columns: Array
    places: Places
    weights: Array | None

    def of(self, series: Array) -> Array:
        """Series (n, c) as they are seen along the direction."""
        return series if self.weights is None else self.weights[:, None] * series


def _views(rows: Sequence[EventRows], linear: Linear, direction: Direction) -> list[list[_View]]:
    """Every event's views of a direction: one, of turns one along each axis that it has part in."""
    views = []
    for event, part in zip(rows, linear.columns.parts, strict=True):
        to_white = np.linalg.inv(event.noise_factor)
        columns = part.values.reshape(len(event.white), 3, -1)
        if event.turns is None:
            unit = to_white @ direction
            along = np.tensordot(columns, unit, (1, 0))
            views.append([_View(unit, event.white @ unit, along, part.places, None)])
            continue
        own = []
        for axis in np.flatnonzero(direction).tolist():
            part_of: Array = np.asarray(direction[axis] * to_white[:, axis])
            along = np.tensordot(columns, part_of, (1, 0))
            seen = event.turns.in_modes(np.column_stack([event.white @ part_of, along]))
            weights = event.turns.weights(axis)
            own.append(_View(part_of, seen[:, 0], seen[:, 1:], part.places, weights))
        views.append(own)
    return views


def _products(
    rows: Sequence[EventRows],
    motions: Sequence[KnownMotion],
    views: Sequence[Sequence[Sequence[_View]]],
    factor: tuple[Array, bool],
    shape: tuple[float, float],
    columns: Array,
) -> tuple[Array, Array]:
    """Gram (b c, b c) and Aᵀy (b c,) of a line along b directions, less what the fit takes away.

    ``views`` are those of the directions, ``factor`` that of the linear model's Gram, ``shape``
    the line's frequency (Hz) and damping. ``columns`` (5, c) makes c of its five series.
    """
    count, width = len(views), columns.shape[1]
    gram, projection = np.zeros((count, width, count, width)), np.zeros((count, width))
    across = np.zeros((len(factor[0]), count, width))
    for event, motion, *own in zip(rows, motions, *views, strict=True):
        series = np.column_stack(oscillation_series(event.time_s, motion, *shape))
        shown = _shown(event, motion, series @ columns, shape[0])
        each = [(a, view) for a, along in enumerate(own) for view in along]
        for a, view in each:
            seen = view.of(shown)
            squares = seen.T @ seen
            projection[a] += view.white @ seen
            across[view.places, a] += view.columns.T @ seen
            for b, other in each:
                # noise of turns about one axis is not that about another
                if view.weights is None or other is view:
                    gram[a, :, b] += float(view.unit @ other.unit) * squares
    flat = across.reshape(len(across), -1)
    whole = gram.reshape(flat.shape[1], -1) - flat.T @ cho_solve(factor, flat)
    return whole, projection.ravel()


def _shown(event: EventRows, motion: KnownMotion, series: Array, frequency_hz: float) -> Array:
    """Series (n, c) as an event shows them: of turns integrated, along the modes of pieces."""
    if event.turns is None:
        return series
    seen = _over_trapezoids(frequency_hz, motion.step_s)
    return event.turns.in_modes(seen * event.turns.pieces.integrated(series))


KIND: Final = Kind(
    "flexible_mode",
    change,
    search=search,
    reported=("inertia_fraction", "frequency_hz", "damping", "amplitude_rad_s"),
    report=report,
    drawn=drawn,
    left_open=left_open,
    says=Clause(
        "an appendage with {0} of the inertia swings at {1}, damping {2}, and moves the body by "
        "{3}",
        (("%", 100.0), ("Hz", 1.0), (None, 1.0), ("µrad/s", 1e6)),
    ),
)
