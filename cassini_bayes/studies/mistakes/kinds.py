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


def times(channel: str, factor: float | Sequence[float]) -> Change:
    """A channel, or each of its columns, times a factor."""
    return lambda chunk: replace(chunk, **{channel: getattr(chunk, channel) * np.asarray(factor)})


def plus(channel: str, offset: Sequence[float]) -> Change:
    """A channel's columns with constant errors."""
    return lambda chunk: replace(chunk, **{channel: getattr(chunk, channel) + np.asarray(offset)})


def ordered(channel: str, order: Sequence[int]) -> Change:
    """Columns of a channel in another order."""
    return lambda chunk: replace(chunk, **{channel: getattr(chunk, channel)[:, list(order)]})


def exchanged(*pairs: tuple[int, int]) -> Change:
    """Counters of pairs of thrusters exchanged."""

    def change(chunk: Chunk) -> Chunk:
        order = list(range(chunk.on_time_s.shape[1]))
        for a, b in pairs:
            order[a], order[b] = order[b], order[a]
        return replace(chunk, on_time_s=chunk.on_time_s[:, order], pulses=chunk.pulses[:, order])

    return change


def moved(late_s: float, *channels: str) -> Change:
    """Channels that come late: rows slip down; what was before the first is repeated."""

    def slipped(chunk: Chunk, channel: str) -> Array:
        values = getattr(chunk, channel)
        there = np.flatnonzero(~np.isnan(values).any(axis=1))
        time = chunk.time_s[there]
        source = np.searchsorted(time, time - late_s + 1e-9, side="right") - 1
        result: Array = values.copy()
        result[there] = values[there[np.clip(source, 0, len(there) - 1)]]
        return result

    def change(chunk: Chunk) -> Chunk:
        for name in channels:
            late: dict[str, Any] = {name: slipped(chunk, name)}
            chunk = replace(chunk, **late)
        return chunk

    return change


def with_column(channel: str, column: int, value: Callable[[Array], Array | float]) -> Change:
    """One column of a channel as a function of the channel."""

    def change(chunk: Chunk) -> Chunk:
        values = getattr(chunk, channel).copy()
        known = ~np.isnan(values[:, column])
        values[known, column] = np.broadcast_to(value(values[known]), known.sum())
        return replace(chunk, **{channel: values})

    return change


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
COUNTERS: Final = ("on_time_s", "pulses")
ORDER: Final = ("wheel-order",)
SIGN: Final = ("wheel-sign",)
UNIT: Final = ("wheel-unit",)
THRUSTERS: Final = ("thruster-order",)

