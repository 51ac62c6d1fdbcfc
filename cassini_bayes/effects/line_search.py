"""The search for a line in what a model leaves: all frequencies, then directions and dampings.

All frequencies a line's width apart are looked at with the fit's columns left in; the best of them
about all directions with those taken off (:mod:`.line_directions`); the best of all goes on to the
maximum. What it is about, its sizes over all lines, is in :mod:`.line_shapes`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from scipy.optimize import minimize

from cassini_bayes.balance.linearised import InnovationRows, Linear
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.effects.appendage import KnownMotion
from cassini_bayes.effects.line_directions import (
    BODY_AXES,
    AllDirections,
    of_turning,
    sizes_about,
)
from cassini_bayes.effects.line_products import LineProducts, ManyLines, many_lines
from cassini_bayes.effects.line_shapes import (
    DAMPED,
    NONE,
    Dampings,
    Line,
    Posterior,
    Shapes,
    even_mixture,
    posterior,
    scales_of_sizes,
    shapes_of_cells,
    shapes_over_dampings,
)
from cassini_bayes.effects.line_starts import in_common, starts_of, turned, turns
from cassini_bayes.effects.oscillation import Oscillation

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


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines of events whose free oscillations are ``swings`` (P): one in all, or each its own.

    ``moments`` (3,) are the body's, ``scales`` the priors' of a swing and of the share.
    """

    products: LineProducts
    swings: int
    moments: Array
    scales: tuple[float, float]

    @cached_property
    def units(self) -> Array:
        """Scales (K, 2 P + 1) of the sizes."""
        return scales_of_sizes(self.scales, self.swings)

    @property
    def one_size(self) -> Array:
        """Prior scales (3, 3) of cosine, sine and share about X, Y and Z, N m s."""
        swing, share = self.scales
        one = np.array([[swing, swing, share]])
        (size,) = sizes_about(np.array(BODY_AXES), self.moments, one)
        return np.asarray(size)

    def posterior_of_many(self, many: ManyLines) -> Posterior:
        """Posterior (K, f, 3) of every frequency about every axis, columns as they are."""
        size = sizes_about(np.array(BODY_AXES), self.moments, self.units)
        return posterior(many.gram[0], many.projection[0], size[:, None])

    @cached_property
    def of_directions(self) -> Callable[[float, float], AllDirections]:
        """Of a frequency (Hz) and a damping, about all directions."""
        along = np.kron(np.eye(3), self._columns)

        @cache
        def found(frequency_hz: float, damping: float) -> AllDirections:
            gram, projection = self.products.along_axes(frequency_hz, damping)
            products = along.T @ gram @ along, projection @ along
            return AllDirections(*products, self.moments, self.units)

        return found

    @cached_property
    def posterior_of(self) -> Callable[[Line], Posterior]:
        """Posterior (K,) of the sizes of a line; its last digits and its sizes share lines."""

        @cache
        def found(line: Line) -> Posterior:
            return posterior(*self._about(line), self._size(line))

        return found

    def with_turns(self, line: Line, scales: int, turn: Array) -> float:
        """Log evidence of a line by one of the scales, its starts turned (P,) from one."""
        weights = turned(turn)
        gram, projection = self._about(line)
        scale = self._size(line)[scales][[0, 1, -1]]
        one = posterior(weights.T @ gram @ weights, projection @ weights, scale)
        return float(one.log_evidence)

    def _size(self, line: Line) -> Array:
        return sizes_about(np.array([line[2]]), self.moments, self.units)[:, 0]

    def _about(self, line: Line) -> tuple[Array, Array]:
        (turning,) = of_turning(np.array([line[2]]), self.swings)
        return self.products.about(line, self._columns @ turning)

    @property
    def _columns(self) -> Array:
        return in_common(self.products.starts.count, self.swings)


