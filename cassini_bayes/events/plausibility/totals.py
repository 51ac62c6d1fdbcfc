"""Mistakes in totals rows: three equations per bias, redundant over the biases of a table.

    T I_w (ρ_end − ρ_start) = Σ_k q_k F s_k + τ t,    s = on-time + pulses (τ_f − τ_r)

The body does not turn and comes to rest, so nothing else exchanges momentum. Departures from the
nominal values are those of telemetry, shared by all rows; a row has its own thrusts and its own
rates at the ends besides. With y (3 E) what is left at nominal values and K its covariance from
departures and noise, the misfit is yᵀ K⁻¹ y, 3 E or less for rows that fit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.plausibility.departures import WIDTHS, Nominal
from cassini_bayes.events.plausibility.hypotheses import impossible_units
from cassini_bayes.events.plausibility.momentum import LEAST_IMPULSE, vanishing
from cassini_bayes.events.plausibility.undone import (
    FREE_PRICE,
    ORDER_PRICE,
    WHEEL_UNITS,
    other_orders,
    other_signs,
)
from cassini_bayes.events.plausibility.verdict import (
    STRICT,
    Explanation,
    Findings,
    Policy,
    best_explanations,
)
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.spacecraft import Spacecraft
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

HOLD: Final = 2.0
"""Of the dead-band's rate, at the two ends together: √2 of two independent ones, and as much again
for what a prior does not know (0.5 N m s of Cassini)."""
HOLD_RAD_S: Final = 4.5e-5
"""Rate left in the dead-band, where parameters have no ``hold_rate_rad_s``: Cassini's."""
JITTER: Final = 0.02
"""Of a thruster's impulse, from bias to bias."""
QUICKENED_RAD_S2: Final = 2e-8
"""Of the body by a steady torque, each axis and row: 1e-4 N m of Cassini, fifty times what flight
has shown (paper 000)."""
LONGEST_S: Final = 1e9
"""Of a row, so that its square is a number; no bias lasts for thirty years."""
OWN_THRUST: Final = 0.06
"""Of its thrust: a thruster's own departure (published: 0.02 N of 0.7 N), but for the one that may
have lost any part of it."""
LOST: Final = 0.2
"""What that one may have lost: the catalogue's width."""
CELL_S: Final = 30.0
"""Of an on-time that is wrong: by how much at least, and three times what it says (judgement)."""
DECADES: Final = {"ten times too long": 0.1, "ten times too short": 10.0}
"""Slips of a decimal point in one thruster's column: one of sixteen, at a price far below that of
any factor."""
FACTOR: Final = 3.0
"""Of on-times that are in another unit: how much of them is none."""
TAIL_S: Final = 0.03
OWN_TAIL_S: Final = 0.01
"""Thrust per pulse beyond the nominal: with more, firing could vanish in tables of short pulses."""
USUAL_PULSE_S: Final = 0.25
"""Mean width taken where a table has no pulse counts."""
UNKNOWN_PER_ROW: Final = 20.0
"""Misfit per row above which a table is flagged though no mistake explains it: by trial (flight
rows leave 0.4 or less)."""
SUSPECT: Final = 9.0
LEAST_GAIN: Final = 7.0
"""As for telemetry, but lower: with three equations a row, departures swallow noise (flight's rows
leave 0.4 or less, and each alone 9.9 or more where its wheel rates are in rad/s)."""
SUSPECT_ALONE: Final = 6.0
GAIN_ALONE: Final = 3.5
"""The same of a row that stands alone: departures swallow more of its three equations (257 honest
rows leave 3.8 at most)."""
GROSS: Final = 100.0
"""Misfit per row above which a table that no mistake explains is refused: by trial, ten standard
deviations of every row."""


@dataclass(frozen=True, eq=False)
class TotalsRow:
    """One row as arrays, and which wheels it has."""

    id: str
    wheels: tuple[int, ...]
    start_rpm: Array  # (W,)
    end_rpm: Array  # (W,)
    duration_s: float
    on_time_s: Array  # (K,)
    pulses: Array  # (K,)

    @classmethod
    def of(cls, event: TotalsEvent) -> TotalsRow:
        """From an event."""
        pulses = event.on_time_s / USUAL_PULSE_S if event.pulses is None else event.pulses
        return cls(
            event.id,
            event.wheels,
            event.rwa_start_rpm,
            event.rwa_end_rpm,
            event.duration_s,
            event.on_time_s,
            pulses,
        )


