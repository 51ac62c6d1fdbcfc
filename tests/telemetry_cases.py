"""Made-up telemetry, and a slow, obvious likelihood of it: one row at a time, nothing collapsed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from scipy.linalg import block_diag, cho_solve, null_space, solve_triangular, sqrtm
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from cassini_bayes.balance.statistics import (
    EventStatistics,
    Samples,
    Sampling,
    layout_of,
    reduce_chunks,
)
from cassini_bayes.balance.statistics.first_look import Preparation
from cassini_bayes.balance.statistics.long_levels import LEAST_RATIO
from cassini_bayes.balance.statistics.pulse_columns import WIDTHS_S
from cassini_bayes.computing.arrays import Array, joined
from cassini_bayes.model import Model, ReducedEvent, build_model, reduce_samples
from cassini_bayes.model.event_reduction import sampling_of
from cassini_bayes.model.telemetry import TelemetryTerm
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.spacecraft import (
    Spacecraft,
    inertia_tensor,
    lever_arms,
    wheel_axes,
    wheel_inertias,
)

PRIORS = Path("priors/cassini_b_branch_telemetry.toml")
REFINED = 4  # times that a dense system is solved for what is left
RPM = 2.0 * np.pi / 60.0
MODES = 512
EDGES = (32, 128)
SLOW_EDGES = (1, 2, 4, 8, 16)
SLOPE_EDGES = (1, 2, 4, 8, 32)
ROWS_PER_MODE = 2
SPARSE_S = 4.0
PARTS = 4


@cache
def telemetry_priors() -> Priors:
    """The shipped priors of telemetry."""
    return read_priors(PRIORS)


def made_up_samples(
    rng: np.random.Generator,
    rows: int = 70,
    *,
    fires: bool = True,
    every_s: float = 1.0,
    firing: float = 0.06,
    wander: float = 0.03,
    rate_noise: float = 0.0,
) -> Samples:
    """Telemetry that no spacecraft flew: a wandering attitude, random rates, bursts of firing.

    The wheels are such that the momentum balance holds at the prior means, up to some noise.
    ``firing`` is the chance of a thruster to begin a burst at a row, ``wander`` (rad) how far the
    attitude goes from one row to the next, ``rate_noise`` (rad/s) what measured rates have on top.
    """
    time = every_s * np.arange(rows)
    angle = np.cumsum(wander * rng.standard_normal((rows, 3)), axis=0)
    size = np.linalg.norm(angle, axis=1, keepdims=True) + 1e-12
    attitude = np.concatenate([angle / size * np.sin(size / 2), np.cos(size / 2)], axis=1)
    rate = wander / 30.0 * rng.standard_normal((rows, 3))
    counters = 8 if fires else 0
    on_time, pulses = np.zeros((rows, counters)), np.zeros((rows, counters))
    for k in range(counters):
        starts = rng.random(rows) < firing
        starts[0] = False
        number = np.where(starts, rng.integers(1, 4, rows), 0)
        width = rng.choice([0.03, 0.125, 0.25], rows)
        pulses[:, k] = np.cumsum(number)
        on_time[:, k] = np.cumsum(number * width)
    values = dict.fromkeys(("rwa3_inertia_kg_m2",), 0.16) | nominal_values()
    weights = wheel_weights(telemetry_priors().spacecraft, values)
    arms = lever_arms(telemetry_priors().spacecraft, "B", values)[:, :counters]
    inertial = rotation(attitude[0]).T @ np.array([5.0, -3.0, 8.0])
    wheels = np.zeros((rows, 3))
    for i in range(rows):
        body = rotation(attitude[i])
        if i > 0:
            gained = on_time[i] - on_time[i - 1] + 0.03 * (pulses[i] - pulses[i - 1])
            inertial = inertial + 0.76 * body.T @ arms @ gained
        momentum = body @ inertial - inertia_tensor(values) @ rate[i]
        wheels[i] = np.linalg.solve(weights, momentum) + min(0.03, wander) * rng.standard_normal(3)
    if rate_noise > 0.0:
        rate = rate + rate_noise * rng.standard_normal((rows, 3))
    return Samples(time, attitude, rate, wheels, on_time, pulses)


def nominal_values() -> dict[str, float]:
    """Prior means of all parameters."""
    return {
        name: prior.fixed if prior.distribution is None else prior.distribution.mean()
        for name, prior in telemetry_priors().parameters.items()
    }


def reduced(
    samples: Samples,
    priors: Priors,
    event_id: str = "made-up",
    chunks: int = 1,
    prepared: Preparation | None = None,
) -> tuple[EventStatistics, Sampling]:
    """Statistics of samples cut into chunks."""
    fires = samples.on_time_s.shape[1] > 0
    names = priors.spacecraft.thruster_names(priors.branch) if fires else ()
    sampling = sampling_of(priors, names, float(samples.time_s[-1]), "first_order")
    layout = layout_of((1, 2, 4), names, sampling)
    edges = np.linspace(0, len(samples), chunks + 1).astype(int)
    parts = [samples.part(a, b) for a, b in pairwise(edges)]
    kind = "bias" if fires else "slew"
    statistics = reduce_chunks(event_id, kind, parts, layout, sampling, prepared=prepared)
    return statistics, sampling


def event_of(samples: Samples, priors: Priors, event_id: str = "made-up") -> ReducedEvent:
    """Samples as an event that a model takes."""
    fires = samples.on_time_s.shape[1] > 0
    names = priors.spacecraft.thruster_names(priors.branch) if fires else ()
    sampling = sampling_of(priors, names, float(samples.time_s[-1]), "first_order")
    kind = "bias" if fires else "slew"
    return reduce_samples(event_id, kind, (1, 2, 4), names, samples, sampling)


def model_of(events: list[Samples]) -> Model:
    """A model of made-up events."""
    priors = telemetry_priors()
    return build_model([event_of(own, priors, f"e{i}") for i, own in enumerate(events)], priors)


def wheel_weights(spacecraft: Spacecraft, values: Mapping[str, float]) -> Array:
    """Momentum (3, 3) per rate of wheels 1, 2 and 4, which the made-up events have."""
    return np.asarray(wheel_axes(spacecraft, values) * wheel_inertias(spacecraft, values))[
        :, [0, 1, 3]
    ]


def rotation(q: Array) -> Array:
    """Inertial-to-body matrix of one attitude, written out."""
    x, y, z, w = q
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z],
        ]
    )


@dataclass(frozen=True, eq=False)
class PlainRows:
    """What the balance needs, row by row."""

    times: list[float]
    bodies: list[Array]  # inertial to body
    rates: list[Array]
    wheels: list[Array]
    impulses: list[Array]  # (3 inertial, K) effective impulse per newton, body arms folded in
    torques: list[Array]  # (3, 3) integral of inertial torque directions
    cuts: list[Array]  # (G,) pairs so far that may be close
    fired: list[Array]  # (K,) pulses so far
    pairs: list[tuple[float, int, float]]  # time, couple, how many may be close
    shots: list[tuple[float, int]]  # time and couple of every interval with firing
    firings: list[tuple[float, int, PlainFiring]]  # end, couple and firing

    def slopes_of(self, couple: int, pulses: PlainPulses) -> dict[float, float]:
        """What a couple's firings gain per on-time, by the ends of their intervals."""
        return {
            time: pulses.slope(firing.seconds / firing.count, firing.count)
            for _, own, firing in self.firings
            if own == couple
            for time in firing.times
        }

    def steps_of(self, couple: int, part: int, sampling: Sampling) -> list[PlainStep]:
        """What may step in the momentum of a couple, in one part of the event."""
        parts = PARTS / sampling.duration_s
        steps = plain_steps(self, couple, sampling)
        return [step for step in steps if min(int(parts * step.time), PARTS - 1) == part]


