"""The effects that there are, and what is believed before the data of none, a cause, unknown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

from cassini_bayes.balance.statistics import ExtraColumn
from cassini_bayes.effects import (
    center_of_mass,
    external_torque,
    firing_logic,
    flexible_mode,
    inertia,
    pulse_shape,
    rate_bias,
    rate_scale,
    tail_off,
    thrust_scale,
    thrust_warmup,
    thruster_degraded,
    thruster_leak,
    thruster_misalignment,
    time_offset,
    wheel_alignment,
    wheel_articulation,
    wheel_inertia,
)
from cassini_bayes.effects.effect import Kind, columns_of
from cassini_bayes.effects.tables import CHANGEABLE, Place, Table, check_keys, read_table
from cassini_bayes.effects.user_files import load_kind
from cassini_bayes.effects.wording import Sizes, by_keys
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import finite_number
from cassini_bayes.files.storage import digest
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.priors.distributions import Distribution

FOLDER: Final = Path(__file__).parent
CAUSES: Final = FOLDER / "causes.toml"
WHAT: Final = "a table of effects"
KINDS: Final[tuple[Kind, ...]] = (
    thrust_scale.KIND,
    thruster_degraded.KIND,
    thrust_warmup.KIND,
    tail_off.KIND,
    pulse_shape.KIND,
    center_of_mass.KIND,
    wheel_inertia.KIND,
    wheel_alignment.KIND,
    wheel_articulation.KIND,
    thruster_misalignment.KIND,
    external_torque.KIND,
    thruster_leak.KIND,
    inertia.KIND,
    time_offset.KIND,
    rate_bias.KIND,
    rate_scale.KIND,
    flexible_mode.KIND,
    firing_logic.KIND,
)


@dataclass(frozen=True)
class Odds:
    """Prior probabilities of no cause, of all catalogued causes together, of something else.

    ``throughout`` is that of a cause to act in all events and not from a later one on.
    """

    none: float
    catalogued: float
    unknown: float
    throughout: float = 1.0

    def of_causes(self, kinds: Sequence[str]) -> list[float]:
        """Probability of every cause, of these kinds: kinds share alike, and a kind's targets."""
        of_kind = self.catalogued / len(set(kinds)) if kinds else 0.0
        return [of_kind / kinds.count(kind) for kind in kinds]

    def of_onsets(self, events: int) -> tuple[float, ...]:
        """Probabilities that a cause acts from the first, second, … of some events on."""
        if events < 2:
            return (1.0,)
        return (self.throughout, *(events - 1) * ((1.0 - self.throughout) / (events - 1),))


@dataclass(frozen=True)
class Unknown:
    """What ``unknown`` believes of the discrepancy.

    Momentum wanders with ``torque_noise`` (N m s^½); hold rates are ``hold_rate_factor`` times
    those of the priors file within a factor of exp(``hold_rate_log_sd``); printed thrusts are off
    by a fraction ``estimate_sd``, printed on-times by ``on_time_noise`` (s), each on its own. Of
    the forms that go with thrusters ``thrust_drift`` (a share of the thrust) and ``lever_m`` are
    the least and the most.
    """

    torque_noise: Distribution
    hold_rate_factor: float
    hold_rate_log_sd: float
    estimate_sd: float
    on_time_noise: Distribution
    thrust_drift: tuple[float, float]
    lever_m: tuple[float, float]


@dataclass(frozen=True)
class Kinds:
    """Kinds of effect, each with its table, and what is believed before the data.

    ``files`` are those that a user has brought, by SHA-256.
    """

    kinds: tuple[tuple[Kind, Table], ...]
    odds: Odds
    unknown: Unknown
    files: Mapping[str, str] = field(default_factory=dict)

    def columns(self, thrusters: Sequence[str]) -> tuple[ExtraColumn, ...]:
        """Every column that some kind of effect on telemetry needs."""
        shown = (kind for kind, table in self.kinds if "telemetry" in table.inputs)
        return columns_of(shown, thrusters)

    def separation(self, one: str, other: str) -> str | None:
        """The measurement that separates two kinds, in words; None where neither names one."""
        said = {kind.name: kind.separation for kind, _ in self.kinds}
        return said.get(one, {}).get(other) or said.get(other, {}).get(one)

    def unit(self, name: str, key: str) -> str:
        """Unit of a size of a cause; empty where no table has it, as of sizes that are reported."""
        return self._units(name).get(key, "")

    def says(self, name: str, sizes: Sizes) -> str:
        """What the sizes of a cause mean, as a clause; its own sizes alone are said."""
        kind_name, _, target = name.partition(":")
        kind = next((kind for kind, _ in self.kinds if kind.name == kind_name), None)
        if kind is None:
            return by_keys(name, sizes)
        keys = kind.reported or tuple(self._units(name))
        if kind.says is None or not set(keys) <= set(sizes):
            return by_keys(name, sizes)
        return kind.says({key: sizes[key] for key in keys}, target)

    def _units(self, name: str) -> dict[str, str]:
        """Units by key of a cause's parameters."""
        kind_name, _, target = name.partition(":")
        return {
            parameter.key.replace("{target}", target): parameter.unit
            for kind, table in self.kinds
            if kind.name == kind_name
            for parameter in table.parameters
        }


