"""Three ways to hold an attitude with thrusters, unlike each other.

Every control cycle each is told the attitude error and the body rate, as three angles and three
rates that it should bring to 0, and answers with firings that start in this cycle. The pairs: Z3,
Z4 turn the spacecraft about +X, Z1, Z2 about −X, Z1, Z4 about +Y, Z2, Z3 about −Y, Y2, Y4 about +Z,
Y1, Y3 about −Z.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from closed_loop.valve import Firing

CYCLE_MS = 125
PAIRS = {
    (0, 1): (2, 3),
    (0, -1): (0, 1),
    (1, 1): (0, 3),
    (1, -1): (1, 2),
    (2, 1): (5, 7),
    (2, -1): (4, 6),
}
"""Thrusters, by index, that turn about an axis in a sense."""
_WIDE_BAND_RAD = 2e-3
"""From here on twice the least impulse does not carry an axis through its dead-band in seconds."""
Three = tuple[float, float, float]


def _sign(value: float) -> int:
    return 1 if value > 0.0 else -1


# ---- lines in the phase plane, whole pulses ------------------------------------------------------


@dataclass(frozen=True)
class PhasePlaneLaw:
    """Switching lines in the plane of angle and rate, pulses of one fixed width.

    An axis begins to fire where e + k ω passes the dead-band, or where |ω| passes a limit whatever
    the angle; it goes on until the rate points back with the coasting rate. Between two firings of
    an axis lies a least time off, and a firing is a whole number of least impulse bits.
    """

    dead_band_rad: Three
    slope_s: float
    rate_limit_rad_s: float
    coast_rad_s: float
    least_off_ms: int
    bits: int

    def start(self) -> PhasePlane:
        """A controller of this law."""
        return PhasePlane(self)


@dataclass
class PhasePlane:
    """An event under :class:`PhasePlaneLaw`."""

    law: PhasePlaneLaw
    _sense: list[int] = field(default_factory=lambda: [0, 0, 0])
    _until: list[int] = field(default_factory=lambda: [-(10**9)] * 3)

    def fire(self, error: Sequence[float], rate: Sequence[float], now_ms: int) -> list[Firing]:
        wanted: set[int] = set()
        for axis in range(3):
            if now_ms < self._until[axis]:
                continue
            sense = self._next(axis, error[axis], rate[axis], now_ms)
            if sense and not self._sense[axis]:
                self._until[axis] = now_ms + self.law.bits * CYCLE_MS
            elif sense:
                self._until[axis] = now_ms + CYCLE_MS
            self._sense[axis] = sense
        for axis in range(3):
            if now_ms < self._until[axis] and self._sense[axis]:
                wanted |= set(PAIRS[axis, self._sense[axis]])
        return [Firing(k, now_ms, CYCLE_MS) for k in sorted(wanted)]

    def _next(self, axis: int, error: float, rate: float, now_ms: int) -> int:
        """Sense to fire in during this cycle, 0 for none."""
        law, going = self.law, self._sense[axis]
        if going:
            # until the rate points back, or the angle is back inside at a rate that is small
            return going if going * rate < law.coast_rad_s and going * error < 0.0 else 0
        if now_ms < self._until[axis] + law.least_off_ms:
            return 0
        switch = error + law.slope_s * rate
        if abs(rate) > law.rate_limit_rad_s:
            return -_sign(rate)
        side = _sign(switch)
        if abs(switch) > law.dead_band_rad[axis] and side * rate > -law.coast_rad_s:
            return -side
        return 0


# ---- pulse width and frequency -------------------------------------------------------------------


@dataclass(frozen=True)
class PulseFrequencyLaw:
    """A Schmitt trigger behind a first-order filter, its own firing fed back (PWPF).

    v̇ = (g (u − m y) − v)/τ with u = (e + k ω)/dead-band and y the sense of firing: it fires from
    |v| = g down to (1 − h) g. Pulses begin at any millisecond, last 20 to 125 ms, and merge where
    one follows the other at once; a least time off between an axis's pulses may forbid that. Where
    two axes ask a thruster at the same time, it serves the second after the first, but no longer
    than the second's longest pulse would have lasted.
    """

    dead_band_rad: Three
    slope_s: float
    gain: float
    feedback: float
    hysteresis: float
    time_constant_s: Three
    """Of each axis: at the edge of its dead-band pulses last τ ln(m/(m − h))."""
    least_off_ms: int
    shortest_ms: int = 20
    longest_ms: int = 125

    def start(self) -> PulseFrequency:
        """A controller of this law."""
        return PulseFrequency(self)


@dataclass
class PulseFrequency:
    """An event under :class:`PulseFrequencyLaw`."""

    law: PulseFrequencyLaw
    _filter: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    _known_ms: list[int] = field(default_factory=lambda: [0, 0, 0])
    _ready_ms: list[int] = field(default_factory=lambda: [0, 0, 0])
    _busy_ms: list[int] = field(default_factory=lambda: [0] * 8)

    def fire(self, error: Sequence[float], rate: Sequence[float], now_ms: int) -> list[Firing]:
        law = self.law
        firings = []
        for axis in range(3):
            u = (error[axis] + law.slope_s * rate[axis]) / law.dead_band_rad[axis]
            for start, width, sense in self._pulses(axis, u, now_ms):
                for k in PAIRS[axis, sense]:
                    begin = max(start, self._busy_ms[k])
                    end = min(begin + width, start + law.longest_ms)
                    if end - begin >= law.shortest_ms:
                        self._busy_ms[k] = end
                        firings.append(Firing(k, begin, end - begin))
        return firings

    def _pulses(self, axis: int, u: float, now_ms: int) -> Iterable[tuple[int, int, int]]:
        """Start, width and sense of this axis's pulses that start before the next cycle."""
        law, end, constant = self.law, now_ms + CYCLE_MS, self.law.time_constant_s[axis]
        # the first cycle is where this controller is switched on: nothing can begin before it
        self._known_ms[axis] = max(self._known_ms[axis], now_ms)
        while self._known_ms[axis] < end:
            at, v = self._known_ms[axis], self._filter[axis]
            aim = law.gain * u
            wait = 0 if abs(v) >= law.gain else _crossing_ms(v, aim, law.gain, constant)
            if wait is not None:
                wait = max(wait, self._ready_ms[axis] - at)
            if wait is None or at + wait >= end:
                self._filter[axis] = _relaxed(v, aim, end - at, constant)
                self._known_ms[axis] = end
                return
            v = _relaxed(v, aim, wait, constant)
            side = _sign(v)
            on_aim = law.gain * (u - side * law.feedback)
            release = (1.0 - law.hysteresis) * law.gain
            down = _falling_ms(side * v, side * on_aim, release, constant)
            width = min(max(down, law.shortest_ms), law.longest_ms)
            self._filter[axis] = _relaxed(v, on_aim, width, constant)
            self._known_ms[axis] = at + wait + width
            self._ready_ms[axis] = at + wait + width + law.least_off_ms
            yield at + wait, width, -side