class PlainOpen(NamedTuple):
    """Share of close pulses, and the factors on what coarse counters leave open and on pairs."""

    close: float
    factor: float
    of_pairs: float

    @staticmethod
    def of(values: Mapping[str, float]) -> PlainOpen:
        """At these values of the parameters."""
        return PlainOpen(
            values["close_pulse_share"],
            values.get("open_counter_factor", 1.0),
            values.get("close_pulse_factor", 1.0),
        )

    def of_columns(self, term: TelemetryTerm) -> float:
        """The factor for one event: counters in steps of more than 3 ms have it."""
        return self.factor if term.event.statistics.counters.step_s > 0.003 else 1.0


@dataclass(frozen=True)
class PlainStep:
    """A step at a time: how many pairs may be close, its nominal variance over that of a pair."""

    time: float
    pairs: float
    size: float
    unlike: PlainFiring | None

    def variance(self, pair_s2: float, pulses: PlainPulses, factor: float) -> float:
        """Variance, s², with a factor on that of unlike pulses."""
        result = self.pairs * pair_s2
        if self.unlike is not None:
            mean = self.unlike.seconds / self.unlike.count
            result += factor * pulses.scatter(mean, self.unlike.count)
        return result


@lru_cache(maxsize=512)
def plain_steps(rows: PlainRows, couple: int, sampling: Sampling) -> list[PlainStep]:
    """What may step in the momentum of a couple, in order of time."""
    found: dict[float, PlainStep] = {}
    pulses = plain_pulses(sampling, sampling.pulse_reference_s)
    delay, rise, fall = sampling.pulse_reference_s
    some = [
        plain_pulses(sampling, (delay, a * rise, b * fall))
        for a in np.linspace(0.6, 1.4, 9)
        for b in np.linspace(0.2, 2, 7)
    ]
    for time, own, number in rows.pairs:
        if own == couple:
            found[time] = PlainStep(time, number, number, None)
    for time, own, firing in rows.firings:
        if own != couple:
            continue
        mean = firing.seconds / firing.count
        scatter = pulses.scatter(mean, firing.count)
        most = max(one.scatter(mean, firing.count) for one in some)
        if max(most, scatter) >= 4e-10:
            pairs = found[time].pairs if time in found else 0.0
            size = pairs + scatter / plain_pair(sampling)
            found[time] = PlainStep(time, pairs, size, firing)
    return [step for _, step in sorted(found.items())]


def plain_pair(sampling: Sampling) -> float:
    """Variance of what a pair loses, at the reference and a share of 0.3, s²."""
    gaps, cycle_s, tau = (
        np.array(sampling.gaps_s),
        sampling.control_cycle_s,
        sampling.pulse_reference_s,
    )
    reached = plain_reached(sampling.paired_s, tau)
    return max(reached**4 * plain_losses(gaps, cycle_s, tau, 0.3)[1], 1e-12)


def plain_reached(widths_s: Sequence[float], tau: tuple[float, ...]) -> float:
    """Mean thrust, over the steady one, that first-order pulses of these widths reach."""
    return float(np.mean([1.0 - np.exp(-width / tau[1]) for width in widths_s]))


def plain_losses(
    gaps_s: Array, cycle_s: float, tau: tuple[float, ...], close: float
) -> tuple[float, float]:
    """Mean, s, and variance, s², of what pairs within a second lose: sums over their gaps."""
    even = (np.arange(20_000) + 0.5) / 20_000
    later = gaps_s[:, None] + 0.5 * cycle_s
    later = later + (1.0 - later) * even
    near, far = ((tau[2] - tau[1]) * np.exp(-gap / tau[2]) for gap in (gaps_s, later))
    mean = close * np.mean(near) + (1.0 - close) * np.mean(far)
    square = close * np.mean((near - mean) ** 2) + (1.0 - close) * np.mean((far - mean) ** 2)
    return float(mean), float(square)


def plain_rows(
    samples: Samples, sampling: Sampling, arms: Array, tau: tuple[float, ...]
) -> PlainRows:
    """Every usable row by loops over readings, thrusters and firings, at given lever arms."""
    rows = PlainRows([], [], [], [], [], [], [], [], [], [], [])
    thrusters = samples.on_time_s.shape[1]
    bodies = [rotation(q) for q in samples.attitude]
    impulse = np.zeros((3, thrusters))
    torque = np.zeros((3, 3))
    cuts = np.zeros(len(sampling.couples))
    before = np.zeros(len(sampling.couples))  # pulses in the interval before
    effective = effective_steps(samples, sampling, tau)
    reached = {}  # by pulses of a firing, squared, over those of all
    width = {}
    for g, couple in enumerate(sampling.couples):
        for firing in plain_firings(samples, couple):
            rows.firings.append((float(samples.time_s[firing.rows[-1]]), g, firing))
            own, usual = (
                plain_reached(widths, sampling.pulse_reference_s)
                for widths in ([firing.seconds / firing.count], sampling.paired_s)
            )
            reached.update({(row, g): (own / usual) ** 2 for row in firing.rows})
            width.update({(row, g): max(firing.seconds / firing.count, 0.0) for row in firing.rows})
    for i, time in enumerate(samples.time_s):
        if i > 0:
            mean = 0.5 * (bodies[i] + bodies[i - 1])
            torque = torque + (time - samples.time_s[i - 1]) * mean.T
            for k in range(thrusters):
                impulse[:, k] += mean.T @ arms[:, k] * effective[i, k]
            length = time - samples.time_s[i - 1]
            for g, couple in enumerate(sampling.couples):
                started = max(samples.pulses[i, k] - samples.pulses[i - 1, k] for k in couple)
                gained = max(samples.on_time_s[i, k] - samples.on_time_s[i - 1, k] for k in couple)
                usual = min(1.0, 1.0 / length)  # of two pulses; three are 1.5 times as close
                within = min(usual * max(started / 2.0, 1.0), 5.0 / 3.0) * max(started - 1, 0)
                apart = width.get((i, g), 0.0) + sum(sampling.gaps_s) / len(sampling.gaps_s)
                part = min(apart / length, 0.5)  # of close pairs, which begin in two intervals
                across = min(started * before[g], 4.0) * part / (1.0 - part) / 2.0
                number = within + usual * across
                lose = reached.get((i, g), 0.0)
                cuts[g] += number * lose
                before[g] = max(started, float(gained > 0))
                if number > 0:
                    rows.pairs.append((float(time), g, number * lose**2))
                if before[g]:
                    rows.shots.append((float(time), g))
        if thrusters and not is_quiet(samples, i, sampling.guard_s):
            continue
        rows.times.append(float(time))
        rows.bodies.append(bodies[i])
        rows.rates.append(samples.rate_rad_s[i])
        rows.wheels.append(samples.wheel_rad_s[i])
        rows.impulses.append(bodies[i] @ impulse.copy())
        rows.torques.append(bodies[i] @ torque.copy())
        rows.cuts.append(cuts.copy())
        rows.fired.append(samples.pulses[i].copy())
    return rows


def is_quiet(samples: Samples, row: int, guard_s: float) -> bool:
    """Whether the counters read before the guard time equal those of the row."""
    earlier = [j for j in range(row + 1) if samples.time_s[j] <= samples.time_s[row] - guard_s]
    if not earlier:
        return False
    j = earlier[-1]
    return bool(
        np.array_equal(samples.on_time_s[j], samples.on_time_s[row])
        and np.array_equal(samples.pulses[j], samples.pulses[row])
    )