@dataclass(frozen=True, eq=False)
class _Table:
    """Rows that share a spacecraft: nominal values by set of wheels."""

    nominals: Mapping[tuple[int, ...], Nominal]
    numbers: tuple[int, ...]  # of all wheels
    pushes: Array
    steady: bool  # whether thrusts depart alike in all rows
    hold_rad_s: float  # of the body at the two ends together, each axis
    torque_n_m: Array  # (3,) steady, that priors allow

    def misfit(self, rows: Sequence[TotalsRow], free: Array | None = None) -> float:
        """yᵀ K⁻¹ y and the price of vanishing impulse; a direction ``free`` (3 E,) has none."""
        left, shared, noise = (
            np.concatenate(parts) for parts in zip(*map(self._row, rows), strict=True)
        )
        own = shared[:, self._thrust : self._thrust + self.pushes.shape[1]]
        covariance = shared @ shared.T
        for i in range(len(rows)):
            place = slice(3 * i, 3 * i + 3)
            covariance[place, place] += noise[place]
        if free is not None:
            covariance = covariance + np.outer(free, free)
        # physics first: one thruster may have lost any part of its thrust
        inverse = np.linalg.inv(covariance)
        pulled, weakened = inverse @ left, own * (LOST / OWN_THRUST)
        strength = np.einsum("nk,nm,mk->k", weakened, inverse, weakened)
        least = float(left @ pulled)
        misfit = min(least, float(np.min(least - (weakened.T @ pulled) ** 2 / (1.0 + strength))))
        share = self._share_of_impulse(rows)
        departures = (shared.T @ pulled)[self._common : self._common + len(share)]
        return misfit + vanishing(1.0 + float(share @ departures), float(share @ share))

    @property
    def _common(self) -> int:
        return 3 * len(self.numbers)

    @property
    def _thrust(self) -> int:
        return self._common + 1

    def _share_of_impulse(self, rows: Sequence[TotalsRow]) -> Array:
        """What 1 σ of each departure of firing adds to the impulse of all rows, as a share of it.

        In the order of the shared departures: thrust common and own, tail common and own.
        """
        on, pulses = np.zeros((2, self.pushes.shape[1]))
        for row in rows:
            nominal = self.nominals[row.wheels]
            size = np.linalg.norm(nominal.torques, axis=0)
            on += size * (row.on_time_s + nominal.tail_s * row.pulses)
            pulses += size * row.pulses
        common, tail = WIDTHS["common"] * on.sum(), TAIL_S * pulses.sum()
        parts = [[common], OWN_THRUST * on, [tail], OWN_TAIL_S * pulses]
        shares: Array = np.concatenate([np.asarray(part) for part in parts])
        return shares / max(float(on.sum()), LEAST_IMPULSE)

    def _row(self, row: TotalsRow) -> tuple[Array, Array, Array]:
        """What is left (3,), shared departures (3, J), covariance of the row's own (3, 3)."""
        nominal = self.nominals[row.wheels]
        change = RAD_S_PER_RPM * (row.end_rpm - row.start_rpm)
        effective = row.on_time_s + nominal.tail_s * row.pulses
        each = nominal.torques * effective
        left = nominal.spins @ change - each.sum(axis=1)
        wheels = np.zeros((3, len(self.numbers), 3))
        for place, number in enumerate(row.wheels):
            spin = np.linalg.norm(nominal.spins[:, place]) * change[place]
            wheels[:, self.numbers.index(number)] = WIDTHS["wheel"] * spin * np.eye(3)
        sizes = np.linalg.norm(nominal.torques, axis=0)
        push = (self.pushes * effective).sum(axis=1)
        shared = [
            wheels.reshape(3, -1),
            WIDTHS["common"] * each.sum(axis=1, keepdims=True),
            OWN_THRUST * each,
            TAIL_S * (nominal.torques * row.pulses).sum(axis=1, keepdims=True),
            OWN_TAIL_S * nominal.torques * row.pulses,
            WIDTHS["centre"] * np.cross(np.eye(3), push).T,
            (WIDTHS["cant"] * sizes * effective)[None, :, None] * np.eye(3)[:, None, :],
        ]
        noise = JITTER**2 * each @ each.T
        if not self.steady:
            common = WIDTHS["common"] * each.sum(axis=1)
            noise += np.outer(common, common) + WIDTHS["thrust"] ** 2 * each @ each.T
        lasted_s = min(row.duration_s, LONGEST_S)
        rate_rad_s = np.hypot(self.hold_rad_s, QUICKENED_RAD_S2 * lasted_s)
        # in the size of the body: craft whose masses are all larger have the same verdicts
        noise += rate_rad_s**2 * nominal.inertia @ nominal.inertia.T
        noise += np.diag((self.torque_n_m * lasted_s) ** 2)
        return left, np.concatenate([part.reshape(3, -1) for part in shared], axis=1), noise


