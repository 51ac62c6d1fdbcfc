"""What ``flexible_mode`` is given to explain: the oscillation that the innovations speak for.

An appendage on a spring (a boom, sloshing propellant) of moment of inertia φ J about a body axis
moves at a rate ω + q; its momentum φ J q is what the balance lacks. With Ω and ζ of the clamped
appendage q'' + 2 ζ Ω q' + Ω² q = −ω'': q is a free oscillation, cosine and sine, and an answer D to
the body's own motion, which firings and wheels drive. What the balance lacks is
J (c e^(−ζΩt) cos Ωt + s e^(−ζΩt) sin Ωt − φ D), whatever the controllers do. The free oscillation
is taken to start alike in every event, t from its first row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from cassini_bayes.diagnosis.extended import Case, Hypothesis, Oscillation, reduce_source
from cassini_bayes.diagnosis.innovations import EventRows, Linear
from cassini_bayes.effects.columns import (
    KnownMotion,
    flexible_columns,
    known_motion,
    oscillation_series,
    telemetry_columns,
)

Array = NDArray[np.float64]
LEAST_CYCLES: Final = 4.0  # in the longest event: what is slower is a drift
DAMPINGS: Final = (0.0, 0.001, 0.003, 0.01, 0.03)
COARSE_DAMPINGS: Final = (0.0, 0.003)
PEAKS: Final = 6
FINER: Final = (-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75)  # of a line's width
LARGEST_ROOT: Final = 0.3  # of the damping
MOST_LOOKS: Final = 60  # for the last digits of frequency and damping


def motions_of(case: Case) -> tuple[KnownMotion, ...]:
    """What the body's own rates tell, of every telemetry event."""
    return tuple(known_motion(own.samples.time_s, own.samples.rate_rad_s) for own in case.sources)


def flexible_case(case: Case, oscillation: Oscillation) -> Case:
    """The case reduced again with the columns of the oscillation beside all others."""
    own = oscillation
    line = own.frequency_hz, own.damping, own.axis, own.span_s
    reduced = tuple(
        reduce_source(
            source,
            case.priors,
            (*telemetry_columns(source.thrusters), *flexible_columns(*line, motion)),
            before.sampling.pulse_shape.name,
        )
        for source, before, motion in zip(case.sources, case.reduced, motions_of(case), strict=True)
    )
    return replace(case, reduced=reduced, oscillation=oscillation)


def case_of(case: Case, hypothesis: Hypothesis) -> Case:
    """The case with the columns that a hypothesis needs: the same where it has no oscillation."""
    line = hypothesis.oscillation
    return case if line is None else flexible_case(case, line)


def find_oscillation(
    rows: Sequence[EventRows],
    motions: Sequence[KnownMotion],
    linear: Linear,
    inertia_kg_m2: Array,
    scales: tuple[float, float],
) -> Oscillation | None:
    """The oscillation of most evidence; None where the events are too short for any.

    All frequencies a line's width apart are looked at with two dampings and with what the fit takes
    away left in the columns; the best of them and their neighbours with that taken off; the best of
    these with all dampings; the best of all goes on to the maximum.

    Parameters
    ----------
    rows, motions, linear
        Innovations and known motion of every event, and the linear model that left them.
    inertia_kg_m2
        Moments (3,) about body axes.
    scales
        Prior scales of the amplitude (rad/s) and of the appendage's share φ of the inertia.
    """
    span = max(float(own.time_s[-1] - own.time_s[0]) for own in rows)
    highest = 0.5 / min(float(np.median(np.diff(own.time_s))) for own in rows)
    frequencies = np.arange(LEAST_CYCLES / span, highest, 1.0 / span)
    if len(frequencies) == 0:
        return None
    size = inertia_kg_m2[:, None] * np.array([scales[0], scales[0], scales[1]])  # (3 axes, 3)
    scores = np.maximum.reduce(
        [_coarse(rows, motions, frequencies, own, size) for own in COARSE_DAMPINGS]
    )
    factor = cho_factor(linear.gram())
    abouts = [_about(rows, linear, axis) for axis in range(3)]

    def score(line: tuple[float, float, int]) -> float:
        frequency, damping, axis = line
        gram, seen = _fine(rows, motions, abouts[axis], factor, (frequency, damping, axis))
        return float(_log_evidence(gram, seen, size[axis]))

    tried = [
        (float(frequencies[f] + shift / span), damping, axis)
        for f, axis in _peaks(scores)
        for shift in FINER
        for damping in COARSE_DAMPINGS
    ]
    best = list(
        dict.fromkeys((frequency, axis) for frequency, _, axis in sorted(tried, key=score)[::-1])
    )[:PEAKS]
    tried = [(frequency, damping, axis) for frequency, axis in best for damping in DAMPINGS]
    frequency, damping, axis = max(tried, key=score)

    def loss(x: Array) -> float:
        return -score((frequency + float(x[0]) / span, float(x[1]) ** 2, axis))

    root = float(np.sqrt(damping))
    corners = np.array([[0.0, root], [0.1, root], [0.0, root + 0.01]])
    options = {"initial_simplex": corners, "maxfev": MOST_LOOKS, "xatol": 1e-3, "fatol": 1e-3}
    bounds = ((-2.0, 2.0), (0.0, LARGEST_ROOT))
    found = minimize(loss, corners[0], method="Nelder-Mead", bounds=bounds, options=options)
    looks = float(np.log(3 * len(frequencies) * len(DAMPINGS)))
    frequency += float(found.x[0]) / span
    step = float(np.median([motion.step_s for motion in motions]))
    damping = float(found.x[1] ** 2)
    return Oscillation(frequency, damping, axis, looks, -float(found.fun), span, step)