@cache
def _others(usual: tuple[float, ...], smooth: float) -> dict[int, dict[int, float]]:
    """How likely all pulses but one of a few add up to so many ms, by their number."""
    reach = int(np.ceil(5.0 * smooth / 1e-3))
    have = {i: float(np.exp(-0.5 * (i * 1e-3 / smooth) ** 2)) for i in range(-reach, reach + 1)}
    found = {}
    for count in range(2, 7):
        more: dict[int, float] = {}
        for place, chance in have.items():
            for one in usual:
                own = place + round(one * 1e3)
                more[own] = more.get(own, 0.0) + chance / len(usual)
        found[count] = have = more
    return found


def plain_gains(width: float, rise: float, fall: float) -> list[float]:
    """What a pulse gains over the reference, over a range of time constants."""
    some = [(a * rise, b * fall) for a in np.linspace(0.6, 1.4, 9) for b in np.linspace(0.2, 2, 7)]
    return [plain_tail(width, a, b) - plain_tail(width, rise, fall) for a, b in some]


@lru_cache(maxsize=8192)  # the same at all time constants, of which there are many
def plain_shares(nodes: tuple[float, ...], width: float, rise: float, fall: float) -> Array:
    """Which sum of what pulses of the few widths gain fits best what this one does."""
    at_nodes = np.array([plain_gains(node, rise, fall) for node in nodes]).T
    gains = np.array(plain_gains(width, rise, fall))
    return np.asarray(np.linalg.lstsq(at_nodes, gains, rcond=None)[0])


class PlainPulses:
    """Effective on-time of pulses (first_order) at given time constants, one at a time.

    What a pulse gains over one at the reference is a sum of what pulses of three widths gain (of
    one, if all are long): that which fits best over a range of τ_r and τ_f.
    """

    def __init__(self, sampling: Sampling, tau: tuple[float, ...]) -> None:
        self.usual, self.tau = np.array(sampling.widths_s), tau
        self.smooth = np.hypot(1.5e-3, sampling.unsure_s)
        _, self.rise, self.fall = sampling.pulse_reference_s
        long = min(sampling.widths_s, default=0.0) >= 0.12
        self.nodes = (float(np.median(sampling.widths_s)),) if long else tuple(WIDTHS_S)
        self.known: dict[float, float] = {}
        self.scattered: dict[tuple[float, float], float] = {}

    def fitted(self, width: float) -> float:
        """Effective on-time of one pulse."""
        if width in self.known:
            return self.known[width]
        shares = plain_shares(self.nodes, width, self.rise, self.fall)
        gained = [
            plain_tail(node, self.tau[1], self.tau[2]) - plain_tail(node, self.rise, self.fall)
            for node in self.nodes
        ]
        found = float(width + plain_tail(width, self.rise, self.fall) + shares @ gained)
        self.known[width] = found
        return found

    def alike(self, width: float, count: float) -> bool:
        """Whether pulses with this mean have no widths but this."""
        least, most = min(self.usual, default=width), max(self.usual, default=width)
        return count == 1.0 or not least + 1e-9 < width < most - 1e-9

    def by_sum(self, width: float, count: float) -> Array | None:
        """How likely each of the event's widths is if a few add up to the sum; None if none do."""
        if not 2.0 <= count <= 6.0:
            return None
        others = _others(tuple(self.usual), float(self.smooth))[int(count)]
        result = np.zeros(len(self.usual))
        for q, one in enumerate(self.usual):
            at = (count * width - one) * 1e3
            below = int(np.floor(at))
            ends = (others.get(below, 0.0), others.get(below + 1, 0.0))
            if min(others) <= at <= max(others):
                result[q] = ends[0] + (at - below) * (ends[1] - ends[0])
        possible = result.mean() > 1e-4 * max(others.values())
        return result / result.sum() if possible else None

    def chances(self, width: float) -> Array:
        """Probabilities of the event's widths, by exp(slope width), with this mean."""

        def tilted(slope: float) -> Array:
            raised = np.exp(slope * (self.usual - width) - max(slope * (self.usual - width)))
            return np.asarray(raised / raised.sum())

        def missed(slope: float) -> float:
            return float(tilted(slope) @ self.usual) - width

        reach = 700.0 / float(np.ptp(self.usual))
        ends = [end for end in (-reach, reach) if missed(end) * end <= 0.0]
        return tilted(ends[0] if ends else brentq(missed, -reach, reach, xtol=1e-9))

    def expected(self, width: float, count: float) -> float:
        """Effective on-time of one of so many pulses, less one's share of the scatter."""
        if self.alike(width, count):
            return self.fitted(width)
        each = np.array([self.fitted(one) for one in self.usual])
        chance = self.by_sum(width, count)
        if chance is not None:
            missing = self.fitted(width) - self.fitted(float(chance @ self.usual))
            return float(chance @ each) + missing
        mixed = float(self.chances(width) @ each)
        return mixed + (self.fitted(width) - mixed) / count

    def slope(self, width: float, count: float) -> float:
        """What the sum gains per on-time."""
        ends = (max(width - 1e-3 / count, 0.0), width + 1e-3 / count)
        gained = self.expected(ends[1], count) - self.expected(ends[0], count)
        return gained / (ends[1] - ends[0])

    def scatter(self, width: float, count: float) -> float:
        """Variance of the sum about that: of what is not linear in the widths."""
        if (width, count) in self.scattered:
            return self.scattered[width, count]
        result = 0.0
        if not self.alike(width, count):
            told = self.by_sum(width, count)
            if told is not None and count == 2.0:
                both = [
                    self.fitted(one) + self.fitted(max(2.0 * width - one, 0.0))
                    for one in self.usual
                ]
                result = float(told @ (both - told @ both) ** 2)
                self.scattered[width, count] = result
                return result
            chance = np.sqrt(self.chances(width) if told is None else told)
            linear = np.stack([np.ones_like(self.usual), self.usual], axis=1)
            each = np.array([self.fitted(one) for one in self.usual])
            fit = np.linalg.lstsq(chance[:, None] * linear, chance * each, rcond=None)[0]
            result += count * float(np.sum((chance * (each - linear @ fit)) ** 2))
        self.scattered[width, count] = result
        return result


@lru_cache(maxsize=512)
def plain_pulses(sampling: Sampling, tau: tuple[float, ...]) -> PlainPulses:
    """Those of a sampling, whose least squares are done once."""
    return PlainPulses(sampling, tau)


def plain_tail(width: float, rise_s: float, fall_s: float) -> float:
    """Effective on-time beyond the width, of first_order."""
    return float((fall_s - rise_s) * (1.0 - np.exp(-width / rise_s)))


@dataclass(frozen=True)
class PlainFiring:
    """Rows of one firing of a thruster, their times, on-time and pulses."""

    rows: list[int]
    times: list[float]
    seconds: float
    count: float


def plain_firings(samples: Samples, members: Sequence[int]) -> list[PlainFiring]:
    """Rows in a row in which thrusters that fire together gained on-time or began a pulse."""
    found, burst = [], list[int]()
    seconds = count = 0.0
    for i in range(1, len(samples) + 1):
        gained = begun = 0.0
        if i < len(samples):
            gained = max(samples.on_time_s[i, k] - samples.on_time_s[i - 1, k] for k in members)
            begun = max(samples.pulses[i, k] - samples.pulses[i - 1, k] for k in members)
        if gained > 0.0 or begun > 0.0:
            burst.append(i)
            seconds, count = seconds + gained, count + begun
        elif burst:
            times = samples.time_s[burst].tolist()
            found.append(PlainFiring(burst, times, float(seconds), max(float(count), 1.0)))
            burst, seconds, count = [], 0.0, 0.0
    return found