def check_totals(
    events: Sequence[TotalsEvent],
    spacecraft: Spacecraft,
    parameters: Mapping[str, float],
    where: str,
    policy: Policy = STRICT,
    *,
    steady: bool = True,
    torque_n_m: Sequence[float] = (0.0, 0.0, 0.0),
) -> tuple[str, ...]:
    """Check rows of a table against the balance of momentum, and against each other.

    Parameters
    ----------
    events
        Rows of one branch.
    spacecraft, parameters
        As for telemetry, and ``hold_rate_rad_s``; without, Cassini's.
    where
        What the rows came from, for the message.
    policy
        Mistakes that the user accepts.
    steady
        Whether thrusts are the same in all rows; over a mission, pressure and ageing move them.
    torque_n_m
        Steady torque about each axis, root mean square, that priors allow.

    Returns
    -------
    tuple
        What was not refused but has to be said, in sentences.

    Raises
    ------
    InputError
        One mistake, in all rows or in one, explains what physics does not; or a table that nothing
        explains.
    """
    findings = Findings(policy)
    rows = [TotalsRow.of(event) for event in events]
    if not rows:
        return ()
    _check_on_times(events, where, findings)
    branch = events[0].branch
    nominals = {
        wheels: Nominal.of(spacecraft, branch, wheels, parameters, fires=True)
        for wheels in {row.wheels for row in rows}
    }
    numbers = tuple(sorted({number for wheels in nominals for number in wheels}))
    pushes = next(iter(nominals.values())).pushes
    hold_rad_s = HOLD * parameters.get("hold_rate_rad_s", HOLD_RAD_S)
    table = _Table(nominals, numbers, pushes, steady, hold_rad_s, np.asarray(torque_n_m))
    misfit = table.misfit(rows)
    suspect, least_gain = (SUSPECT, LEAST_GAIN) if len(rows) > 1 else (SUSPECT_ALONE, GAIN_ALONE)
    if misfit <= suspect:
        return tuple(findings.sentences)
    best = best_explanations(
        misfit, list(_explanations(table, rows, events[0].thrusters)), least_gain, suspect
    )
    expected = "wheel rates and on-times that exchange the same momentum"
    if best:
        findings.refuse_best(where, expected, misfit, best)
    elif misfit > GROSS * len(rows):
        findings.refuse(
            "open-balance",
            where,
            expected,
            f"a misfit of {misfit:.3g} that no single mistake explains",
            "check branch, wheels, signs and units, and that the nominal values are this"
            " spacecraft's",
        )
    elif misfit > UNKNOWN_PER_ROW * len(rows):
        findings.sentences.append(
            f"{where}: on-times and wheel rates differ by more than physics explains (misfit"
            f" {misfit:.3g}) and no single mistake explains it: diagnose it"
        )
    return tuple(findings.sentences)


def _check_on_times(events: Sequence[TotalsEvent], where: str, findings: Findings) -> None:
    """No thruster fires for longer than its event lasts; the reader refuses such files itself."""
    for event in events:
        worst = int(np.argmax(event.on_time_s))
        if event.on_time_s[worst] > event.duration_s:
            findings.refuse(
                "on-time-unit",
                f"{where}: row {event.id}, on_time_{event.thrusters[worst]}_s",
                f"at most the {event.duration_s:g} s that the event lasts",
                f"{event.on_time_s[worst]:g} s: on-times that look like ms",
                "give on_time_…_s in seconds, or correct duration_s",
            )
            return


class _Change(NamedTuple):
    """A mistake, what it looks like, how to mend the table, the rows with it undone, its price."""

    mistake: str
    what: str
    fix: str
    rows: list[TotalsRow]
    price: float = ORDER_PRICE


def _explanations(
    table: _Table, rows: Sequence[TotalsRow], thrusters: Sequence[str]
) -> Iterator[Explanation]:
    """Every mistake in all rows, in one row, in one cell."""
    for mistake, what, fix, changed, price in _changes(rows, thrusters):
        yield Explanation(mistake, f"{what} in every row", fix, table.misfit(changed), price)
    if len(rows) > 1:
        of_rows = 2.0 * np.log(len(rows))
        for i, row in enumerate(rows):
            for mistake, what, fix, changed, price in _changes([row], thrusters):
                left = table.misfit([*rows[:i], *changed, *rows[i + 1 :]])
                yield Explanation(mistake, f"{what} in row {row.id}", fix, left, price + of_rows)
        for k, name in enumerate(thrusters):
            yield from _of_one_thruster(table, rows, k, name)
    for i, row in enumerate(rows):
        for column, direction in _cells(table, row, thrusters):
            free = np.zeros(3 * len(rows))
            free[3 * i : 3 * i + 3] = direction
            what = f"a cell {column} of row {row.id} that does not fit"
            fix = "correct the cell, or leave out the row"
            yield Explanation("bad-cell", what, fix, table.misfit(rows, free), FREE_PRICE)