def _log_evidence(gram: Array, seen: Array, size: Array) -> Array:
    """log Z (...) against no oscillation of columns with Gram (..., 3, 3), Aᵀy (..., 3)."""
    precision = gram * size[..., :, None] * size[..., None, :] + np.eye(gram.shape[-1])
    b = seen * size
    mean = np.linalg.solve(precision, b[..., None])[..., 0]
    return np.asarray(0.5 * (b * mean).sum(-1) - 0.5 * np.linalg.slogdet(precision)[1])


def _coarse(
    rows: Sequence[EventRows],
    motions: Sequence[KnownMotion],
    frequencies: Array,
    damping: float,
    size: Array,
) -> Array:
    """Log evidence (f, 3) of every frequency about every axis, columns as they are."""
    gram = np.zeros((len(frequencies), 3, 3, 3))
    seen = np.zeros((len(frequencies), 3, 3))
    for own, motion in zip(rows, motions, strict=True):
        directions = np.linalg.inv(own.noise_factor)  # column a: a unit of momentum, whitened
        lengths = (directions**2).sum(0)
        left = own.white @ directions
        squares, along = motion.products(own.time_s, frequencies, damping, left)
        squares[:, :2, 2:] *= -1.0  # what the balance lacks is less the driven part
        squares[:, 2:, :2] *= -1.0
        along[:, 2:] *= -1.0
        for axis in range(3):
            places = np.array([0, 1, 2 + axis])
            gram[:, axis] += lengths[axis] * squares[:, places[:, None], places]
            seen[:, axis] += along[:, places, axis]
    return _log_evidence(gram, seen, size)


def _peaks(scores: Array) -> list[tuple[int, int]]:
    """Places (frequency, axis) of the highest scores, no two of them neighbours."""
    found: list[tuple[int, int]] = []
    for flat in np.argsort(-scores, axis=None):
        f, axis = (int(i) for i in np.unravel_index(int(flat), scores.shape))
        if all(axis != a or abs(f - g) > 1 for g, a in found):
            found.append((f, axis))
        if len(found) == PEAKS:
            break
    return found


class _About(NamedTuple):
    """What one event's rows show about an axis: whitened momentum along it is weighed with these.

    ``length`` is the square of a whitened unit, ``white`` (n,) and ``columns`` (n, p) innovations
    and the linear model's columns along it.
    """

    length: float
    white: Array
    columns: Array


def _about(rows: Sequence[EventRows], linear: Linear, axis: int) -> list[_About]:
    """Every event's view of an axis."""
    found = []
    for own, part in zip(rows, linear.parts, strict=True):
        direction = np.linalg.inv(own.noise_factor)[:, axis]
        columns = linear.columns[part].reshape(len(own.white), 3, -1)
        along = np.tensordot(columns, direction, (1, 0))
        found.append(_About(float(direction @ direction), own.white @ direction, along))
    return found


def _fine(
    rows: Sequence[EventRows],
    motions: Sequence[KnownMotion],
    abouts: Sequence[_About],
    factor: tuple[Array, bool],
    line: tuple[float, float, int],
) -> tuple[Array, Array]:
    """Gram (3, 3) and Aᵀy (3,) of one oscillation's columns, what the fit takes away taken off.

    ``line`` is its frequency (Hz), damping and axis, ``abouts`` the view of that axis, ``factor``
    that of the linear model's Gram.
    """
    frequency_hz, damping, axis = line
    gram, seen = np.zeros((3, 3)), np.zeros(3)
    across = np.zeros((abouts[0].columns.shape[1], 3))
    for own, motion, about in zip(rows, motions, abouts, strict=True):
        cosine, sine, driven = oscillation_series(own.time_s, motion, frequency_hz, damping)
        series = np.stack([cosine, sine, -driven[:, axis]], axis=1)
        gram += about.length * series.T @ series
        seen += about.white @ series
        across += about.columns.T @ series
    return gram - across.T @ cho_solve(factor, across), seen