def effective_steps(samples: Samples, sampling: Sampling, tau: tuple[float, ...]) -> Array:
    """Effective on-time gained in the interval that ends at each row."""
    result, pulses = np.zeros(samples.on_time_s.shape), PlainPulses(sampling, tau)
    for k in range(samples.on_time_s.shape[1]):
        for firing in plain_firings(samples, (k,)):
            each = pulses.expected(firing.seconds / firing.count, firing.count)
            for j in firing.rows:
                own = samples.on_time_s[j, k] - samples.on_time_s[j - 1, k]
                begun = samples.pulses[j, k] - samples.pulses[j - 1, k]
                whole = sum(samples.pulses[i, k] - samples.pulses[i - 1, k] for i in firing.rows)
                # on-time where it is counted, the tails of its pulses where they begin
                share = begun / whole if whole > 0 else own / firing.seconds
                result[j, k] = own + share * (firing.count * each - firing.seconds)
    return result


def plain_log_likelihood(model: Model, parameters: Mapping[str, float]) -> float:
    """Log density of all channels of all rows, the unknowns integrated out as one dense normal.

    Every linear unknown (thrust levels and departures, initial momenta, torques, cut tails,
    cosines) becomes covariance between rows and contrasts of turns.
    """
    linear = model.thrust_prior
    means, blocks, shared, constant = [], [], [], 0.0
    values = dict(model.idle) | dict(parameters)
    inertia = inertia_tensor(values)
    weights = wheel_weights(model.spacecraft, values)
    arms = lever_arms(model.spacecraft, model.branch, values)
    open_ = PlainOpen.of(values)
    tau = (values["tau_delay_s"], values["tau_rise_s"], values["tau_fall_s"])
    for term in model.telemetry:
        samples = joined(list(term.event.rows))
        fires = samples.on_time_s.shape[1] > 0
        sampling = term.event.sampling
        rows = plain_rows(samples, sampling, arms if fires else np.zeros((3, 0)), tau)
        n = len(rows.times)
        spin = np.mean([_spin(h) for h in _nominal_momenta(model, rows)], axis=0)
        white = values["rate_noise_rad_s"] ** 2 * inertia @ inertia
        white = white + values["attitude_noise_rad"] ** 2 * spin
        wheels, wheel_noise = np.array(rows.wheels), (values["wheel_noise_rpm"] * RPM) ** 2
        own, columns, mean = _unknowns(model, term, samples, rows, arms, tau, open_)
        drift_square = values["torque_noise_n_m_s05"] ** 2
        y = np.array(rows.rates) @ inertia
        lacking, total = y, np.zeros((3 * n, 3 * n))
        still = 0.3 if plain_sparse(n, samples) else 0.5
        turns = plain_turns(rows, term.event.sampling)
        row_white = white
        walk = plain_walk(samples, rows, term) * values["torque_noise_n_m_s05"]
        bands = plain_bands(np.array(rows.times), samples)
        slow = sum(one.slow for one in bands)
        all_slow = np.sum([one.share for one in bands[:slow]], axis=0)
        of_rows = np.kron(all_slow, np.eye(3)) @ walk
        for band, (share, _, drift, is_slow) in enumerate(bands):
            size = round(np.trace(share))
            white = (
                row_white
                + plain_open(model, term, rows, arms, tau, open_, share, np.array(rows.times))
                / size
            )
            if is_slow or not fires:
                kept, density = np.eye(3), 0.0
            else:
                other = white + drift_square * np.trace(drift) / size * np.eye(3)
                both = np.concatenate([share @ lacking, share @ wheels], axis=1)
                kept, density = plain_estimate(both, size, other, weights, wheel_noise, still)
            added = share @ wheels @ (weights @ kept).T
            own_noise = np.kron(share, white + wheel_noise * weights @ kept @ weights.T)
            own_noise += drift_square * np.kron(drift, np.eye(3))
            y = y + added
            total += own_noise
            if band == slow - 1:
                known = (all_slow @ y, all_slow, total + of_rows @ of_rows.T)
                thrusts = term.balance.thrusts_n if fires else np.zeros(arms.shape[1])
                lacking = _lacking(known, own, columns, mean, thrusts)
                lacking = lacking - np.array(rows.rates) @ inertia
            constant += density
        constant -= 1.5 * n * np.log(2 * np.pi)  # three wheel rates of a row
        constant += plain_measure(model, term, rows, turns, values)
        if fires:
            mean = mean + (linear.common_mean_n * columns.sum(1)).reshape(n, 3)
        unknown = np.concatenate([np.array(own).T, of_rows], axis=1)
        if len(turns.of_rates):
            # of turn less gyro what the rows' own residual makes one expect of the gyro's noise
            by_turn = turns.of_rates @ inertia
            by_gyro = turns.of_rows @ np.array(rows.rates) @ inertia
            residual = by_gyro + turns.of_rows @ np.array(rows.wheels) @ weights.T
            attitude = values["attitude_noise_rad"] ** 2 * inertia @ inertia
            by_wheels = wheel_noise * weights @ weights.T
            noise = np.zeros((len(by_turn), 3, len(by_turn), 3))
            expects = np.zeros_like(noise)
            for share, summed, _, walked in turns.bands:
                gyro = summed * values["rate_noise_rad_s"] ** 2 * inertia @ inertia
                shared_noise = summed * by_wheels + walked * drift_square * np.eye(3)
                on_slopes = share[: len(turns.times), : len(turns.times)]
                open_square = plain_open(
                    model, term, rows, arms, tau, open_, on_slopes, turns.times, turns.ramps
                )
                shared_noise = shared_noise + open_square / np.trace(share)
                of_gyro = gyro @ np.linalg.inv(gyro + shared_noise)
                own_noise = attitude + gyro - of_gyro @ gyro
                noise += np.einsum("ij,ab->iajb", share, own_noise)
                expects += np.einsum("ij,ab->iajb", share, of_gyro)
            expects = expects.reshape(3 * len(by_turn), -1)
            gained = by_turn - by_gyro + (expects @ residual.reshape(-1)).reshape(-1, 3)
            on_turns = expects @ np.kron(turns.of_rows, np.eye(3))
            mean = np.concatenate([mean, (on_turns @ mean.reshape(-1)).reshape(-1, 3)])
            y = np.concatenate([y, gained])
            columns = np.concatenate([columns, on_turns @ columns])
            everywhere = np.concatenate([np.array(own).T, walk], axis=1)
            unknown = np.concatenate([unknown, on_turns @ everywhere])
            total = block_diag(total, noise.reshape(3 * len(gained), -1))
        total = total.astype(np.longdouble)
        if fires:
            total += _square(columns @ linear.departures)
        total += _square(unknown)
        means.append((y - mean).reshape(-1))
        blocks.append(total)
        shared.append(columns @ linear.shared)
    size = sum(map(len, means))
    dense = np.zeros((size, size), dtype=np.longdouble)
    place = 0
    for block in blocks:
        dense[place : place + len(block), place : place + len(block)] = block
        place += len(block)
    dense += _square(np.concatenate(shared))
    lower, residual = np.linalg.cholesky(dense.astype(np.float64)), np.concatenate(means)
    solved, left = np.zeros(size, dtype=np.longdouble), residual
    for _ in range(REFINED):  # a condition of 1e10 takes ten of sixteen digits at a time
        solved = solved + cho_solve((lower, True), left.astype(np.float64))
        left = residual - dense @ solved
    log_density = -0.5 * residual @ solved - np.log(np.diagonal(lower)).sum()
    return float(log_density - 0.5 * size * np.log(2.0 * np.pi)) + constant


