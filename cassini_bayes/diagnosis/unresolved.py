"""What records leave open, as unknowns of the rows' linear model.

Counters show what fired in an interval, not when. The likelihood's columns are averages over when;
each firing departs from them by an amount of its own: single tails may have been cut
(:mod:`cassini_bayes.diagnosis.cut_tails`), and effects whose columns depend on when a pulse was
fired say what they leave open (``left_open`` of their kind). A wheel that rests has one rounding
for minutes, and that of a wheel driven evenly comes back with every step: neither is white noise of
its rows. Rows can have a column for every firing, every rest and every such line, which a Gram
matrix could not.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.balance.rounded_wheels import (
    WINDOW,
    ShownRows,
    between_steps,
    long_stretches,
)
from cassini_bayes.balance.telemetry_noise import lasting_shares
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.cut_tails import single_cuts
from cassini_bayes.diagnosis.hypotheses import Hypothesis, expected_thrusts_n
from cassini_bayes.effects.effect import FittedRows
from cassini_bayes.effects.firings import fired_intervals

Unknowns = tuple[Array, Array]
"""Columns (n, 3, s) and variances (s,) of their unknowns, together N m s, whose means are 0."""

LEAST_REST: Final = 2 * WINDOW
"""Rows over which a wheel's rounding has to last: fewer are as good as white in a drift."""
LEAST_SHARE: Final = 1e-3  # of a rounding's square in a line: less does not stand out of noise


def unresolved(hypothesis: Hypothesis, z: Array, place: int) -> Unknowns:
    """What records leave open in the rows of an event (``place``) by a hypothesis at z (d,)."""
    parts = (
        single_cuts(hypothesis, z, place),
        timed(hypothesis, z, place),
        roundings(hypothesis, z, place),
        rounding_lines(hypothesis, z, place),
    )
    columns, variances = zip(*parts, strict=True)
    return np.concatenate(columns, axis=2), np.concatenate(variances)


def roundings(hypothesis: Hypothesis, z: Array, place: int) -> Unknowns:
    """Roundings of wheels at rest: one for every stretch of sixteen rows and more.

    Its variance is Δ²/12 times the share that noise of the measurement leaves of it
    (docs/topics/telemetry-likelihood.md §11). It stays in the rows' white noise as well: 2 to 13 %
    of the wheels' part of that in seven flights with steps of 1 rpm.
    """
    shown = _shown(hypothesis, place)
    stretches = long_stretches(shown, LEAST_REST)
    shares, weights = _wheels(hypothesis, z, place)
    columns = np.zeros((len(shown.time_s), 3, len(stretches)))
    for i, (wheel, rows) in enumerate(stretches):
        columns[rows, :, i] = np.sqrt(shares.sum() / 12.0) * shown.step * weights[:, wheel]
    return columns, np.ones(len(stretches))


def rounding_lines(hypothesis: Hypothesis, z: Array, place: int) -> Unknowns:
    """Roundings of wheels that are driven: they come back with every step.

    In rows beside its rests (:func:`roundings`) harmonic k of a wheel's sawtooth has a sine and a
    cosine of 2π k times the rate in steps, each with the square of that harmonic: of a wheel driven
    evenly they are lines. They stay in the rows' white noise as well. Rows that are means over
    blocks have next to none.
    """
    shown = _shown(hypothesis, place)
    shares, weights = _wheels(hypothesis, z, place)
    seen = shares[shares >= LEAST_SHARE]
    if shown.step == 0.0 or not len(seen) or shown.averaged > 1.0:
        return np.zeros((len(shown.time_s), 3, 0)), np.zeros(0)
    driven = np.ones(shown.rates.shape, dtype=bool)
    for wheel, rows in long_stretches(shown, LEAST_REST):
        driven[rows, wheel] = False
    samples = hypothesis.model.telemetry[place].event.samples
    at = hypothesis.model.telemetry[place].event.usable_places
    read = np.flatnonzero(samples.has_state)  # counters may come at times of their own
    order, columns = np.arange(1, len(seen) + 1), [np.zeros((len(at), 3, 0))]
    for wheel in np.flatnonzero(driven.sum(axis=0) >= LEAST_REST).tolist():
        levels = samples.wheel_rad_s[read, wheel] / shown.step
        rate = between_steps(samples.time_s[read], levels)[0][np.searchsorted(read, at)]
        phase = 2.0 * np.pi * np.multiply.outer(rate, order)
        waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
        waves *= shown.step * np.sqrt(np.tile(seen, 2) / 12.0) * driven[:, wheel, None]
        columns.append(waves[:, None] * weights[:, wheel, None])
    result = np.concatenate(columns, axis=2)
    return result, np.ones(result.shape[2])


def _shown(hypothesis: Hypothesis, place: int) -> ShownRows:
    """What wheels print in the usable rows of an event."""
    event = hypothesis.model.telemetry[place].event
    at, statistics = event.usable_places, event.statistics
    step, averaged = statistics.steps.wheel_rad_s, statistics.counters.averaged
    rates, time_s = event.samples.wheel_rad_s[at], event.samples.time_s[at]
    return ShownRows(time_s, rates, step, averaged=averaged)


def _wheels(hypothesis: Hypothesis, z: Array, place: int) -> tuple[Array, Array]:
    """Shares (H,) of a rounding that repeat, and momentum (3, W) per rate of the wheels, N m s²."""
    term = hypothesis.model.telemetry[place]
    located = hypothesis.model.points(z[None])
    weights = term.balance.wheel_weights(term.physics(located)).reshape(3, -1)
    return lasting_shares(term.balance, located.parameters)[0], weights


def timed(hypothesis: Hypothesis, z: Array, place: int) -> Unknowns:
    """The part that depends on when in an interval pulses were fired, by effects that have one.

    The likelihood has the mean of it.
    """
    model = hypothesis.model
    term = model.telemetry[place]
    layout, time_s = term.event.statistics.layout, term.event.usable_rows.time_s
    effects = [effect for effect in hypothesis.effects if effect.kind.left_open is not None]
    parts = [(np.zeros((len(time_s), 3, 0)), np.zeros(0))]
    points = model.points(z[None])
    physics, thrust_n = term.physics(points), expected_thrusts_n(term, points)[0]
    rows = FittedRows(time_s, term.event.samples, physics)
    for members in layout.couples if effects and layout.thrusters else ():
        arms = np.broadcast_to(physics.arms_m, (1, 3, len(layout.thrusters)))[0]
        fired = fired_intervals(term.event.samples, members, thrust_n * arms)
        for effect in effects:
            setting = effect.setting(model.spacecraft, model.branch)
            values = effect.values(points.parameters)
            assert effect.kind.left_open is not None  # it is timed
            parts.append(effect.kind.left_open(fired, rows, values, setting))
    columns, variances = zip(*parts, strict=True)
    return np.concatenate(columns, axis=2), np.concatenate(variances)