@cache
def standard() -> Kinds:
    """The effects of this package."""
    return read_kinds(())


def read_kinds(files: Sequence[Path]) -> Kinds:
    """The effects of this package, with those of a user and with other tables.

    Parameters
    ----------
    files
        Python files that end with ``KIND = Kind(...)``, each with its table of the same name beside
        it, and TOML files with other ``[effects.<kind>]``, ``[causes]`` or ``[unknown]``, of which
        only what they say is changed.

    Raises
    ------
    InputError
        A file that is neither, or a mistake in one: file and line or dotted key are named.
    """
    kinds = {kind.name: kind for kind in KINDS}
    tables = {name: _with_place(FOLDER / f"{name}.toml") for name in kinds}
    beliefs = read_toml(CAUSES, WHAT)
    places = {key: Place(CAUSES, (key,)) for key in beliefs}
    for path in files:
        if path.suffix == ".py":
            kind = load_kind(path)
            kinds[kind.name], tables[kind.name] = kind, _with_place(path.with_suffix(".toml"))
        elif path.suffix != ".toml":
            raise InputError(
                str(path), "a .py or .toml file of effects", repr(path.name), "name one"
            )
    for path in files:
        if path.suffix == ".toml":
            changed, whole = _with_place(path)
            check_keys(changed, ("effects", *beliefs), whole)
            for key in [key for key in beliefs if key in changed]:
                places[key] = whole / key
                check_keys(changed[key], beliefs[key], places[key])
                beliefs[key] = {**beliefs[key], **changed[key]}
            check_keys(changed.get("effects", {}), kinds, whole / "effects")
            for name, table in changed.get("effects", {}).items():
                place, (known, _) = whole / "effects" / name, tables[name]
                check_keys(table, CHANGEABLE, place)
                parameters = read_table(known, tables[name][1]).parameters
                keys = [parameter.key for parameter in parameters]
                check_keys(table.get("parameters", {}), keys, place / "parameters")
                tables[name] = (merged(known, table), place)
    return Kinds(
        tuple((kind, _table_of(kind, *tables[name])) for name, kind in kinds.items()),
        _odds(beliefs["causes"], places["causes"]),
        _unknown(beliefs["unknown"], places["unknown"]),
        {
            str(path): digest(path)
            for table in files
            for path in dict.fromkeys((table, table.with_suffix(".toml")))
        },
    )


def merged(table: Mapping[str, Any], changed: Mapping[str, Any]) -> dict[str, Any]:
    """A table updated by another: key by key, parameters one by one."""
    parameters = {**table["parameters"], **changed.get("parameters", {})}
    return {**table, **changed, "parameters": parameters}


def _positive(where: Place, value: object) -> float:
    number = finite_number(str(where), value)
    if number <= 0.0:
        raise InputError(str(where), "a positive number", f"{number:g}", "change it")
    return number


def _with_place(path: Path) -> tuple[dict[str, Any], Place]:
    return read_toml(path, WHAT), Place(path)


def _table_of(kind: Kind, document: Mapping[str, Any], where: Place) -> Table:
    table = read_table(document, where)
    if "estimates" in table.inputs and kind.doubt is None:
        raise InputError(
            str(where / "inputs"),
            f"inputs that {kind.name} can show in",
            "'estimates', of which it has no doubt(printed, width)",
            "leave it out, or write that function",
        )
    return table


def _odds(causes: Mapping[str, Any], where: Place) -> Odds:
    none, catalogued, unknown = (
        finite_number(str(where / key), causes[key]) for key in ("none", "catalogued", "unknown")
    )
    total = none + catalogued + unknown
    if min(none, catalogued, unknown) <= 0.0 or not math.isclose(total, 1.0):
        raise InputError(
            str(where), "three probabilities that add up to 1", f"{total:g}", "mend the table"
        )
    throughout = finite_number(str(where / "throughout"), causes["throughout"])
    if not 0.0 < throughout <= 1.0:
        raise InputError(
            str(where / "throughout"),
            "a probability above 0",
            f"{throughout:g}",
            "give 1 where no cause may begin later than the first event",
        )
    return Odds(none, catalogued, unknown, throughout)


def _unknown(unknown: Mapping[str, Any], where: Place) -> Unknown:
    values = {k: _positive(where / k, v) for k, v in unknown.items() if k != "source"}

    def about(median: str, log_sd: str) -> Distribution:
        return Distribution("lognorm", {"s": values[log_sd], "scale": values[median]})

    return Unknown(
        about("torque_noise_median_n_m_s05", "torque_noise_log_sd"),
        values["hold_rate_factor"],
        values["hold_rate_log_sd"],
        values["estimate_sd"],
        about("on_time_noise_median_s", "on_time_noise_log_sd"),
        _ordered(values, "thrust_drift_least", "thrust_drift_most", where),
        _ordered(values, "lever_least_m", "lever_most_m", where),
    )


def _ordered(
    values: Mapping[str, float], least: str, most: str, where: Place
) -> tuple[float, float]:
    if not values[least] < values[most]:
        raise InputError(
            str(where / most),
            f"more than {least}",
            f"{values[most]:g} and {values[least]:g}",
            "mend the table",
        )
    return values[least], values[most]