def _square(columns: Array) -> NDArray[np.longdouble]:
    """X Xᵀ with eighteen digits: wide priors of unknowns are in it beside the noise."""
    exact = columns.astype(np.longdouble)
    return np.asarray(exact @ exact.T)


def plain_measure(
    model: Model,
    term: TelemetryTerm,
    rows: PlainRows,
    turns: PlainTurns,
    values: Mapping[str, float],
) -> float:
    """Log of what takes densities of the balance to those of the channels, by dense matrices.

    At the prior means it is |det I| per rate, but for a constant, and per contrast of turns. A body
    and wheels that are larger by one factor have a measure that is larger by its power.
    """
    means = nominal_of(model)
    size = np.cbrt(np.linalg.det(inertia_tensor(values)) / np.linalg.det(inertia_tensor(means)))
    shrunk = {n: v / size if "inertia_" in n else v for n, v in values.items()}
    flat, at_means = (_flat_measure(model, term, rows, turns, at) for at in (shrunk, means))
    count = len(rows.times) - 1 + len(turns.of_rates)
    return flat - at_means + count * float(np.linalg.slogdet(inertia_tensor(values))[1])


def _flat_measure(
    model: Model,
    term: TelemetryTerm,
    rows: PlainRows,
    turns: PlainTurns,
    values: Mapping[str, float],
) -> float:
    """In bands whose motion is flat: the noise covariance on the band's rows.

    Noise levels are the priors' medians, what counters leave open is that of the prior means; the
    initial momentum takes up a constant.
    """
    samples = joined(list(term.event.rows))
    fires, n = samples.on_time_s.shape[1] > 0, len(rows.times)
    fixed = dict(values) | reference_noise(term)
    means, one = nominal_of(model), np.eye(3)
    tau = (means["tau_delay_s"], means["tau_rise_s"], means["tau_fall_s"])
    open_, arms = PlainOpen.of(means), lever_arms(model.spacecraft, model.branch, means)
    inertia = inertia_tensor(values)
    weights = wheel_weights(model.spacecraft, values)
    by_wheels = (fixed["wheel_noise_rpm"] * RPM) ** 2 * weights @ weights.T
    drift_square = fixed["torque_noise_n_m_s05"] ** 2
    spin = np.mean([_spin(h) for h in _nominal_momenta(model, rows)], axis=0)
    white = fixed["rate_noise_rad_s"] ** 2 * inertia @ inertia + by_wheels
    white = white + fixed["attitude_noise_rad"] ** 2 * spin
    result, of_constant = 0.0, np.zeros((3, 3))
    for share, drift, _, is_slow in plain_bands(np.array(rows.times), samples):
        size = round(np.trace(share))
        if fires and not is_slow:
            result += size * np.linalg.slogdet(inertia)[1]
            continue
        left_open = plain_open(model, term, rows, arms, tau, open_, share, np.array(rows.times))
        own = white + left_open / size
        values_of, vectors = np.linalg.eigh(share)
        basis = np.kron(vectors[:, values_of > 0.5], one)
        noise = np.kron(share, own) + drift_square * np.kron(drift, one)
        noise = basis.T @ noise @ basis
        result += 0.5 * np.linalg.slogdet(noise)[1]
        if is_slow:
            constant = basis.T @ np.kron(np.ones((n, 1)), one)
            of_constant += constant.T @ np.linalg.solve(noise, constant) / n
    result += 0.5 * np.linalg.slogdet(of_constant)[1]
    attitude = fixed["attitude_noise_rad"] ** 2 * inertia @ inertia
    gyro = fixed["rate_noise_rad_s"] ** 2 * inertia @ inertia
    for share, summed, walked, _ in turns.bands:
        slopes = share[: len(turns.times), : len(turns.times)]
        left = plain_open(model, term, rows, arms, tau, open_, slopes, turns.times, turns.ramps)
        shared = summed * by_wheels + walked * drift_square * one + left / np.trace(share)
        of_gyro = summed * gyro @ np.linalg.inv(summed * gyro + shared)
        noise = attitude + summed * (gyro - of_gyro @ gyro)  # of what turn and gyro differ by
        result += 0.5 * np.trace(share) * np.linalg.slogdet(noise)[1]
    return float(result)


def reference_noise(term: TelemetryTerm) -> dict[str, float]:
    """Prior medians of the noise levels, or their fixed values, when the event was reduced."""
    return dict(term.event.sampling.reference_noise)


def joint_of_slews(model: Model, parameters: Mapping[str, float]) -> tuple[float, float]:
    """Log densities of rates, wheels and turns of slews as one normal.

    The noise of measured wheels and the torque noise are in the balance of rows and, summed up, in
    that of turns. In the second density, a wrong one, both have some of their own.
    """
    (term,) = model.telemetry
    values = dict(model.idle) | dict(parameters)
    samples = joined(list(term.event.rows))
    rows = plain_rows(samples, term.event.sampling, np.zeros((3, 0)), (0.0, 0.0, 0.0))
    turns = plain_turns(rows, term.event.sampling)
    spin = np.mean([_spin(h) for h in _nominal_momenta(model, rows)], axis=0)
    n, contrasts, summed = len(rows.times), len(turns.of_rates), turns.of_rows
    walk = plain_walk(samples, rows, term, MODES)
    walk = np.concatenate([walk, np.kron(summed, np.eye(3)) @ walk])
    walked = walk @ walk.T

    def noise_at(at: Mapping[str, float]) -> Array:
        """Covariance of rows and turns, with the physics and noise levels of some values."""
        inertia = inertia_tensor(at)
        weights = wheel_weights(model.spacecraft, at)
        by_rate = at["rate_noise_rad_s"] ** 2 * inertia @ inertia
        by_attitude = at["attitude_noise_rad"] ** 2 * inertia @ inertia
        by_wheels = (at["wheel_noise_rpm"] * RPM) ** 2 * weights @ weights.T
        of_row = by_rate + by_wheels + at["attitude_noise_rad"] ** 2 * spin
        of_rows, between = np.kron(np.eye(n), of_row), np.kron(summed, by_wheels)
        of_turns = np.kron(summed @ summed.T, by_wheels) + np.kron(np.eye(contrasts), by_attitude)
        noise = np.block([[of_rows, between.T], [between, of_turns]])
        return np.asarray(noise + at["torque_noise_n_m_s05"] ** 2 * walked)

    def apart(noise: Array) -> Array:
        """Without what rows and turns share."""
        own = noise.copy()
        own[: 3 * n, 3 * n :] = own[3 * n :, : 3 * n] = 0.0
        return own

    inertia, means = inertia_tensor(values), nominal_of(model)
    weights = wheel_weights(model.spacecraft, values)
    own, _, mean = _unknowns(model, term, samples, rows, np.zeros((3, 0)), (0.0,) * 3, 0.0)
    unknown = np.array(own).T
    unknown = np.concatenate([unknown, np.kron(summed, np.eye(3)) @ unknown])
    delivered = np.array(rows.wheels) @ weights.T - mean
    residual = np.array(rows.rates) @ inertia + delivered
    turned = turns.of_rates @ inertia + summed @ delivered
    left = np.concatenate([residual, turned]).reshape(-1)
    constant = np.kron(np.ones((n, 1)) / np.sqrt(n), np.eye(3))
    channels = 2 * n + contrasts  # three wheels and three rates of a row
    # the measure in which the motion is flat, but for its unit, is that of the noise levels
    # when the event was reduced
    noises = (
        noise_at(values),
        *(noise_at(dict(at) | reference_noise(term)) for at in (values, means)),
    )
    found = []
    for noise, *measures in (noises, tuple(map(apart, noises))):
        lower = np.linalg.cholesky(noise + unknown @ unknown.T)
        white = solve_triangular(lower, left, lower=True)
        log_density = -0.5 * white @ white - np.log(np.diagonal(lower)).sum()
        logs = []
        for each in measures:
            of_constant = constant.T @ np.linalg.solve(each[: 3 * n, : 3 * n], constant)
            logs.append(np.linalg.slogdet(each)[1] + np.linalg.slogdet(of_constant)[1])
        measure = 0.5 * (logs[0] - logs[1])
        measure += (n - 1 + contrasts) * np.linalg.slogdet(inertia_tensor(means))[1]
        found.append(float(log_density + measure - 1.5 * channels * np.log(2.0 * np.pi)))
    return found[0], found[1]