def find_oscillation(
    rows: Sequence[InnovationRows],
    motions: Sequence[KnownMotion],
    linear: Linear,
    inertia_kg_m2: Array,
    scales: tuple[float, float],
) -> Oscillation | None:
    """The oscillation of most evidence; None where the events are too short for any.

    All frequencies a line's width apart are tried with two dampings and with what the fit takes
    away left in the columns; the best of them and their neighbours with that taken off, about all
    directions; the best of these with all dampings; the best of all, about its direction, goes on
    to the maximum. Of several events all that with starts alike and with each its own
    (:mod:`.line_starts`).

    Parameters
    ----------
    rows, motions, linear
        Innovations and known motion of every event, and the linear model that left them; of rows,
        then of turns over quiet pieces if there are any.
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
    products = LineProducts(rows, motions, linear, starts_of(rows))
    alike, *apart = (
        _Lines(products, swings, inertia_kg_m2, scales)
        for swings in dict.fromkeys((1, products.starts.count))
    )
    ways = (alike, *apart)
    seen = [many_lines(rows, motions, (frequencies, d), products.starts) for d in COARSE_DAMPINGS]
    looks = [alike.posterior_of_many(many.of_starts(1)) for many in seen]
    peaks = _peaks(np.maximum.reduce([_rough_evidence(many, ways) for many in seen]))

    def score(line: tuple[float, float]) -> float:
        return float(even_mixture([way.of_directions(*line).rough_evidence for way in ways]))

    finer = [
        (float(frequencies[f] + s / span), damping)
        for f in peaks
        for damping in COARSE_DAMPINGS
        for s in FINER
    ]
    frequency, damping = _best(finer, score)
    way = max(ways, key=lambda way: way.of_directions(frequency, damping).log_evidence)
    direction = way.of_directions(frequency, damping).best
    frequency, damping = _at_maximum(
        lambda f, d: float(way.posterior_of((f, d, direction)).of_all_sizes),
        frequency,
        damping,
        span,
    )
    found = (frequency, damping, way.of_directions(frequency, damping).best)
    near = {line: alike.of_directions(*line).about_axes for line in finer}
    others = _other_lines(found, span, near, (frequencies, looks, peaks), alike.units)
    # one is taken of all starts, scales, directions and lines: what others have is a cost
    of_all = even_mixture([way.of_directions(frequency, damping).log_evidence for way in ways])
    cost = float(np.log(len(frequencies) * len(DAMPINGS))) - float(of_all)
    step = float(np.median([motion.step_s for motion in motions]))
    return _oscillation(way, found, cost, (span, step), others)


def _oscillation(
    way: _Lines,
    found: Line,
    cost: float,
    lengths_s: tuple[float, float],
    others: Sequence[Shapes],
) -> Oscillation:
    """The line found, as a fit has it: its scales and starts taken, and sizes over all lines.

    ``cost`` is what the search cost, nats, less the evidence of all that is taken, ``lengths_s``
    the span of the longest event and the step between rates; ``others`` are all other lines.
    """
    span, step = lengths_s
    of_all, of_line = way.of_directions(*found[:2]), way.posterior_of(found)
    most = int(of_line.log_evidence.argmax())
    turn = turns(of_line.mean[most, :-1])
    gain = way.with_turns(found, most, turn)
    of_direction = float(of_line.of_all_sizes) - of_all.log_evidence
    of_found = shapes_over_dampings(way.posterior_of, found, span, way.units).less(of_direction)
    swing, share = scales_of_sizes((1.0, 1.0), 1)[most, 1:]
    return Oscillation(
        *found,
        0.0 if found[2] in BODY_AXES else float(np.degrees(of_all.oblique_sd_rad)),
        gain + cost,
        gain,
        span,
        step,
        float(swing),
        float(share),
        turns=tuple((float(z.real), float(z.imag)) for z in turn) if way.swings > 1 else (),
        log_start=(gain - float(of_line.log_evidence[most])) / way.swings,
        shapes=Shapes.by_width([of_found, *others]),
    )


def _best(
    lines: Sequence[tuple[float, float]], score: Callable[[tuple[float, float]], float]
) -> tuple[float, float]:
    """Frequency and damping of the highest score, of the best lines' frequencies at all dampings.

    Of as many lines as there are peaks: a damping not yet looked at may put another one first.
    """
    ranked = sorted(lines, key=score)[::-1]
    frequencies = list(dict.fromkeys(frequency for frequency, _ in ranked))[:PEAKS]
    return max(((f, damping) for f in frequencies for damping in DAMPINGS), key=score)


def _rough_evidence(many: ManyLines, ways: Sequence[_Lines]) -> Array:
    """Log evidence (f,) of all ways in which events start, about the best direction, roughly."""
    each = [many.of_starts(way.swings).about_any_direction(way.one_size) for way in ways]
    return even_mixture(each)


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


def _other_lines(
    found: Line,
    span_s: float,
    finer: Mapping[tuple[float, float], Posterior],
    coarse: tuple[Array, Sequence[Posterior], Sequence[int]],
    scales: Array,
) -> list[Shapes]:
    """All lines of the search but the one found: those about the peaks, and the rest.

    ``span_s`` is that of the longest event, ``finer`` has the posteriors (K, 3) about body axes of
    frequencies and dampings about the peaks, ``coarse`` the first look: frequencies (f,), the
    posterior (K, f, 3) at every damping, and the places of its peaks. ``scales`` are (K, 3). Beside
    a peak and within two widths of the line found is no other line. Oblique lines are taken to have
    as much of the evidence as those about body axes, and events to start alike in all of them.
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
        rest = Posterior(*(values[:, is_rest] for values in look))
        of_all = Dampings(damping, *DAMPED) if damping > 0.0 else NONE
        shapes.append(shapes_of_cells(rest, at, of_all, spacing, scales).less(of_axis))
        near = [
            (line[0], Posterior(*(values[:, axis] for values in own)))
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


def _peaks(scores: Array) -> list[int]:
    """Places of the highest scores (f,), no two of them neighbours."""
    peaks: list[int] = []
    for f in np.argsort(-scores).tolist():
        if all(abs(f - g) > 1 for g in peaks):
            peaks.append(f)
        if len(peaks) == PEAKS:
            break
    return peaks
