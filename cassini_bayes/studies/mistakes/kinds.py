"""Kinds of mistakes that a user's telemetry or totals may hold, each as a change of honest data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.telemetry import Chunk
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

Change = Callable[[Chunk], Chunk]
ALL: Final = ("bias", "slew")
BIAS: Final = ("bias",)
DEGREES: Final = 180.0 / np.pi


@dataclass(frozen=True)
class Mistaken:
    """A mistake: what it does, names under which it counts as found, kinds of event it is for.

    ``rate_spread`` and ``wheel_spread`` are logarithms of the volume that a row's noise gains by
    it: of channels that are multiplied. They belong to the density of the recorded data if the
    mistake is known.
    """

    change: Change
    names: tuple[str, ...]
    kinds: tuple[str, ...] = ALL
    rate_spread: float = 0.0
    wheel_spread: float = 0.0

    def spread(self, kind: str) -> float:
        """Of a row of an event: slews say nothing of the density of wheel rates.

        Their true rates are latent and flat (``docs/topics/telemetry-likelihood.md`` §3).
        """
        return self.rate_spread + (0.0 if kind == "slew" else self.wheel_spread)


def by(function: Callable[[Array], Array], *channels: str) -> Change:
    """Channels as a function of each."""

    def change(chunk: Chunk) -> Chunk:
        changed: dict[str, Any] = {name: function(getattr(chunk, name)) for name in channels}
        return replace(chunk, **changed)

    return change


def times(channel: str, factor: float | Sequence[float]) -> Change:
    """A channel, or each of its columns, times a factor."""
    return by(lambda values: values * np.asarray(factor), channel)


def plus(channel: str, offset: Sequence[float]) -> Change:
    """A channel's columns with constant errors."""
    return by(lambda values: values + np.asarray(offset), channel)


def ordered(channel: str, order: Sequence[int]) -> Change:
    """Columns of a channel in another order."""
    return by(lambda values: values[:, list(order)], channel)


def swapped(*pairs: tuple[int, int]) -> Callable[[Array], Array]:
    """Values (…, K) with those of some pairs exchanged."""

    def change(values: Array) -> Array:
        order = list(range(values.shape[-1]))
        for a, b in pairs:
            order[a], order[b] = order[b], order[a]
        return values[..., order]

    return change


def exchanged(*pairs: tuple[int, int]) -> Mistaken:
    """Counters of pairs of thrusters exchanged."""
    return Mistaken(by(swapped(*pairs), *COUNTERS), THRUSTERS, BIAS)


def log_volume(factor: float | Sequence[float]) -> float:
    """What three columns gain in volume by a factor of all, or one of each."""
    return float(np.log(np.abs(np.broadcast_to(factor, 3))).sum())


def wheels_times(factor: float | Sequence[float], names: tuple[str, ...]) -> Mistaken:
    """Wheel rates, or each wheel's, times a factor."""
    return Mistaken(times("wheel_rpm", factor), names, wheel_spread=log_volume(factor))


def rates_times(factor: float | Sequence[float], *names: str) -> Mistaken:
    """Body rates, or each axis's, times a factor."""
    return Mistaken(times("rate_rad_s", factor), names, rate_spread=log_volume(factor))


def moved(late_s: float, *channels: str) -> Change:
    """Channels that come late: rows slip down; what was before the first is repeated."""

    def slipped(values: Array, time_s: Array) -> Array:
        there = np.flatnonzero(~np.isnan(values).any(axis=1))
        time = time_s[there]
        source = np.searchsorted(time, time - late_s + 1e-9, side="right") - 1
        result: Array = values.copy()
        result[there] = values[there[np.clip(source, 0, len(there) - 1)]]
        return result

    return lambda chunk: by(lambda values: slipped(values, chunk.time_s), *channels)(chunk)


def wheel(column: int, value: Callable[[Array], Array | float]) -> Change:
    """The rates of one wheel as a function of those of all."""

    def changed(rpm: Array) -> Array:
        result = rpm.copy()
        known = ~np.isnan(result[:, column])
        result[known, column] = np.broadcast_to(value(result[known]), known.sum())
        return result

    return by(changed, "wheel_rpm")