def _unknowns(
    model: Model,
    term: TelemetryTerm,
    samples: Samples,
    rows: PlainRows,
    arms: Array,
    tau: tuple[float, ...],
    open_: PlainOpen,
) -> tuple[list[Array], Array, Array]:
    """Columns of unit-variance unknowns and of thrusts (3 n, K); mean (n, 3) of the former."""
    n, thrusters = len(rows.times), arms.shape[1]
    start = np.array(rows.bodies) @ _first_body(samples).T
    own = [term.balance.initial_sd_n_m_s * start[:, :, axis].reshape(-1) for axis in range(3)]
    own += [
        sd * np.array(rows.torques)[:, :, axis].reshape(-1)
        for axis, sd in enumerate(model.torque_sd_n_m)
    ]
    mean = start @ term.balance.initial_mean_n_m_s + np.array(rows.torques) @ model.torque_mean_n_m
    columns = np.zeros((3 * n, thrusters))
    if samples.on_time_s.shape[1] == 0:
        return own, columns, mean
    lost, scattered = plain_lost(term, tau, open_)
    counts = np.array(rows.cuts)  # (n, G)
    couples = term.event.sampling.couples
    for k in range(thrusters):
        couple = next(g for g, c in enumerate(couples) if k in c)
        cut = lost * counts[:, couple][:, None] * arms[:, k]
        columns[:, k] = (np.array(rows.impulses)[:, :, k] - cut).reshape(-1)
    for g, members in enumerate(couples):
        step = arms[:, list(members)] @ plain_thrusts(term, tau)[list(members)]
        if counts[-1, g] > 0.0:
            own.append((0.5 * lost * counts[:, g][:, None] * step).reshape(-1))
        sampling = term.event.sampling
        for part in range(PARTS):
            steps = rows.steps_of(g, part, sampling)
            if steps:
                whole = sum(one.size for one in steps)
                cut = sum(one.size * (np.array(rows.times) >= one.time) for one in steps) / whole
                each = (scattered**2, plain_pulses(sampling, tau), open_.of_columns(term))
                scatter = np.sqrt(sum(one.variance(*each) for one in steps))
                own.append((scatter * cut[:, None] * step).reshape(-1))
    for g, members in enumerate(couples):
        step = arms[:, list(members)] @ plain_thrusts(term, tau)[list(members)]
        sampling, times = term.event.sampling, np.array(rows.times)
        if all(own != g for _, own in rows.shots):
            continue
        expected = sampling.pulse_reference_s
        levels, long = plain_levels(term, rows, g, expected, times)
        gained = [
            np.mean(list(rows.slopes_of(g, plain_pulses(sampling, at)).values()))
            for at in (tau, expected)
        ]
        levels = np.sqrt(open_.of_columns(term)) * gained[0] / gained[1] * levels[:, long]
        own += [(column[:, None] * step).reshape(-1) for column in levels.T]
    return own, columns, mean


def plain_thrusts(term: TelemetryTerm, tau: tuple[float, ...]) -> Array:
    """The event's thrusts, told at the reference, where pulses deliver more, or less."""
    sampling = term.event.sampling
    delivered = [
        np.mean([width + plain_tail(width, *at[1:]) for width in sampling.paired_s])
        for at in (sampling.pulse_reference_s, tau)
    ]
    return np.asarray(term.balance.thrusts_n * delivered[0] / delivered[1])


def plain_lost(
    term: TelemetryTerm, tau: tuple[float, ...], open_: PlainOpen
) -> tuple[float, float]:
    """On-time that a pair loses on average, and one standard deviation of it, s."""
    gaps, sampling = term.event.statistics.counters.gaps_s, term.event.sampling
    mean, square = plain_losses(gaps, sampling.control_cycle_s, tau, open_.close)
    reached = plain_reached(sampling.paired_s, tau)
    return reached**2 * mean, float(reached**2 * np.sqrt(open_.of_pairs * square))


def plain_open(
    model: Model,
    term: TelemetryTerm,
    rows: PlainRows,
    arms: Array,
    tau: tuple[float, ...],
    open_: PlainOpen,
    share: Array,
    times: Array,
    ramps: Array | float = 1.0,
) -> Array:
    """Covariance of what is open, summed over rows at ``times`` that ``share`` (n, n) projects on.

    Whatever is constant enters row i by ``ramps[i]``.
    """
    total = np.zeros((3, 3))
    if not rows.shots:
        return total
    sampling = term.event.sampling
    _, scattered = plain_lost(term, tau, open_)
    for g, members in enumerate(sampling.couples):
        arm = arms[:, list(members)] @ plain_thrusts(term, tau)[list(members)]
        square = 0.0
        each = (scattered**2, plain_pulses(sampling, tau), open_.of_columns(term))
        for part in range(PARTS):
            steps = rows.steps_of(g, part, sampling)
            whole = sum(one.size for one in steps)
            mean = sum(one.size * ramps * (times >= one.time) for one in steps)
            for one in steps:
                apart = ramps * (times >= one.time) - mean / whole
                square += one.variance(*each) * apart @ share @ apart
        levels, long = plain_levels(term, rows, g, tau, times, ramps)
        levels = np.sqrt(open_.of_columns(term)) * levels[:, ~long]
        square += np.trace(levels.T @ share @ levels)
        total += square * np.outer(arm, arm)
    return total


def plain_levels(
    term: TelemetryTerm,
    rows: PlainRows,
    couple: int,
    tau: tuple[float, ...],
    times: Array,
    ramps: Array | float = 1.0,
) -> tuple[Array, NDArray[np.bool_]]:
    """Independent roundings of a couple in rows at times (n, l), and which of them are unknowns."""
    counters = term.event.statistics.counters
    slopes = rows.slopes_of(couple, plain_pulses(term.event.sampling, tau))
    shots = [t for t, own in rows.shots if own == couple]
    ends = [ramps * np.ones(len(times))]
    ends += [slopes[t] * ramps * (times >= t) for t in shots]
    levels = np.column_stack([a - b for a, b in pairwise([*ends, 0.0 * times])])
    apart = np.diff(np.eye(levels.shape[1]), axis=0)
    last = levels.shape[1] - 1
    seen = np.zeros(last + 1)
    spaces = max(int(last / counters.open_every[couple]), 1)
    seen[[round(last * i / spaces) for i in range(spaces + 1)]] = 1.0
    ratio = np.maximum(counters.open_ratio[counters.fired[:, couple], couple], LEAST_RATIO)
    precision = np.diag(seen) + apart.T @ (apart / ratio[:, None])
    upper = np.linalg.cholesky(precision).T
    begins = counters.level_begin_s[counters.level_couple == couple]
    long = [any(t == begin or abs(t - begin) < 1e-6 for begin in begins) for t in (-np.inf, *shots)]
    patterns = np.sqrt(counters.open_s2[couple]) * levels @ np.linalg.inv(upper)
    return patterns, np.array(long, dtype=bool)


