"""A boom or propellant that moves against the body: an oscillation in the rates.

An appendage of moment of inertia φ J about a direction of the body moves at a rate ω + q; its
momentum φ J q is what the balance lacks, q a free oscillation and an answer D to the body's own
motion (:mod:`cassini_bayes.effects.appendage`), which firings and wheels drive:
J (c e^(−ζΩt) cos Ωt + s e^(−ζΩt) sin Ωt − φ D), whatever the controllers do. The free oscillation
starts alike in every event, t from its first row, or in each anew (:mod:`.line_starts`). Frequency,
damping and direction are those of most evidence in what a model leaves (:mod:`.line_directions`);
the fit has departures of the first two in first order.

Noise of measured rates would drive D as well: errors in variables, by which a share φ of 0.004
comes out as 0.001 where rates have 2e-5 rad/s (docs/topics/criticism.md §2). So D is of the rates
that the balance of momentum shows, ω − J⁻¹ r with r what the baseline leaves; wheels tell them ten
times better. They lack what the appendage gives its body: then D has the frequency and damping of
the free spacecraft, and is 1 − φ times too small.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.linearised import InnovationRows
from cassini_bayes.balance.physics import Parameters, Physics
from cassini_bayes.balance.statistics import Samples
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.appendage import known_motion
from cassini_bayes.effects.changes import AXES, with_columns
from cassini_bayes.effects.effect import FittedRows, Kind, Remainder, Setting, Values
from cassini_bayes.effects.firings import FiredIntervals
from cassini_bayes.effects.line_search import find_oscillation
from cassini_bayes.effects.line_shapes import draw_shapes
from cassini_bayes.effects.oscillation import SERIES, BalancedRates, Oscillation, slope_names
from cassini_bayes.effects.wording import Clause
from cassini_bayes.priors.distributions import Distribution


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
    amplitude = np.hypot(values["cosine_rad_s"], values["sine_rad_s"])
    return _of_free_body(line, amplitude, values["inertia_fraction"], frequency, damping)


def drawn(setting: Setting, rng: np.random.Generator, draws: int) -> Values:
    """Sizes (n,) over all lines (:class:`.Shapes`), as :func:`report` has them."""
    line = _line(setting)
    if not line.shapes:
        return {}
    return _of_free_body(line, *draw_shapes(line.shapes, rng, draws))


def _of_free_body(
    line: Oscillation, amplitude: Array, share: Array, frequency: Array, damping: Array
) -> Values:
    """Sizes by those of the line: see :func:`report`."""
    shown = line.measured * np.sinc(frequency * line.step_s) ** 2
    fraction = share / (1.0 + (1.0 - shown) * share)
    free = np.sqrt(1.0 - shown * fraction)
    return {
        "inertia_fraction": fraction,
        "frequency_hz": frequency / free,
        "damping": np.maximum(damping, 0.0) / free,
        "amplitude_rad_s": amplitude,
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


def balanced_rates(samples: Samples, rows: InnovationRows, inertia_kg_m2: Array) -> BalancedRates:
    """Rates of an event's samples, those of its rows less what the balance leaves over J (3,)."""
    rate = samples.rate_rad_s.copy()
    at = np.searchsorted(samples.time_s, rows.time_s)
    rate[at] -= rows.residual_n_m_s / inertia_kg_m2
    sampled = int(np.isfinite(samples.rate_rad_s).all(1).sum())
    return BalancedRates.instead(samples.rate_rad_s, rate, len(at) / max(sampled, 1))


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