def stuck(column: int) -> Callable[[Array], Array]:
    """A column that keeps its value from half-way on."""

    def values(channel: Array) -> Array:
        result = channel[:, column].copy()
        result[len(result) // 2 :] = result[len(result) // 2]
        return result

    return values


def jump(column: int, size: float) -> Callable[[Array], Array]:
    """A column that jumps by a constant half-way."""
    return lambda channel: channel[:, column] + size * (np.arange(len(channel)) > len(channel) // 2)


CONJUGATE: Final = (-1.0, -1.0, -1.0, 1.0)
SCALAR_FIRST: Final = (3, 0, 1, 2)
COUNTERS: Final = ("on_time_s", "pulses")
ORDER: Final = ("wheel-order",)
SIGN: Final = ("wheel-sign",)
UNIT: Final = ("wheel-unit",)
FACTOR: Final = ("wheel-factor",)
SILENT: Final = ("wheel-silent",)
THRUSTERS: Final = ("thruster-order",)
CONVENTION: Final = ("attitude-convention",)

_WHEELS: Final[Mapping[str, Mistaken]] = {
    "first two wheels exchanged": Mistaken(ordered("wheel_rpm", (1, 0, 2)), ORDER),
    "last two wheels exchanged": Mistaken(ordered("wheel_rpm", (0, 2, 1)), ORDER),
    "first and last wheel exchanged": Mistaken(ordered("wheel_rpm", (2, 1, 0)), ORDER),
    "wheels rotated": Mistaken(ordered("wheel_rpm", (1, 2, 0)), ORDER),
    "wheels rotated the other way": Mistaken(ordered("wheel_rpm", (2, 0, 1)), ORDER),
    "all wheel signs": wheels_times(-1.0, SIGN),
    "sign of the first wheel": wheels_times((-1.0, 1.0, 1.0), SIGN),
    "sign of the second wheel": wheels_times((1.0, -1.0, 1.0), SIGN),
    "signs of the last two wheels": wheels_times((1.0, -1.0, -1.0), SIGN),
    "wheels in rad/s": wheels_times(RAD_S_PER_RPM, UNIT),
    "wheels in deg/s": wheels_times(6.0, UNIT),
    "wheels in rev/s": wheels_times(1 / 60.0, UNIT),
    "wheels turned to rad/s twice": wheels_times(1 / RAD_S_PER_RPM, UNIT),
    "first wheel doubled": wheels_times((2.0, 1.0, 1.0), FACTOR),
    "second wheel halved": wheels_times((1.0, 0.5, 1.0), FACTOR),
    "last wheel × 1.2": wheels_times((1.0, 1.0, 1.2), FACTOR),
    "second wheel + 500 rpm": Mistaken(plus("wheel_rpm", (0.0, 500.0, 0.0)), ("wheel-offset",)),
    "first wheel − 50 rpm": Mistaken(plus("wheel_rpm", (-50.0, 0.0, 0.0)), ("wheel-offset",)),
    "second wheel jumps by 100 rpm": Mistaken(
        wheel(1, jump(1, 100.0)), ("wheel-offset", "bad-cell", "open-balance")
    ),
    "second wheel stuck": Mistaken(wheel(1, lambda rpm: rpm[0, 1]), SILENT),
    "last wheel stuck from half-way": Mistaken(wheel(2, stuck(2)), SILENT),
    "second wheel repeats the first": Mistaken(wheel(1, lambda rpm: rpm[:, 0]), SILENT),
    "wheels 8 s late": Mistaken(moved(8.0, "wheel_rpm"), ("wheel-time",)),
    "wheels 20 s early": Mistaken(moved(-20.0, "wheel_rpm"), ("wheel-time",)),
}
_COUNTERS: Final[Mapping[str, Mistaken]] = {
    "z1 and z3 exchanged": exchanged((0, 2)),
    "z1 and z2 exchanged": exchanged((0, 1)),
    "z2 and z4 exchanged": exchanged((1, 3)),
    "z1 and y1 exchanged": exchanged((0, 4)),
    "z3 and y4 exchanged": exchanged((2, 7)),
    "y1 and y2 exchanged": exchanged((4, 5)),
    "y1 and y3 exchanged": exchanged((4, 6)),
    "z1 with z2, z3 with z4": exchanged((0, 1), (2, 3)),
    "y1 with y2, y3 with y4": exchanged((4, 5), (6, 7)),
    "pulses doubled": Mistaken(times("pulses", 2.0), ("pulse-count",), BIAS),
    "pulses tripled": Mistaken(times("pulses", 3.0), ("pulse-count",), BIAS),
    "on-times in ms": Mistaken(times("on_time_s", 1e3), ("on-time-unit",), BIAS),
    "on-times × 1.2": Mistaken(times("on_time_s", 1.2), (), BIAS),
    "counters 20 s late": Mistaken(moved(20.0, *COUNTERS), ("counter-time",), BIAS),
    "counters 8 s early": Mistaken(moved(-8.0, *COUNTERS), ("counter-time",), BIAS),
}
_RATES: Final[Mapping[str, Mistaken]] = {
    "rates zero": Mistaken(times("rate_rad_s", 0.0), ("rate-silent",)),
    "x rate zero": Mistaken(times("rate_rad_s", (0.0, 1.0, 1.0)), ("rate-silent",)),
    "z rate zero": Mistaken(times("rate_rad_s", (1.0, 1.0, 0.0)), ("rate-silent",)),
    "all rate signs": rates_times(-1.0, "rate-sign"),
    "sign of y rate": rates_times((1.0, -1.0, 1.0), "rate-sign"),
    "signs of x and z rates": rates_times((-1.0, 1.0, -1.0), "rate-sign"),
    "x and y rates exchanged": Mistaken(ordered("rate_rad_s", (1, 0, 2)), ("rate-axes",)),
    "y and z rates exchanged": Mistaken(ordered("rate_rad_s", (0, 2, 1)), ("rate-axes",)),
    "rates rotated": Mistaken(ordered("rate_rad_s", (1, 2, 0)), ("rate-axes",)),
    "rates in deg/s": rates_times(DEGREES, "rate-unit"),
    "rates in mrad/s": rates_times(1e3, "rate-unit", "time-unit"),
    "rates turned from deg/s twice": rates_times(1.0 / DEGREES, "rate-unit", "time-unit"),
    "rates × 1.1": rates_times(1.1, "rate-factor"),
    "y rate × 1.1": rates_times((1.0, 1.1, 1.0), "rate-factor"),
    "rates × 2": rates_times(2.0, "rate-factor"),
    "rates × 0.5": rates_times(0.5, "rate-factor"),
    "rates 8 s late": Mistaken(moved(8.0, "rate_rad_s"), ("rate-time",)),
    "rates 20 s early": Mistaken(moved(-20.0, "rate_rad_s"), ("rate-time",)),
}
_ATTITUDES: Final[Mapping[str, Mistaken]] = {
    "quaternions inverse": Mistaken(times("attitude", CONJUGATE), CONVENTION),
    "quaternions scalar-first": Mistaken(ordered("attitude", SCALAR_FIRST), CONVENTION),
    "quaternions scalar-first and inverse": Mistaken(
        by(lambda values: (values * np.array(CONJUGATE))[:, SCALAR_FIRST], "attitude"), CONVENTION
    ),
    "attitudes 8 s late": Mistaken(moved(8.0, "attitude"), ("attitude-time",)),
    "attitudes 20 s early": Mistaken(moved(-20.0, "attitude"), ("attitude-time",)),
    "times in ms": Mistaken(times("time_s", 1e3), ("time-unit",)),
    "times in min": Mistaken(times("time_s", 1.0 / 60.0), ("time-unit",)),
}
TELEMETRY: Final[Mapping[str, Mistaken]] = MappingProxyType(
    {**_WHEELS, **_COUNTERS, **_RATES, **_ATTITUDES}
)
"""Mistakes in telemetry by name."""

# ---- totals --------------------------------------------------------------------------------------

RowChange = Callable[[TotalsEvent], TotalsEvent]


@dataclass(frozen=True)
class MistakenRow:
    """A mistake in a row of totals, and names under which it counts as found.

    ``spread``: as :class:`Mistaken`, of wheel rates that are multiplied; what a row says of them is
    three components of momentum.
    """

    change: RowChange
    names: tuple[str, ...]
    spread: float = 0.0


def wheel_rates_by(change: Callable[[Array], Array]) -> RowChange:
    """Wheel rates before and after, changed alike."""
    return lambda row: replace(
        row, rwa_start_rpm=change(row.rwa_start_rpm), rwa_end_rpm=change(row.rwa_end_rpm)
    )


def wheel_rates_times(factor: float | Sequence[float], *names: str) -> MistakenRow:
    """Wheel rates, or each wheel's, times a factor."""
    change = wheel_rates_by(lambda rpm: rpm * np.asarray(factor))
    return MistakenRow(change, names, log_volume(factor))


def wheels_ordered(*order: int) -> MistakenRow:
    """Wheels in another order."""
    return MistakenRow(wheel_rates_by(lambda rpm: rpm[list(order)]), ORDER)


def totals_exchanged(a: int, b: int) -> MistakenRow:
    """Totals of two thrusters exchanged."""
    swap = swapped((a, b))

    def change(row: TotalsEvent) -> TotalsEvent:
        pulses = None if row.pulses is None else swap(row.pulses)
        return replace(row, on_time_s=swap(row.on_time_s), pulses=pulses)

    return MistakenRow(change, THRUSTERS)


def on_times_by(change: Callable[[Array], Array]) -> RowChange:
    """On-times changed."""
    return lambda row: replace(row, on_time_s=change(row.on_time_s))


def cell_times(column: int, factor: float) -> RowChange:
    """One thruster's on-time times a factor."""
    return on_times_by(lambda on: on * np.where(np.arange(len(on)) == column, factor, 1.0))


TOTALS: Final[Mapping[str, MistakenRow]] = MappingProxyType(
    {
        "start and end exchanged": MistakenRow(
            lambda row: replace(row, rwa_start_rpm=row.rwa_end_rpm, rwa_end_rpm=row.rwa_start_rpm),
            ("start-end", "wheel-sign"),
        ),
        "first two wheels exchanged": wheels_ordered(1, 0, 2),
        "last two wheels exchanged": wheels_ordered(0, 2, 1),
        "wheels rotated": wheels_ordered(1, 2, 0),
        "all wheel signs": wheel_rates_times(-1.0, "wheel-sign", "start-end"),
        "sign of the second wheel": wheel_rates_times((1.0, -1.0, 1.0), *SIGN),
        "wheels in rad/s": wheel_rates_times(RAD_S_PER_RPM, *UNIT),
        "wheels in deg/s": wheel_rates_times(6.0, *UNIT),
        "wheels in rev/s": wheel_rates_times(1.0 / 60.0, *UNIT),
        "z1 and z3 exchanged": totals_exchanged(0, 2),
        "z1 and z2 exchanged": totals_exchanged(0, 1),
        "z1 and y1 exchanged": totals_exchanged(0, 4),
        "y1 and y2 exchanged": totals_exchanged(4, 5),
        "y1 and y3 exchanged": totals_exchanged(4, 6),
        "on-times in ms": MistakenRow(on_times_by(lambda on: 1e3 * on), ("on-time-unit",)),
        "on-times × 1.2": MistakenRow(on_times_by(lambda on: 1.2 * on), ()),
        "z2 on-time × 10": MistakenRow(cell_times(1, 10.0), ("bad-cell", "on-time-unit")),
    }
)
"""Mistakes in totals by name: in every row of a table, in one row, in a row that stands alone."""
