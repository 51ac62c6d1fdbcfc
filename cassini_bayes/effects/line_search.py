"""The search for a line in what a model leaves: all frequencies, then directions and dampings.

All frequencies a line's width apart are looked at with the fit's columns left in; the best of them
about all directions with those taken off (:mod:`.line_directions`); the best of all goes on to the
maximum. What it is about, its sizes over all lines, is in :mod:`.line_shapes`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from cassini_bayes.balance.linearised import EventRows, Linear
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.effects.appendage import (
    KnownMotion,
    oscillation_series,
    products_of_turns,
)
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
    over_sizes,
    posterior,
    scales_of_sizes,
    shapes_of_cells,
    shapes_over_dampings,
)
from cassini_bayes.effects.oscillation import Oscillation, over_trapezoids

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
    believed = np.array([scales[0], *scales])
    units = scales_of_sizes(believed)
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
        return posterior(*products, sizes_about(np.array([along]), inertia_kg_m2, units)[:, 0])

    frequency, damping = _at_maximum(
        lambda f, d: float(posterior_of((f, d, direction)).of_all_sizes), frequency, damping, span
    )
    of_best = of_directions(frequency, damping)
    found = (frequency, damping, of_best.best)
    of_line = posterior_of(found)
    most = int(of_line.log_evidence.argmax())
    gain = float(of_line.log_evidence[most])
    # one is taken of all scales, directions and lines: what others have of the evidence is a cost
    log_looks = float(np.log(len(frequencies) * len(DAMPINGS))) + gain - of_best.log_evidence
    of_direction = float(of_line.of_all_sizes) - of_best.log_evidence
    step = float(np.median([motion.step_s for motion in motions]))
    of_found = shapes_over_dampings(posterior_of, found, span, units).less(of_direction)
    near = {line: of_directions(*line).about_axes for line in finer}
    others = _other_lines(found, span, near, (frequencies, looks, peaks), units)
    shapes = Shapes.joined([of_found, *others])
    sd = 0.0 if of_best.best in BODY_AXES else float(np.degrees(of_best.oblique_sd_rad))
    swing, _, share = (float(of) for of in units[most] / believed)
    return Oscillation(*found, sd, log_looks, gain, span, step, swing, share, shapes=shapes)


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
    """Log evidence (f,) about the best direction, roughly, by that (K, f, 3) about every axis.

    Whitened amplitudes along the axes, (3, 2) cosines and sines, gain half the square of their
    largest singular value where the line is oblique.
    """
    free = look.covariance[..., :2, :2]
    factor = np.linalg.cholesky(free)
    whitened = np.linalg.solve(factor, look.mean[..., :2, None])[..., 0]  # (K, f, 3, 2)
    largest = np.linalg.eigvalsh(np.swapaxes(whitened, -2, -1) @ whitened)[..., -1]
    own = 0.5 * np.linalg.slogdet(free)[1]
    oblique = 0.5 * largest + own.min(axis=-1)
    return over_sizes(np.maximum(look.log_evidence.max(axis=-1), oblique))


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
    as much of the evidence as those about body axes.
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


def _coarse(
    rows: Sequence[EventRows],
    motions: Sequence[KnownMotion],
    frequencies: Array,
    damping: float,
    size: Array,
) -> Posterior:
    """Posterior (K, f, 3) of every frequency about every axis, columns as they are.

    ``size`` (K, 3, 3) has K scales of the sizes about every axis.
    """
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
    return posterior(gram, projection, size[:, None])


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
    seen = over_trapezoids(frequency_hz, motion.step_s)
    return event.turns.in_modes(seen * event.turns.pieces.integrated(series))