@dataclass(frozen=True)
class PlainTurns:
    """Contrasts of quiet pieces: of the turns since a piece began, and as integrals of rows.

    First the slopes of P pieces at ``times``, by ``ramps`` of what is constant in them, then all
    others. ``bands`` are projectors (N, N) and squares of wheel noise, of a random walk and of what
    is faster in it than its slowest cosines.
    """

    of_rates: Array  # (N, 3)
    of_rows: Array  # (N, n)
    times: Array
    ramps: Array
    bands: list[tuple[Array, float, float, float]]


def plain_turns(rows: PlainRows, sampling: Sampling) -> PlainTurns:
    """Pieces found by a loop over rows, their slopes and an orthonormal basis of all else."""
    n, times = len(rows.times), rows.times
    wheels = np.array(rows.wheels)
    pieces, piece = [], [0]
    for i in range(n - 1):
        beside = [times[j + 1] - times[j] for j in (i - 1, i + 1) if 0 <= j < n - 1]
        ends = bool(beside) and times[i + 1] - times[i] > 2.5 * min(beside)
        ends = ends or times[i + 1] - times[piece[0]] > 32.0 + 1e-6
        ends = ends or any(np.array(rows.fired[i]) != np.array(rows.fired[i + 1]))
        for at in (i, i + 1):
            if 0 < at < n - 1:
                before, after = times[at] - times[at - 1], times[at + 1] - times[at]
                slopes = (
                    (wheels[at] - wheels[at - 1]) / before,
                    (wheels[at + 1] - wheels[at]) / after,
                )
                bend = np.abs(slopes[1] - slopes[0]) * after
                ends = ends or any(
                    (bend > sampling.corner_rad_s) & (bend * after > sampling.corner_rad)
                )
        if ends:
            pieces.append(piece)
            piece = []
        piece.append(i + 1)
    slope_rates, slope_rows, waves, other_rates, other_rows = [], [], [], [], []
    slope_times, ramps, slope_sums, other_waves, sums, faster_still = [], [], [], [], [], []
    duration = sampling.duration_s
    pieces.append(piece)
    for piece in [own for own in pieces if len(own) >= 2]:
        m, step = len(piece), np.diff(np.array(times)[piece])
        integral, turn = np.zeros((m, m)), np.zeros((m, 3))
        walk = np.zeros((m, m))
        for i in range(1, m):
            integral[i] = integral[i - 1]
            integral[i, [i - 1, i]] += 0.5 * step[i - 1]
            walk[i] = walk[i - 1]
            walk[i, i] = np.sqrt(step[i - 1])
            relative = rows.bodies[piece[i]] @ rows.bodies[piece[i - 1]].T
            # the body turns by φ: its axes' matrix by the inverse rotation
            turn[i] = turn[i - 1] + Rotation.from_matrix(relative.T).as_rotvec()
        ramp = np.array(times)[piece] - np.mean(np.array(times)[piece])
        slope = ramp / np.sqrt(np.sum(ramp**2))
        # orthonormal to a constant and to the ramp: cosines by half period, then whichever basis
        long_s = times[piece[-1]] - times[piece[0]]
        known, half_periods = [np.ones(m) / np.sqrt(m), slope], []
        for order in range(2, m):
            if long_s / order < 2.0 - 1e-6:
                break
            wave = np.cos(order * np.pi * (np.array(times)[piece] - times[piece[0]]) / long_s)
            for _ in range(2):
                wave = wave - np.array(known).T @ (np.array(known) @ wave)
            known.append(wave / np.sqrt(np.sum(wave**2)))
            half_periods.append(long_s / order)
        contrast = np.concatenate([np.array(known[2:]).reshape(-1, m), null_space(known).T])
        half_periods += [0.0] * (m - len(known))
        on_all = np.zeros((m, n))
        on_all[:, piece] = integral
        slope_rates.append(slope @ turn)
        slope_rows.append(slope @ on_all)
        other_rates.append(contrast @ turn)
        other_rows.append(contrast @ on_all)
        slope_times.append(np.mean(np.array(times)[piece]))
        ramps.append(np.sqrt(np.sum(ramp**2)))
        waves.append(
            [
                slope @ integral @ np.cos(order * np.pi * np.array(times)[piece] / duration)
                for order in range(129)
            ]
        )
        own = np.array(times)[piece]
        about_mean = duration / 3.0 - np.maximum.outer(own, own)
        about_mean += np.add.outer(own**2, own**2) / (2.0 * duration)
        known = np.array(waves[-1][1:]) * np.sqrt(2 * duration) / (np.arange(1, 129) * np.pi)
        faster_still.append(slope @ integral @ about_mean @ integral.T @ slope - known @ known)
        order = np.arange(1, 1 + plain_cosines(duration))
        slowest = np.cos(np.outer(np.array(times)[piece], order) * np.pi / duration)
        other_waves += list(contrast @ integral @ slowest)
        slope_sums.append(np.sum((slope @ integral) ** 2))
        squares = (np.sum((contrast @ integral @ x) ** 2, axis=1) for x in (np.eye(m), walk))
        sums += list(np.stack([*squares, half_periods], axis=1))
    if not slope_rates:
        return PlainTurns(np.zeros((0, 3)), np.zeros((0, n)), np.zeros(0), np.zeros(0), [])
    of_rates = np.concatenate([np.array(slope_rates), *other_rates])
    count, total = len(slope_rates), len(of_rates)
    order = np.arange(1, 129)
    scale = np.r_[np.sqrt(duration / 3.0), np.sqrt(2 * duration) / (order * np.pi)]
    modes, size, _ = np.linalg.svd(np.array(waves) * scale, full_matrices=False)
    faster = plain_faster(modes, size, np.array(waves) * scale, duration)
    bands, edges = [], {*SLOPE_EDGES, 1 + plain_cosines(duration)}
    beyond = modes.T**2 @ np.array(faster_still)
    for start, stop in pairwise([0, *sorted(edge for edge in edges if edge < count), count]):
        share = np.zeros((total, total))
        share[:count, :count] = modes[:, start:stop] @ modes[:, start:stop].T
        summed = np.diagonal(share)[:count] @ np.array(slope_sums) / (stop - start)
        walked = (float(np.mean((each + beyond)[start:stop])) for each in (size**2, faster))
        bands.append((share, float(summed), *walked))
    if total > count:
        known = scale[1 : 1 + plain_cosines(duration)] * np.array(other_waves)
        summed, walked, half_periods = np.array(sums).T
        each = np.stack([summed, walked, walked - np.sum(known**2, axis=1)], axis=1)
        for low, high in ((8.0, np.inf), (4.0, 8.0), (2.0, 4.0), (-1.0, 2.0)):
            chosen = (half_periods >= low - 1e-6) & (half_periods < high - 1e-6)
            if chosen.any():
                share = np.diag(np.r_[np.zeros(count), chosen])
                bands.append((share, *(float(x) for x in each[chosen].mean(axis=0))))
    return PlainTurns(
        of_rates,
        np.concatenate([np.array(slope_rows), *other_rows]),
        np.array(slope_times),
        np.array(ramps),
        bands,
    )


