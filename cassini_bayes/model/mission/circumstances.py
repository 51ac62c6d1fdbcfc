"""What held when an event flew: time, branch, tank pressure, hydrazine used, facts before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.model.mission.mission_file import (
    Epoch,
    ForecastTable,
    MissionTable,
    PressureTable,
    utc,
    years_between,
)

KPA_PER_PSI: Final = 6.894757
LARGEST_BLOWDOWN: Final = 4.0
"""Ratio of pressures that a blowdown tank spans at most; figures in psia are 6.9 times less."""


@dataclass(frozen=True)
class EventFacts:
    """What a mission has to know of an event beside its data; ``pressure_kpa`` is its own."""

    id: str
    epoch: datetime
    branch: str
    fires: bool
    pressure_kpa: float | None


@dataclass(frozen=True)
class Circumstances:
    """Circumstances of E events in order of time; ``tank`` works out their pressures."""

    events: tuple[EventFacts, ...]
    years: Array  # (E,) since the reference epoch
    used_kg: Array  # (E,) tabulated hydrazine used since the reference epoch; 0 without drifts
    facts_before: tuple[int, ...]  # (E,) how many dated facts came before
    tank: Tank

    @property
    def branches(self) -> tuple[str, ...]:
        """Branches that flew, in order of their first event."""
        return tuple(dict.fromkeys(event.branch for event in self.events))


@dataclass(frozen=True)
class Tank:
    """Tank pressures (E,), known or from a blowdown law.

    Where the law acts, ``p = start (V / (V + f m / ρ))ⁿ`` with the tabulated mass m used since the
    tank was filled and f the factor on it.
    """

    reference_kpa: float
    known_kpa: Array  # (E,) NaN where the law acts
    start_kpa: Array  # (E,)
    ullage_m3: Array  # (E,) gas volume at the start
    used_m3: Array  # (E,) volume of the tabulated hydrazine used since
    refilled_m3: Array  # (E,) volume that was used before a recharge, which the gas has too
    exponent: float

    @property
    def is_circular(self) -> bool:
        """Whether any pressure depends on the mass of hydrazine used."""
        return bool(np.isnan(self.known_kpa).any())

    def pressures_kpa(self, factor: Array) -> Array:
        """Pressures (n, E) at factors (n,) on the mass used, kPa."""
        gas = self.ullage_m3 + factor[:, None] * self.refilled_m3
        law = self.start_kpa * (gas / (gas + factor[:, None] * self.used_m3)) ** self.exponent
        return np.where(np.isnan(self.known_kpa), law, self.known_kpa)


def circumstances_of(
    mission: MissionTable, events: Sequence[EventFacts], where: str
) -> Circumstances:
    """The circumstances of events.

    Raises
    ------
    InputError
        Events out of order, of a branch that swaps say was not in use, or without a pressure; a
        pressure, one of a forecast too, in another unit than the reference; a forecast of a branch
        that no event fires, or of a date before the last one that does; a date beyond the hydrazine
        table where a drift or the blowdown law goes by it.
    """
    for before, after in pairwise(events):
        if after.epoch < before.epoch:
            raise InputError(
                f"{where}: events: {after.id}",
                f"events in order of time: none before {before.id} of {before.epoch.date()}",
                str(after.epoch.date()),
                "list it earlier, or mend its epoch",
            )
    for event in events:
        _require_branch(mission, event, where)
    for place, asked in enumerate(mission.trend.forecast, start=1):
        named = f"{where}: trend.forecast[{place}]"
        _require_later(asked, events, named)
        if mission.pressure is not None:
            reference = mission.pressure.reference_kpa
            _require_kpa(asked.pressure_kpa, reference, f"{named}.pressure_kpa")
    start = mission.trend.reference_epoch
    used = np.zeros(len(events))
    if mission.drift:
        used -= _used_kg(mission, start, f"{where}: trend.reference_epoch")
        used += [_used_kg(mission, e.epoch, f"{where}: event {e.id}") for e in events]
    facts = [utc(fact.epoch) for fact in mission.dated]
    return Circumstances(
        events=tuple(events),
        years=np.array([years_between(start, event.epoch) for event in events]),
        used_kg=used,
        facts_before=tuple(sum(at <= event.epoch for at in facts) for event in events),
        tank=tank_of(mission, events, where),
    )


def tank_of(mission: MissionTable, events: Sequence[EventFacts], where: str) -> Tank:
    """The pressures of events: their own, else from readings, else from the blowdown law.

    Raises
    ------
    InputError
        An event that fires without any of these; a pressure that is hardly one in kPa; a date
        beyond the hydrazine table that the law goes by.
    """
    same = np.ones(len(events))
    if mission.pressure is None:
        return Tank(1.0, same, same, same, 0.0 * same, 0.0 * same, 1.0)
    law, table = mission.pressure.blowdown, mission.pressure
    recharges = [utc(fact.epoch) for fact in mission.dated if fact.what == "recharge"]
    known = np.full(len(events), np.nan)
    for i, event in enumerate(events):
        reading = event.pressure_kpa
        if reading is None:
            reading = _between_readings(table, recharges, event.epoch)
        if reading is not None:
            _require_kpa(reading, table.reference_kpa, f"{where}: event {event.id}")
            known[i] = reading
        elif not event.fires:
            known[i] = table.reference_kpa  # its pressure does not matter
        elif law is None:
            raise InputError(
                f"{where}: event {event.id}",
                "a tank pressure",
                "none: no tank_pressure_kpa, no reading before and after it, no blowdown law",
                "add it to [pressure] readings",
            )
    if law is None:
        return Tank(table.reference_kpa, known, same, same, 0.0 * same, 0.0 * same, 1.0)
    after_kpa = law.start_kpa if law.recharge_kpa is None else law.recharge_kpa
    for key, filled_kpa in (("start_kpa", law.start_kpa), ("recharge_kpa", after_kpa)):
        _require_kpa(filled_kpa, table.reference_kpa, f"{where}: pressure.blowdown.{key}")
    last = [max((at for at in recharges if at <= e.epoch), default=None) for e in events]
    used, before = np.zeros((2, len(events)))
    for place, (event, filled) in enumerate(zip(events, last, strict=True)):
        if np.isnan(known[place]):
            named = f"{where}: event {event.id}"
            used[place] = _used_kg(mission, event.epoch, named)
            if filled is not None:
                before[place] = _used_kg(mission, filled, f"{named}: the recharge before it")
    return Tank(
        reference_kpa=table.reference_kpa,
        known_kpa=known,
        start_kpa=np.array([law.start_kpa if at is None else after_kpa for at in last]),
        ullage_m3=np.full(len(events), law.ullage_m3),
        used_m3=(used - before) / law.density_kg_m3,
        refilled_m3=before / law.density_kg_m3,
        exponent=law.exponent,
    )


def _require_kpa(pressure: float, reference: float, where: str) -> None:
    """Refuse what no tank has beside the reference: one of the two is in another unit."""
    if max(pressure, reference) > LARGEST_BLOWDOWN * min(pressure, reference):
        which, psia = ("it", pressure) if pressure < reference else ("the reference", reference)
        raise InputError(
            where,
            f"a tank pressure in kPa, not far from the reference of {reference:g} kPa",
            f"{pressure:g}",
            f"if {which} is psia, write {psia * KPA_PER_PSI:.0f} kPa, else take a nearer reference",
        )


def _require_branch(mission: MissionTable, event: EventFacts, where: str) -> None:
    swaps = [fact for fact in mission.dated if fact.what == "branch_swap"]
    past = [swap for swap in swaps if utc(swap.epoch) <= event.epoch]
    if past and event.branch != past[-1].branch:
        raise InputError(
            f"{where}: event {event.id}: branch",
            f"branch {past[-1].branch}, in use since the swap of {past[-1].epoch}",
            f"branch {event.branch} on {event.epoch.date()}",
            "mend the branch or the date, or add the swap back",
        )
    if swaps and not past and event.branch == swaps[0].branch:
        raise InputError(
            f"{where}: event {event.id}: branch",
            f"another branch before the swap to {swaps[0].branch} of {swaps[0].epoch}",
            f"branch {event.branch} on {event.epoch.date()}",
            "mend the branch or a date, or add the swaps that are missing",
        )


def _require_later(asked: ForecastTable, events: Sequence[EventFacts], where: str) -> None:
    """Refuse a forecast of what was never seen, or of a date by which losses had not all set in."""
    fired = [event for event in events if event.fires]
    own = [event for event in fired if event.branch == asked.branch]
    if not own:
        branches = ", ".join(dict.fromkeys(event.branch for event in fired))
        raise InputError(
            f"{where}.branch",
            f"a branch that an event of the mission fires ({branches or 'none does'})",
            repr(asked.branch),
            "mend the branch, add an event of it, or leave the forecast out",
        )
    if utc(asked.epoch) < own[-1].epoch:
        raise InputError(
            f"{where}.epoch",
            f"a date not before the last event of branch {asked.branch}, {own[-1].id}"
            f" of {own[-1].epoch.isoformat()}",
            str(asked.epoch),
            "ask for a later date; thrusts of earlier ones are in trend.csv",
        )


def _between_readings(
    table: PressureTable, recharges: Sequence[datetime], epoch: datetime
) -> float | None:
    """The pressure between two readings (kPa), if no recharge lies between them."""
    readings = [(utc(reading.epoch), reading.kpa) for reading in table.readings]
    for at, value in readings:
        if at == epoch:
            return value
    for (start, low), (end, high) in pairwise(readings):
        if start <= epoch <= end and not any(start < at <= end for at in recharges):
            return low + (high - low) * ((epoch - start) / (end - start))
    return None


def _used_kg(mission: MissionTable, epoch: Epoch, where: str) -> float:
    """Hydrazine used by an epoch, linear between entries; beyond them it is refused."""
    assert mission.propellant is not None  # a mission file with a law or a drift has it
    table, moment = mission.propellant.used, utc(epoch)
    at = [utc(entry.epoch) for entry in table]
    if not at[0] <= moment <= at[-1]:
        raise InputError(
            where,
            f"a date from {table[0].epoch} to {table[-1].epoch}, of which [propellant] used tells"
            " the hydrazine that the blowdown law or [drift] goes by",
            moment.isoformat(),
            f"add an entry {'before' if moment < at[0] else 'after'} it",
        )
    used = [entry.kg for entry in table]
    return float(np.interp(moment.timestamp(), [t.timestamp() for t in at], used))