def _of_one_thruster(
    table: _Table, rows: Sequence[TotalsRow], k: int, name: str
) -> Iterator[Explanation]:
    """On-times of one thruster off by a decade, or by any factor, in every row."""
    fix = f"check the unit of on_time_{name}_s"
    for said, factor in DECADES.items():
        own = np.where(np.arange(len(rows[0].on_time_s)) == k, factor, 1.0)
        what = f"on-times of {name} that look {said} in every row"
        left = table.misfit(_with_on_times(rows, own))
        yield Explanation("on-time-unit", what, fix, left, 2.0 * ORDER_PRICE)
    fired = [table.nominals[row.wheels].torques[:, k] * row.on_time_s[k] for row in rows]
    what = f"on-times of {name} times a factor in every row"
    left = table.misfit(rows, FACTOR * np.concatenate(fired))
    yield Explanation("on-time-unit", what, fix, left, FREE_PRICE)


def _changes(rows: Sequence[TotalsRow], thrusters: Sequence[str]) -> Iterator[_Change]:
    """The rows with each mistake undone."""
    swapped = [replace(row, start_rpm=row.end_rpm, end_rpm=row.start_rpm) for row in rows]
    yield _Change("start-end", "rates before and after exchanged", "exchange the columns", swapped)
    for unit, factor in WHEEL_UNITS.items():
        what = f"wheel rates that look like {unit}"
        yield _Change("wheel-unit", what, "give rev/min", _with_rates(rows, factor))
    on, pulses = sum(row.on_time_s for row in rows), sum(row.pulses for row in rows)
    span_s = sum(row.duration_s for row in rows)
    for unit, factor in impossible_units(np.asarray(on), np.asarray(pulses), span_s).items():
        what = f"on-times that look like {unit}"
        yield _Change("on-time-unit", what, "give seconds", _with_on_times(rows, factor))
    wheels = rows[0].wheels
    if all(row.wheels == wheels for row in rows):
        for order, what in other_orders(wheels):
            back = np.argsort(order)
            changed = [
                replace(row, start_rpm=row.start_rpm[back], end_rpm=row.end_rpm[back])
                for row in rows
            ]
            yield _Change("wheel-order", what, "correct the columns", changed)
        for signs, turned in other_signs(wheels):
            if len(turned) < len(wheels):
                what = f"rates of wheels {turned} of the opposite sign"
                fix = "give wheel rates about the wheels' own axes"
                yield _Change("wheel-sign", what, fix, _with_rates(rows, signs))
    for a, b in combinations(range(len(thrusters)), 2):
        places = list(range(len(thrusters)))
        places[a], places[b] = b, a
        changed = [
            replace(row, on_time_s=row.on_time_s[places], pulses=row.pulses[places]) for row in rows
        ]
        what = f"totals of thrusters exchanged, {thrusters[a]} with {thrusters[b]}"
        yield _Change("thruster-order", what, "correct the columns", changed, 2.0 * ORDER_PRICE)


def _with_rates(rows: Sequence[TotalsRow], factor: float | Array) -> list[TotalsRow]:
    return [
        replace(row, start_rpm=factor * row.start_rpm, end_rpm=factor * row.end_rpm) for row in rows
    ]


def _with_on_times(rows: Sequence[TotalsRow], factor: float | Array) -> list[TotalsRow]:
    return [replace(row, on_time_s=factor * row.on_time_s) for row in rows]


def _cells(table: _Table, row: TotalsRow, thrusters: Sequence[str]) -> Iterator[tuple[str, Array]]:
    """Cells of a row, and what an error of a usual size in each brings (3,)."""
    nominal = table.nominals[row.wheels]
    for place, name in enumerate(nominal.wheel_names):
        direction = 1000.0 * RAD_S_PER_RPM * nominal.spins[:, place]
        yield f"{name}_rpm_start or {name}_rpm_end", direction
    for k, name in enumerate(thrusters):
        yield f"on_time_{name}_s", max(CELL_S, 3.0 * row.on_time_s[k]) * nominal.torques[:, k]