def _relaxed(v: float, aim: float, span_ms: int, constant_s: float) -> float:
    """The filter's output after a span under a constant input."""
    return aim + (v - aim) * math.exp(-1e-3 * span_ms / constant_s)


def _crossing_ms(v: float, aim: float, level: float, constant_s: float) -> int | None:
    """Whole ms until |v| reaches a level from inside; None where it never does."""
    if abs(aim) <= level:
        return None
    target = math.copysign(level, aim)
    return math.ceil(1e3 * constant_s * math.log((v - aim) / (target - aim)))


def _falling_ms(v: float, aim: float, level: float, constant_s: float) -> int:
    """Whole ms until v falls to a level; a long time where it never does."""
    if v <= level:
        return 0
    if aim >= level:
        return 10**6
    return math.ceil(1e3 * constant_s * math.log((v - aim) / (level - aim)))


# ---- widths in proportion, once a second ---------------------------------------------------------


@dataclass(frozen=True)
class PulseWidthLaw:
    """A dead zone, then widths in proportion to the demand, once a second, up to the whole second.

    Outside the dead zone e + k ω asks for a change of rate of −(excess)/k × ``gain``, as a momentum
    for each axis; Z thrusters share those about X and Y so that none pushes back: widths differ
    from thruster to thruster. What is shorter than the shortest pulse is not fired.
    """

    dead_band_rad: Three
    slope_s: float
    gain: float
    shortest_ms: int
    step_ms: int
    inertia_kg_m2: Three
    torque_n_m: Three
    """That one thruster of a pair gives about X, Y and Z."""
    period_ms: int = 1000

    def start(self) -> PulseWidth:
        """A controller of this law."""
        return PulseWidth(self)