_WHEELS: Final[Mapping[str, Mistaken]] = {
    "first two wheels exchanged": Mistaken(ordered("wheel_rpm", (1, 0, 2)), ORDER),
    "last two wheels exchanged": Mistaken(ordered("wheel_rpm", (0, 2, 1)), ORDER),
    "first and last wheel exchanged": Mistaken(ordered("wheel_rpm", (2, 1, 0)), ORDER),
    "wheels rotated": Mistaken(ordered("wheel_rpm", (1, 2, 0)), ORDER),
    "wheels rotated the other way": Mistaken(ordered("wheel_rpm", (2, 0, 1)), ORDER),
    "all wheel signs": Mistaken(times("wheel_rpm", -1.0), SIGN),
    "sign of the first wheel": Mistaken(times("wheel_rpm", (-1.0, 1.0, 1.0)), SIGN),
    "sign of the second wheel": Mistaken(times("wheel_rpm", (1.0, -1.0, 1.0)), SIGN),
    "signs of the last two wheels": Mistaken(times("wheel_rpm", (1.0, -1.0, -1.0)), SIGN),
    "wheels in rad/s": Mistaken(
        times("wheel_rpm", RAD_S_PER_RPM), UNIT, wheel_spread=3.0 * np.log(RAD_S_PER_RPM)
    ),
    "wheels in deg/s": Mistaken(times("wheel_rpm", 6.0), UNIT, wheel_spread=3.0 * np.log(6.0)),
    "wheels in rev/s": Mistaken(
        times("wheel_rpm", 1 / 60.0), UNIT, wheel_spread=-3.0 * np.log(60.0)
    ),
    "wheels turned to rad/s twice": Mistaken(
        times("wheel_rpm", 1 / RAD_S_PER_RPM), UNIT, wheel_spread=-3.0 * np.log(RAD_S_PER_RPM)
    ),
    "first wheel doubled": Mistaken(
        times("wheel_rpm", (2.0, 1.0, 1.0)), ("wheel-factor",), wheel_spread=np.log(2.0)
    ),
    "second wheel halved": Mistaken(
        times("wheel_rpm", (1.0, 0.5, 1.0)), ("wheel-factor",), wheel_spread=-np.log(2.0)
    ),
    "last wheel × 1.2": Mistaken(
        times("wheel_rpm", (1.0, 1.0, 1.2)), ("wheel-factor",), wheel_spread=np.log(1.2)
    ),
    "second wheel + 500 rpm": Mistaken(plus("wheel_rpm", (0.0, 500.0, 0.0)), ("wheel-offset",)),
    "first wheel − 50 rpm": Mistaken(plus("wheel_rpm", (-50.0, 0.0, 0.0)), ("wheel-offset",)),
    "second wheel jumps by 100 rpm": Mistaken(
        with_column("wheel_rpm", 1, jump(1, 100.0)), ("wheel-offset", "bad-cell", "open-balance")
    ),
    "second wheel stuck": Mistaken(
        with_column("wheel_rpm", 1, lambda v: v[0, 1]), ("wheel-silent",)
    ),
    "last wheel stuck from half-way": Mistaken(
        with_column("wheel_rpm", 2, stuck(2)), ("wheel-silent",)
    ),
    "second wheel repeats the first": Mistaken(
        with_column("wheel_rpm", 1, lambda v: v[:, 0]), ("wheel-silent",)
    ),
    "wheels 8 s late": Mistaken(moved(8.0, "wheel_rpm"), ("wheel-time",)),
    "wheels 20 s early": Mistaken(moved(-20.0, "wheel_rpm"), ("wheel-time",)),
}
_COUNTERS: Final[Mapping[str, Mistaken]] = {
    "z1 and z3 exchanged": Mistaken(exchanged((0, 2)), THRUSTERS, BIAS),
    "z1 and z2 exchanged": Mistaken(exchanged((0, 1)), THRUSTERS, BIAS),
    "z2 and z4 exchanged": Mistaken(exchanged((1, 3)), THRUSTERS, BIAS),
    "z1 and y1 exchanged": Mistaken(exchanged((0, 4)), THRUSTERS, BIAS),
    "z3 and y4 exchanged": Mistaken(exchanged((2, 7)), THRUSTERS, BIAS),
    "y1 and y2 exchanged": Mistaken(exchanged((4, 5)), THRUSTERS, BIAS),
    "y1 and y3 exchanged": Mistaken(exchanged((4, 6)), THRUSTERS, BIAS),
    "z1 with z2, z3 with z4": Mistaken(exchanged((0, 1), (2, 3)), THRUSTERS, BIAS),
    "y1 with y2, y3 with y4": Mistaken(exchanged((4, 5), (6, 7)), THRUSTERS, BIAS),
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
    "all rate signs": Mistaken(times("rate_rad_s", -1.0), ("rate-sign",)),
    "sign of y rate": Mistaken(times("rate_rad_s", (1.0, -1.0, 1.0)), ("rate-sign",)),
    "signs of x and z rates": Mistaken(times("rate_rad_s", (-1.0, 1.0, -1.0)), ("rate-sign",)),
    "x and y rates exchanged": Mistaken(ordered("rate_rad_s", (1, 0, 2)), ("rate-axes",)),
    "y and z rates exchanged": Mistaken(ordered("rate_rad_s", (0, 2, 1)), ("rate-axes",)),
    "rates rotated": Mistaken(ordered("rate_rad_s", (1, 2, 0)), ("rate-axes",)),
    "rates in deg/s": Mistaken(
        times("rate_rad_s", DEGREES), ("rate-unit",), rate_spread=3.0 * np.log(DEGREES)
    ),
    "rates in mrad/s": Mistaken(
        times("rate_rad_s", 1e3), ("rate-unit", "time-unit"), rate_spread=3.0 * np.log(1e3)
    ),
    "rates turned from deg/s twice": Mistaken(
        times("rate_rad_s", 1.0 / DEGREES),
        ("rate-unit", "time-unit"),
        rate_spread=-3.0 * np.log(DEGREES),
    ),
    "rates × 1.1": Mistaken(
        times("rate_rad_s", 1.1), ("rate-factor",), rate_spread=3.0 * np.log(1.1)
    ),
    "y rate × 1.1": Mistaken(
        times("rate_rad_s", (1.0, 1.1, 1.0)), ("rate-factor",), rate_spread=np.log(1.1)
    ),
    "rates × 2": Mistaken(
        times("rate_rad_s", 2.0), ("rate-factor",), rate_spread=3.0 * np.log(2.0)
    ),
    "rates × 0.5": Mistaken(
        times("rate_rad_s", 0.5), ("rate-factor",), rate_spread=-3.0 * np.log(2.0)
    ),
    "rates 8 s late": Mistaken(moved(8.0, "rate_rad_s"), ("rate-time",)),
    "rates 20 s early": Mistaken(moved(-20.0, "rate_rad_s"), ("rate-time",)),
}
_ATTITUDES: Final[Mapping[str, Mistaken]] = {
    "quaternions inverse": Mistaken(times("attitude", CONJUGATE), ("attitude-convention",)),
    "quaternions scalar-first": Mistaken(
        ordered("attitude", (3, 0, 1, 2)), ("attitude-convention",)
    ),
    "quaternions scalar-first and inverse": Mistaken(
        lambda chunk: ordered("attitude", (3, 0, 1, 2))(times("attitude", CONJUGATE)(chunk)),
        ("attitude-convention",),
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


def rates_by(change: Callable[[Array], Array]) -> RowChange:
    """Wheel rates before and after, changed alike."""
    return lambda row: replace(
        row, rwa_start_rpm=change(row.rwa_start_rpm), rwa_end_rpm=change(row.rwa_end_rpm)
    )


def rates_times(factor: float | Sequence[float]) -> RowChange:
    """Wheel rates, or each wheel's, times a factor."""
    return rates_by(lambda rpm: rpm * np.asarray(factor))


def rates_ordered(*order: int) -> RowChange:
    """Wheels in another order."""
    return rates_by(lambda rpm: rpm[list(order)])


def totals_exchanged(a: int, b: int) -> RowChange:
    """Totals of two thrusters exchanged."""

    def change(row: TotalsEvent) -> TotalsEvent:
        order = list(range(len(row.on_time_s)))
        order[a], order[b] = order[b], order[a]
        pulses = None if row.pulses is None else row.pulses[order]
        return replace(row, on_time_s=row.on_time_s[order], pulses=pulses)

    return change


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
        "first two wheels exchanged": MistakenRow(rates_ordered(1, 0, 2), ORDER),
        "last two wheels exchanged": MistakenRow(rates_ordered(0, 2, 1), ORDER),
        "wheels rotated": MistakenRow(rates_ordered(1, 2, 0), ORDER),
        "all wheel signs": MistakenRow(rates_times(-1.0), ("wheel-sign", "start-end")),
        "sign of the second wheel": MistakenRow(rates_times((1.0, -1.0, 1.0)), SIGN),
        "wheels in rad/s": MistakenRow(
            rates_times(RAD_S_PER_RPM), UNIT, 3.0 * np.log(RAD_S_PER_RPM)
        ),
        "wheels in deg/s": MistakenRow(rates_times(6.0), UNIT, 3.0 * np.log(6.0)),
        "wheels in rev/s": MistakenRow(rates_times(1.0 / 60.0), UNIT, -3.0 * np.log(60.0)),
        "z1 and z3 exchanged": MistakenRow(totals_exchanged(0, 2), THRUSTERS),
        "z1 and z2 exchanged": MistakenRow(totals_exchanged(0, 1), THRUSTERS),
        "z1 and y1 exchanged": MistakenRow(totals_exchanged(0, 4), THRUSTERS),
        "y1 and y2 exchanged": MistakenRow(totals_exchanged(4, 5), THRUSTERS),
        "y1 and y3 exchanged": MistakenRow(totals_exchanged(4, 6), THRUSTERS),
        "on-times in ms": MistakenRow(on_times_by(lambda on: 1e3 * on), ("on-time-unit",)),
        "on-times × 1.2": MistakenRow(on_times_by(lambda on: 1.2 * on), ()),
        "z2 on-time × 10": MistakenRow(cell_times(1, 10.0), ("bad-cell", "on-time-unit")),
    }
)
"""Mistakes in totals by name: in every row of a table, in one row, in a row that stands alone."""
