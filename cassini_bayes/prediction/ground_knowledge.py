"""What past events determine beside thrust and firing: counts, grams, seconds, trends.

Each is a small regression (:mod:`.regressions`) on figures of the given events alone: pulses on
on-times, hydrazine on impulse, the duration on wheel changes, and the drift of what the ground
software printed (thrust, thrust over mass, mass) with time.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import effective_on_times
from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.posterior import Model
from cassini_bayes.prediction.beliefs import Beliefs
from cassini_bayes.prediction.demand import PairLayout
from cassini_bayes.prediction.physics import PhysicsDraws
from cassini_bayes.prediction.regressions import Regression, conditional, regress
from cassini_bayes.prediction.wheel_profile import SETTLING_TIMES
from cassini_bayes.spacecraft import thruster_directions
from cassini_bayes.spacecraft.units import YEAR_S

GRAVITY_M_S2: Final = 9.80665
PRINTED_THRUST_SD_N: Final = 0.005
PRINTED_ACCELERATION_SD_M_S2: Final = 1.5e-6
PRINTED_MASS_SD_KG: Final = 5.0
TREND_SD_PER_YEAR: Final = 0.05  # of the value itself: what is printed falls by 4 % a year
HYDRAZINE_STEP_G: Final = 1.0
HYDRAZINE_RELATIVE: Final = 0.03
DURATION_SD_S: Final = 1.5
MOST_TURNS: Final = 5  # in which the slowest wheels of all events are found
LEAST_POSSIBLE: Final = 0.5  # share of draws in which loop time and ramps are positive


@dataclass(frozen=True)
class Trend:
    """A value that drifts with time: centre and slope per year about a reference epoch, (n,)."""

    reference: datetime
    centre: Array
    slope_per_year: Array
    scatter: Array

    def at(self, epoch: datetime) -> Array:
        """Values (n,) at an epoch, without scatter."""
        years = (epoch - self.reference).total_seconds() / YEAR_S
        return np.asarray(self.centre + self.slope_per_year * years)


def mean_pulse_rate(events: tuple[TotalsEvent, ...], layout: PairLayout) -> float:
    """Pulses per commanded second over all events and units, 1/s."""
    on_time, pulses = _unit_totals(events, layout)
    return float(pulses.sum() / on_time.sum())


def _unit_totals(events: tuple[TotalsEvent, ...], layout: PairLayout) -> tuple[Array, Array]:
    first = [unit[0] for unit in layout.units]
    on_time = np.concatenate([event.on_time_s[first] for event in events])
    pulses = np.concatenate([np.asarray(event.pulses)[first] for event in events])
    fired = on_time > 0
    return on_time[fired], pulses[fired]


def pulse_regression(
    events: tuple[TotalsEvent, ...],
    layout: PairLayout,
    beliefs: Beliefs,
    rng: np.random.Generator,
    size: int,
) -> Regression:
    """N = r u + noise of variance φ r u: coefficient r, scale φ (1 for Poisson counts)."""
    on_time, pulses = _unit_totals(events, layout)
    rate = beliefs.moments("pulses_per_second")
    variance = rate[0] * on_time
    return regress(on_time[:, None], pulses, variance, [rate], rng, size=size, scale=0.25)


def group_impulse(layout: PairLayout, thrust_n: Array, effective_s: Array) -> tuple[Array, Array]:
    """Impulse (n, …) of all thrusters and of those of the couple axis, N s."""
    couple = sorted({k for unit in layout.units[:2] for k in unit})
    impulse = thrust_n * effective_s
    return np.asarray(impulse.sum(-1)), np.asarray(impulse[..., couple].sum(-1))


def hydrazine_regression(
    model: Model,
    events: tuple[TotalsEvent, ...],
    physics: PhysicsDraws,
    layout: PairLayout,
    beliefs: Beliefs,
    rng: np.random.Generator,
) -> Regression | None:
    """Grams = 1000/g (impulse/I_sp + couple impulse · departure) + offset."""
    rows = [row for row, event in enumerate(events) if event.hydrazine_g is not None]
    if not rows:
        return None
    term = model.totals_rows
    effective = effective_on_times(
        term.pulse_shape, physics.balance(model), term.stack.on_time_s, term.stack.pulses
    )
    total, couple = group_impulse(layout, physics.thrust_n[:, rows], effective[..., rows, :])
    grams = np.array([events[row].hydrazine_g for row in rows], dtype=np.float64)
    design = np.stack([total, couple, np.ones_like(total)], axis=-1)
    design[..., :2] *= 1e3 / GRAVITY_M_S2
    isp, isp_sd = beliefs.moments("specific_impulse_s")
    group = beliefs.moments("specific_impulse_group_s")[1]
    offset = beliefs.moments("hydrazine_offset_g")
    prior = [(1.0 / isp, isp_sd / isp**2), (0.0, group / isp**2), offset]
    return regress(design, grams, hydrazine_variance(grams), prior, rng, size=physics.size)


def hydrazine_g(coefficients: Array, total: Array, couple: Array) -> Array:
    """Grams (n,) of impulses (n,) of all thrusters and of the couple axis, N s, at draws (n, 3)."""
    inverse, departure, offset = coefficients.T
    return np.asarray(1e3 / GRAVITY_M_S2 * (total * inverse + couple * departure) + offset)


def hydrazine_variance(grams: Array) -> Array:
    """Variance of a printed mass before scaling: its step of one gram, and 3 % of it."""
    return np.asarray(HYDRAZINE_STEP_G**2 / 12.0 + (HYDRAZINE_RELATIVE * grams) ** 2)


def manager_regression(
    events: tuple[TotalsEvent, ...],
    wheels: tuple[int, ...],
    beliefs: Beliefs,
    rng: np.random.Generator,
    size: int,
) -> Regression:
    """Ramps of the wheels and loop time from the durations: D = p_j |Δ_j| + (n − 1) τ.

    j is the wheel whose ramp lasts longest: by the prior's ramps, then by those that come out.
    Ramps and loop time are positive.

    Raises
    ------
    InputError
        Durations that hardly any positive loop time and ramps give.
    """
    durations = np.array([event.duration_s for event in events])
    variance = np.full(len(events), DURATION_SD_S**2)
    ramps = len(wheels) * [beliefs.moments("wheel_ramp_s_per_rpm")]
    prior = [*ramps, beliefs.moments("wheel_loop_s")]
    mean, sd = np.array(prior).T.copy()
    found = mean
    for _ in range(MOST_TURNS):
        design = _durations_design(events, wheels, found[:-1])
        found, _ = conditional(design, durations, variance, mean, sd, 1.0)
    result = regress(design, durations, variance, prior, rng, size=size)
    possible = np.flatnonzero((result.coefficients > 0.0).all(1))
    if len(possible) < LEAST_POSSIBLE * size:
        loop = result.coefficients[:, -1]
        raise InputError(
            "duration_s of the events",
            "durations of ramps that settle, D = p |Δ| + 5 τ with τ > 0 (priors of prediction: "
            f"wheel_ramp_s_per_rpm {ramps[0][0]:.3g} ± {ramps[0][1]:.2g} s/rpm, wheel_loop_s)",
            f"a loop time τ of {loop.mean():.3g} ± {loop.std():.2g} s",
            "a duration ends when the last wheel has settled; of wheels with another torque, give "
            "their ramp with --beliefs",
        )
    if len(possible) == size:
        return result
    chosen = rng.choice(possible, size)
    return Regression(result.coefficients[chosen], result.scale_square[chosen])


def _durations_design(
    events: tuple[TotalsEvent, ...], wheels: tuple[int, ...], ramps: Array
) -> Array:
    """What ramps (W,) and loop time add to every duration (E, W + 1), by the slowest wheels."""
    design = np.zeros((len(events), len(wheels) + 1))
    for row, event in enumerate(events):
        change = np.abs(event.rwa_end_rpm - event.rwa_start_rpm)
        places = [wheels.index(number) for number in event.wheels]
        slowest = int(np.argmax(ramps[places] * change))
        design[row, places[slowest]] = change[slowest]
    design[:, -1] = SETTLING_TIMES - 1.0
    return design


def trend_of(
    epochs: list[datetime],
    values: list[float | None],
    sd: float,
    rng: np.random.Generator,
    size: int,
) -> Trend | None:
    """Centre and slope of what the ground software printed; None where no event has a value."""
    given = [(e, value) for e, value in zip(epochs, values, strict=True) if value is not None]
    if not given:
        return None
    first = min(e for e, _ in given)
    reference = first + sum((e - first for e, _ in given), timedelta()) / len(given)
    years = np.array([(e - reference).total_seconds() / YEAR_S for e, _ in given])
    target = np.array([value for _, value in given])
    level = float(target.mean())
    design = np.stack([np.ones_like(years), years], axis=-1)
    prior = [(level, 0.02 * level), (0.0, TREND_SD_PER_YEAR * level)]
    result = regress(design, target, np.full(len(years), sd**2), prior, rng, size=size)
    centre, slope = result.coefficients.T
    return Trend(reference, centre, slope, sd * np.sqrt(result.scale_square))


def no_trend(epochs: list[datetime], size: int) -> Trend:
    """No trend, where no thrust was printed."""
    return Trend(min(epochs), np.zeros(size), np.zeros(size), np.zeros(size))


def lateral_variance(
    model: Model, events: tuple[TotalsEvent, ...], rng: np.random.Generator, size: int
) -> Array:
    """Variance (n,) of a printed ΔV component across the net thrust, (m/s)²."""
    directions = thruster_directions(model.spacecraft, model.branch)
    square, count = 0.0, 0
    for event in events:
        if event.delta_v_m_s is None:
            continue
        net = directions @ event.on_time_s
        unit = net / max(float(np.linalg.norm(net)), 1e-12)
        across = event.delta_v_m_s - unit * (unit @ event.delta_v_m_s)
        square, count = square + float(across @ across), count + 2
    weight = 2.0
    return np.asarray((weight * 1e-10 + square) / rng.chisquare(weight + count, size))