def _lacking(
    slow: tuple[Array, Array, Array], own: list[Array], columns: Array, mean: Array, thrusts: Array
) -> Array:
    """What thrusters, torque and start deliver (n, 3), the unknowns placed by the slow band."""
    y, share, noise = slow
    n = len(y)
    design = np.concatenate([0.3 * thrusts.mean() * columns, np.array(own).T], axis=1)
    before = mean.reshape(-1) + columns @ thrusts
    seen = np.kron(share, np.eye(3))
    inverse = np.linalg.pinv(noise, rcond=1e-13, hermitian=True)
    projected = seen @ design
    gain = projected.T @ inverse
    at = np.linalg.solve(
        gain @ projected + np.eye(design.shape[1]), gain @ (y.reshape(-1) - seen @ before)
    )
    return np.asarray((before + design @ at).reshape(n, 3))


def plain_cosines(duration_s: float) -> int:
    """Cosines of torque noise that are unknowns: one for every five minutes, 6 to 16."""
    return min(max(6, int(np.ceil(duration_s / 300.0))), 16)


def plain_walk(
    samples: Samples, rows: PlainRows, term: TelemetryTerm, cosines: int | None = None
) -> Array:
    """What the slowest cosines of a unit random walk gained (3 n, 3 cosines), per normal.

    In inertial axes, and seen in those of the body.
    """
    duration = term.event.sampling.duration_s
    start = _first_body(samples)
    own = []
    for order in range(1, 1 + (cosines or plain_cosines(duration))):
        scale = np.sqrt(2 * duration) / (order * np.pi)
        gained = scale * (np.cos(order * np.pi * np.array(rows.times) / duration) - 1.0)
        own.append((gained[:, None, None] * np.array(rows.bodies) @ start.T).reshape(-1, 3))
    return np.concatenate(own, axis=1)


def plain_faster(modes: Array, size: Array, waves: Array, duration_s: float) -> Array:
    """Variances of a unit random walk's modes (n, M) without its mean and slowest cosines.

    ``waves`` (n, 1 + cosines) have their standard deviations in them.
    """
    slowest = modes.T @ waves[:, : 1 + plain_cosines(duration_s)]
    return np.asarray(size**2 - np.sum(slowest**2, axis=1))


class PlainBand(NamedTuple):
    """Of a band of rows the projector, and covariances of a unit random walk, (n, n) each.

    First that of all of it, then, in slow bands, of what is faster than its slowest cosines.
    """

    share: Array
    walk: Array
    faster: Array
    slow: bool


def plain_bands(times: Array, samples: Samples) -> list[PlainBand]:
    """The bands of rows, slow ones first."""
    duration = float(samples.time_s[-1])
    waves = [np.ones(len(times)) * np.sqrt(duration / 3.0)]
    waves += [
        np.cos(m * np.pi * times / duration) * np.sqrt(2 * duration) / (m * np.pi)
        for m in range(1, MODES + 1)
    ]
    modes, size, _ = np.linalg.svd(np.array(waves).T, full_matrices=False)
    faster = plain_faster(modes, size, np.array(waves).T, duration)
    n = len(times)
    count, inner = n // ROWS_PER_MODE, list(EDGES)
    if plain_sparse(n, samples):
        count, inner = n, [*(edge for edge in EDGES if edge < n // 2), n // 2, 3 * n // 4]
    edges = [0, *(edge for edge in inner if edge < count), count]
    edges = sorted({*edges, *(edge for edge in SLOW_EDGES if edge < edges[1])})
    bands = []
    for start, stop in pairwise(edges):
        own, variance = modes[:, start:stop], size[start:stop] ** 2
        left = faster[start:stop]
        if start >= min(inner[0], count):
            left = variance = np.full_like(variance, variance.mean())
        covariances = (own @ own.T, own * variance @ own.T, own * left @ own.T)
        bands.append(PlainBand(*covariances, start < inner[0]))
    if count == n:
        return bands
    rest = np.eye(n) - modes[:, :count] @ modes[:, :count].T
    beyond = duration / (2 * np.pi * np.tan(np.pi * (count - 0.5) / (2 * n)) * (n - count))
    return [*bands, PlainBand(rest, beyond * rest, beyond * rest, False)]


def plain_sparse(rows: int, samples: Samples) -> bool:
    """Whether a bias has a usable row in four seconds at most."""
    return samples.on_time_s.shape[1] > 0 and float(samples.time_s[-1]) > SPARSE_S * rows


def plain_estimate(
    both: Array, rows: int, other: Array, weights: Array, noise: float, no_motion: float
) -> tuple[Array, float]:
    """Matrix from measured to estimated wheel rates in a fast band, and the band's own density.

    ``both`` (n, 6): the momentum that all but the wheels lacks, and the measured wheel rates.
    """
    lacks, wheels = both[:, :3], both[:, 3:]
    inverse = np.linalg.inv(other)
    precision = np.eye(3) / noise + weights.T @ inverse @ weights
    root = np.real(sqrtm(precision))
    best = (wheels / noise + lacks @ inverse @ weights) @ np.linalg.inv(precision)
    squares, axes = np.linalg.eigh(root @ best.T @ best @ root)
    spreads, density = [], 0.0
    for square in squares:
        log_s = np.linspace(-9.0, 34.0, 400_001)
        log_p = -0.5 * rows * np.log1p(np.exp(log_s)) - 0.5 * square / (1.0 + np.exp(log_s))
        top = max(log_p.max(), -0.5 * square)
        p = (1.0 - no_motion) * np.exp(log_p - top) / 43.0
        still = no_motion * np.exp(-0.5 * square - top)
        total = trapezoid(p, log_s) + still
        spreads.append((trapezoid(p / (1.0 + np.exp(log_s)), log_s) + still) / total)
        density += top + np.log(total) + 0.5 * square * spreads[-1]
    turned = np.linalg.inv(root) @ axes
    motion = turned * (1.0 / np.array(spreads) - 1.0) @ turned.T
    both_ways = np.linalg.inv(motion + noise * np.eye(3))
    kept = motion @ both_ways
    balance = other + noise * weights @ weights.T
    left = other + noise * weights @ kept @ weights.T
    dets = [np.linalg.slogdet(matrix)[1] for matrix in (left, precision, balance)]
    density += 0.5 * rows * (dets[0] + dets[1] - dets[2])
    return kept, density - 0.5 * float(np.trace(both_ways @ wheels.T @ wheels))


def _first_body(samples: Samples) -> Array:
    return rotation(samples.attitude[0])


def _spin(momentum: Array) -> Array:
    return np.eye(3) * (momentum @ momentum) - np.outer(momentum, momentum)


def nominal_of(model: Model) -> dict[str, float]:
    """Prior means of all parameters, or their fixed values."""
    means = {
        name: float(distribution.mean())
        for name, distribution in zip(model.space.names, model.space.distributions, strict=True)
    }
    return dict(model.idle) | dict(model.space.fixed) | means


def _nominal_momenta(model: Model, rows: PlainRows) -> list[Array]:
    values = nominal_of(model)
    inertia = inertia_tensor(values)
    weights = wheel_weights(model.spacecraft, values)
    return [inertia @ w + weights @ r for w, r in zip(rows.rates, rows.wheels, strict=True)]
