"""The mission file (TOML): events, dated facts, tank pressure, and what is asked of the trend."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime, time
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from cassini_bayes.errors import InputError
from cassini_bayes.events.settings import EventsTable
from cassini_bayes.files.checks import in_utc
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.files.validated import Table, validated
from cassini_bayes.spacecraft.pulses import shape_named
from cassini_bayes.spacecraft.units import YEAR_S


def _within_calendar(epoch: datetime | date) -> datetime | date:
    """Refuse a time whose zone leads beyond the years 1 to 9999."""
    if isinstance(epoch, datetime) and in_utc(epoch) is None:
        raise ValueError("an epoch within the years 1 to 9999 in UTC")
    return epoch


def _share(loss: float) -> float:
    """Refuse a loss that is no share of thrust: 2 for per cent is a likely slip."""
    if not 0.0 < loss < 1.0:
        raise ValueError("a share above 0 and below 1, such as 0.05 for 5 %")
    return loss


Epoch = Annotated[datetime | date, AfterValidator(_within_calendar)]
What = Literal["recharge", "branch_swap", "separation", "burn", "articulation"]


class ChangeTable(Table):
    """Change of a parameter: normal with ``loc`` and ``scale`` (0: known), in the given unit."""

    loc: float
    scale: float = Field(ge=0.0)
    unit: str
    source: str


class DatedTable(Table):
    """``[[dated]]``: a fact that changes something from its epoch on."""

    epoch: Epoch
    what: What
    source: str = Field(min_length=1)
    branch: str | None = None
    change: dict[str, ChangeTable] = Field(default_factory=dict)


class ReadingTable(Table):
    """``{ epoch = 2005-01-01, kpa = 1758.0 }``: a tank pressure."""

    epoch: Epoch
    kpa: float = Field(gt=0.0)


class UsedTable(Table):
    """``{ epoch = 2005-01-01, kg = 60.0 }``: hydrazine used by then."""

    epoch: Epoch
    kg: float = Field(ge=0.0)


class BlowdownTable(Table):
    """``[pressure.blowdown]``: gas that expands as hydrazine leaves, p Vⁿ = constant.

    ``ullage_m3`` is the gas volume at ``start_kpa``, when nothing of ``[propellant]`` is used. A
    recharge starts the law anew with its own ``recharge_kpa``.
    """

    start_kpa: float = Field(gt=0.0)
    ullage_m3: float = Field(gt=0.0)
    density_kg_m3: float = Field(gt=0.0)
    exponent: float = Field(1.0, ge=1.0, le=1.67)
    recharge_kpa: float | None = Field(None, gt=0.0)


class PressureTable(Table):
    """``[pressure]``: where the tank pressure of an event comes from.

    Without the table all events are at one pressure, and the drift of thrust stands for what
    pressure does. In this order: its own telemetry, readings of this table (linear in between,
    never across a recharge), the blowdown law.
    """

    reference_kpa: float = Field(gt=0.0)
    readings: list[ReadingTable] = Field(default_factory=list)
    blowdown: BlowdownTable | None = None


class PropellantTable(Table):
    """``[propellant]``: hydrazine used by an epoch, kg.

    ``computed`` says that it was computed from thrust and on-times: it then repeats an assumed
    thrust, so its factor is a parameter of the mission (``hydrazine_used_factor``).
    """

    used: list[UsedTable] = Field(min_length=1)
    computed: bool = False


class ForecastTable(Table):
    """``[[trend.forecast]]``: a date and pressure for which thrusts are asked."""

    epoch: Epoch
    branch: str
    pressure_kpa: float = Field(gt=0.0)


class TrendTable(Table):
    """``[trend]``: what the trend reports, and with how many draws."""

    reference_epoch: Epoch
    degraded: list[Annotated[float, AfterValidator(_share)]] = Field(
        default_factory=lambda: [0.02, 0.05, 0.10]
    )
    alarm: float = Field(0.95, gt=0.5, lt=1.0)
    forecast: list[ForecastTable] = Field(default_factory=list)
    draws: int = Field(400, ge=100, le=100_000)  # more is a slip of some zeros
    proposals: int = Field(4_000, ge=500, le=1_000_000)
    seed: int = Field(2012, ge=0)


class SpacecraftTable(Table):
    """``[spacecraft]``: for the reader; the priors file decides."""

    name: str | None = Field(None, min_length=1)


class MissionTable(EventsTable):
    """A mission file with every default filled in; paths are relative to it."""

    pulse_shape: str = "first_order"
    spacecraft: SpacecraftTable = SpacecraftTable()
    dated: list[DatedTable] = Field(default_factory=list)
    drift: dict[str, ChangeTable] = Field(default_factory=dict)
    pressure: PressureTable | None = None
    propellant: PropellantTable | None = None
    trend: TrendTable


def utc(epoch: Epoch) -> datetime:
    """An epoch of a TOML file as a moment; a day starts at 00:00 UTC."""
    if not isinstance(epoch, datetime):
        return datetime.combine(epoch, time(), tzinfo=UTC)
    return epoch.replace(tzinfo=UTC) if epoch.tzinfo is None else epoch.astimezone(UTC)


def years_between(start: Epoch, end: Epoch) -> float:
    """Time from one epoch to another in years of 365.25 days."""
    return (utc(end) - utc(start)).total_seconds() / YEAR_S


def read_mission_file(path: Path) -> MissionTable:
    """Read and check a mission file.

    Raises
    ------
    InputError
        As :func:`validated`; dated facts or readings out of order; a swap without its branch, or to
        the branch in use; a parameter that two facts change at one moment; a blowdown law or a
        drift without the hydrazine used; a recharge with a law that does not know the pressure
        after it.
    """
    return check_mission(read_toml(path, "a mission file"), str(path))


def check_mission(table: Mapping[str, object], where: str) -> MissionTable:
    """Check the table of a mission file.

    Raises
    ------
    InputError
        As :func:`read_mission_file`.
    """
    mission = validated(MissionTable, table, where)
    _require_order(f"{where}: dated", [fact.epoch for fact in mission.dated])
    readings = [] if mission.pressure is None else mission.pressure.readings
    _require_order(f"{where}: pressure.readings", [reading.epoch for reading in readings])
    if mission.propellant is not None:
        used = [entry.kg for entry in mission.propellant.used]
        _require_order(f"{where}: propellant.used", [e.epoch for e in mission.propellant.used])
        if any(b < a for a, b in pairwise(used)):
            raise InputError(
                f"{where}: propellant.used",
                "masses used so far, which never fall",
                str(used),
                "give the hydrazine used since launch, not what is left",
            )
    _require_branches(mission.dated, where)
    _refuse_changed_twice(mission.dated, where)
    shape_named(mission.pulse_shape, f"{where}: pulse_shape")
    law = None if mission.pressure is None else mission.pressure.blowdown
    for what, is_there in (("the blowdown law", law is not None), ("[drift]", bool(mission.drift))):
        if is_there and mission.propellant is None:
            raise InputError(
                f"{where}: propellant",
                f"the hydrazine used, which {what} needs",
                "no such table",
                "add [propellant] with used",
            )
    recharges = [fact for fact in mission.dated if fact.what == "recharge"]
    if law is not None and recharges and law.recharge_kpa is None:
        raise InputError(
            f"{where}: pressure.blowdown.recharge_kpa",
            f"the pressure after the recharge of {recharges[0].epoch}",
            "nothing",
            "add recharge_kpa",
        )
    return mission


def _require_branches(dated: Sequence[DatedTable], where: str) -> None:
    """Refuse a swap without its branch, and one to the branch that the swap before it led to."""
    in_use: DatedTable | None = None
    for place, fact in enumerate(dated, start=1):
        if fact.what != "branch_swap":
            continue
        if fact.branch is None:
            raise InputError(
                f"{where}: dated[{place}].branch",
                "the branch in use from then on",
                "nothing",
                'add branch = "B"',
            )
        if in_use is not None and fact.branch == in_use.branch:
            raise InputError(
                f"{where}: dated[{place}].branch",
                f"another branch than {in_use.branch}, in use since the swap of {in_use.epoch}",
                f"{fact.branch} again, on {fact.epoch}",
                "mend the branch or the date, or add the swap back between them",
            )
        in_use = fact


def _refuse_changed_twice(dated: Sequence[DatedTable], where: str) -> None:
    """Refuse a parameter that two facts change at one moment: they would be one change, twice."""
    seen: set[tuple[datetime, str]] = set()
    for place, fact in enumerate(dated, start=1):
        for name in fact.change:
            if (utc(fact.epoch), name) in seen:
                raise InputError(
                    f"{where}: dated[{place}].change.{name}",
                    f"one change of {name} at one moment",
                    f"another by an earlier fact, at {fact.epoch}",
                    "write their sum in one of them, or give the facts their times of day",
                )
            seen.add((utc(fact.epoch), name))


def _require_order(where: str, epochs: list[Epoch]) -> None:
    for place, (before, after) in enumerate(pairwise(epochs), start=2):
        if utc(after) < utc(before):
            raise InputError(
                f"{where}[{place}]",
                f"an epoch not before {before}",
                str(after),
                "put them in order of time, or mend the date",
            )
