"""What counters leave open, as unknowns of the rows' linear model.

Counters tell what fired in an interval, not when. The likelihood's columns are averages over when;
each firing departs from them by an amount of its own:

- single tails may have been cut (:mod:`cassini_bayes.diagnosis.cut_tails`);
- with records late by τ a row at t shows what had been fired by t + τ, which lies within an
  interval: the share f of its time has gone by, but a pulse has been fired or not, with variance
  f (1 − f);
- a pulse drives an appendage from when it was fired: with δ the time from the middle of a slope of
  length Δ, from one measured rate to the next, its answer has sin Ωδ out of phase, of variance
  (1 − sin ΩΔ / ΩΔ) / 2. The middle is taken to be that of the counter interval.

Rows can have a column for every one, which a Gram matrix could not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.statistics import Samples
from cassini_bayes.diagnosis.cut_tails import single_cuts
from cassini_bayes.diagnosis.extended import Case, Hypothesis
from cassini_bayes.effects.columns import TAIL_S

Array = NDArray[np.float64]
Unknowns = tuple[Array, Array, Array]
TIMED: Final = ("time_offset", "flexible_mode")
"""Kinds whose columns depend on when in an interval a pulse was fired."""
LEAST_IDLE: Final = 1e-3  # of an interval: where firing fills it nothing is open


@dataclass(frozen=True)
class Firings:
    """Counter intervals (m,) in which thrusters that only fire together did, not without pause.

    ``momentum_n_m_s`` (m, 3) is what they gave, ``scatter`` (m,) the variance that single moments
    have left: 1/n of one pulse's with n pulses, times the share of the interval without firing.
    """

    start_s: Array
    end_s: Array
    momentum_n_m_s: Array
    scatter: Array


def firings(samples: Samples, members: tuple[int, ...], force: Array) -> Firings:
    """Firings of a couple of thrusters (places ``members``); ``force`` (3, K): torque in N m."""
    counted = samples.has_counters
    time = samples.time_s[counted]
    places = list(members)
    on_time = np.diff(samples.on_time_s[counted][:, places], axis=0)
    pulses = np.diff(samples.pulses[counted][:, places], axis=0)
    fired = np.flatnonzero(np.any((on_time > 0.0) | (pulses > 0.0), axis=1))
    on_time, pulses = on_time[fired], pulses[fired]
    start, end = time[:-1][fired], time[1:][fired]
    given = (on_time + TAIL_S * pulses) @ force[:, places].T
    idle = 1.0 - on_time.max(1, initial=0.0) / (end - start)
    scatter = idle / np.maximum(pulses.max(1, initial=0.0), 1.0)
    kept = idle > LEAST_IDLE
    return Firings(start[kept], end[kept], given[kept], scatter[kept])


def late_firings(fired: Firings, time_s: Array, offset_s: float) -> tuple[Array, Array]:
    """Columns (n, 3, s), N m s, and variances (s,) of firings of which a late record shows a part.

    One unknown for every firing, √(f (1 − f)) of its momentum at the rows at ``time_s`` (n,).
    """
    length = fired.end_s - fired.start_s
    share = np.clip((time_s[:, None] + offset_s - fired.start_s) / length, 0.0, 1.0)
    spread = np.sqrt(share * (1.0 - share))
    seen = np.flatnonzero(spread.any(0))
    columns = spread[:, None, seen] * fired.momentum_n_m_s[seen].T
    return columns, fired.scatter[seen]


def driven_answers(
    fired: Firings,
    time_s: Array,
    change_rad_s: Array,
    line: tuple[float, float],
    step_s: float,
) -> tuple[Array, Array]:
    """Answers (n, s) of an appendage, rad/s, per unit of sin Ωδ, and the variances (s,) of that.

    ``change_rad_s`` (s,) is what every firing changes in the body's rate about the axis, ``line``
    frequency (Hz) and damping, ``step_s`` lies between the rates that show the change as a slope.
    """
    omega, damping = 2.0 * np.pi * line[0], line[1]
    after = time_s[:, None] - 0.5 * (fired.start_s + fired.end_s)
    after = np.where(time_s[:, None] >= fired.end_s, after, 0.0)
    answers = change_rad_s * np.exp(-damping * omega * after) * np.sin(omega * after)
    variance = 0.5 * (1.0 - np.sinc(omega * step_s / np.pi)) * fired.scatter
    return answers, variance


def unresolved(case: Case, hypothesis: Hypothesis, z: Array, place: int, time_s: Array) -> Unknowns:
    """What counters leave open in an event's rows by a hypothesis at z (d,).

    Returns
    -------
    Columns (n, 3, s) in N m s, variances (s,) of their unknowns, whose means are 0, and what the
    likelihood lacks on average (n, 3).
    """
    columns, variance, mean = single_cuts(case, hypothesis, z, place, time_s)
    kinds = {effect.kind for effect in hypothesis.effects}
    term = hypothesis.model.telemetry[place]
    layout = term.event.statistics.layout
    if kinds.isdisjoint(TIMED) or not layout.thrusters:
        return columns, variance, mean
    model, source = hypothesis.model, case.sources[place]
    points = model.points(z[None])
    parameters, physics = points.parameters, term.physics(points)
    arms = np.broadcast_to(physics.arms_m, (1, 3, len(layout.thrusters)))[0]
    found = [(columns, variance)]
    for members in layout.couples:
        fired = firings(source.samples, members, model.thrust_prior.common_mean_n * arms)
        for effect in hypothesis.effects:
            values = {p.key: float(np.ravel(parameters[p.name])[0]) for p in effect.parameters}
            if effect.kind == "time_offset":
                found.append(late_firings(fired, time_s, values["time_offset_s"]))
            elif effect.kind == "flexible_mode":
                share = values["inertia_fraction"]
                found.append(_driven(hypothesis, physics, fired, source.samples, time_s, share))
    together, variances = zip(*found, strict=True)
    return np.concatenate(together, axis=2), np.concatenate(variances), mean


def _driven(
    hypothesis: Hypothesis,
    physics: Physics,
    fired: Firings,
    samples: Samples,
    time_s: Array,
    share: float,
) -> tuple[Array, Array]:
    """Columns (n, 3, s) in N m s of what an appendage with a share of the inertia answers."""
    line = hypothesis.oscillation
    assert line is not None  # flexible_mode comes with its line
    step = float(np.median(np.diff(samples.time_s[np.isfinite(samples.rate_rad_s).all(1)])))
    inertia = np.broadcast_to(physics.inertia_kg_m2, (1, 3, 3))[0]
    change = np.linalg.solve(inertia, fired.momentum_n_m_s.T)[line.axis]
    shape = line.frequency_hz, line.damping
    answers, variance = driven_answers(fired, time_s, change, shape, step)
    moment = share * inertia[line.axis, line.axis]
    return moment * answers[:, None] * np.eye(3)[line.axis][:, None], variance