@dataclass
class PulseWidth:
    """An event under :class:`PulseWidthLaw`."""

    law: PulseWidthLaw

    def fire(self, error: Sequence[float], rate: Sequence[float], now_ms: int) -> list[Firing]:
        law = self.law
        if now_ms % law.period_ms:
            return []
        seconds = []  # for which one thruster would have to fire, with its sense
        for axis in range(3):
            u = error[axis] + law.slope_s * rate[axis]
            excess = max(abs(u) - law.dead_band_rad[axis], 0.0)
            impulse = law.gain * excess / law.slope_s * law.inertia_kg_m2[axis]
            one = impulse / (2.0 * law.torque_n_m[axis])
            seconds.append(-_sign(u) * one if 1e3 * one >= law.shortest_ms else 0.0)
        x, y, z = (0.5 * seconds[0], 0.5 * seconds[1], seconds[2])
        demand = np.array([-x + y, -x - y, x - y, x + y])
        widths = [*(demand - demand.min()), max(-z, 0.0), max(z, 0.0), max(-z, 0.0), max(z, 0.0)]
        firings = []
        for k, width_s in enumerate(widths):
            width = law.step_ms * round(1e3 * width_s / law.step_ms)
            if width >= law.shortest_ms:
                firings.append(Firing(k, now_ms, min(width, law.period_ms)))
        return firings


Law = PhasePlaneLaw | PulseFrequencyLaw | PulseWidthLaw
NAMES = {
    "phase_plane": PhasePlaneLaw,
    "pulse_frequency": PulseFrequencyLaw,
    "pulse_width": PulseWidthLaw,
}


def described(law: Law) -> dict[str, Any]:
    """Name and settings of a law, for the record."""
    name = next(key for key, kind in NAMES.items() if isinstance(law, kind))
    return {"name": name, **asdict(law)}


def draw_law(
    name: str, inertia_kg_m2: Three, counter_step_s: float, rng: np.random.Generator
) -> Law:
    """A law with settings of its own; inertia is what the controller believes."""
    band = 10.0 ** rng.uniform(-3.0, -2.2)
    x, y, z = (float(band * factor) for factor in rng.uniform(0.7, 1.3, 3))
    bands = (x, y, z)
    slope = float(rng.uniform(8.0, 25.0))
    if name == "phase_plane":
        return PhasePlaneLaw(
            dead_band_rad=bands,
            slope_s=slope,
            rate_limit_rad_s=float(rng.uniform(3e-4, 6e-4)),
            coast_rad_s=float(rng.uniform(0.5e-5, 4e-5)),
            least_off_ms=CYCLE_MS * int(rng.choice([1, 2, 4, 8, 16])),
            bits=int(rng.choice([1, 2])) if band > _WIDE_BAND_RAD else 1,
        )
    if name == "pulse_frequency":
        hysteresis = float(rng.uniform(0.15, 0.6))
        # a feedback hardly above the hysteresis makes widths follow the demand
        feedback = hysteresis + float(rng.uniform(0.05, 0.4))
        x, y, z = rng.uniform(0.022, 0.1, 3) / math.log(feedback / (feedback - hysteresis))
        return PulseFrequencyLaw(
            dead_band_rad=bands,
            slope_s=slope,
            gain=float(rng.uniform(1.0, 4.0)),
            feedback=feedback,
            hysteresis=hysteresis,
            time_constant_s=(float(x), float(y), float(z)),
            least_off_ms=int(rng.choice([0, 50, 125, 250, 500])),
        )
    if name == "pulse_width":
        whole_cycles = counter_step_s == 1e-3 * CYCLE_MS
        return PulseWidthLaw(
            dead_band_rad=bands,
            slope_s=slope,
            gain=float(rng.uniform(0.4, 1.0)),
            shortest_ms=CYCLE_MS if whole_cycles else int(rng.integers(30, 151)),
            step_ms=CYCLE_MS if whole_cycles else 1,
            inertia_kg_m2=inertia_kg_m2,
            torque_n_m=(1.2, 0.93, 0.93),
        )
    raise ValueError(f"no controller is called {name!r}; there are {', '.join(NAMES)}")
