"""Tables and tensors of papers 000, 002 and 003 as typed records."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, TypeVar

from cassini_bayes.published.printed import Printed, csv_rows, package_text, parse_printed

AXES: Final = ("x", "y", "z")
ELEMENTS: Final = tuple(f"{a}{b}" for a in AXES for b in AXES)


@dataclass(frozen=True)
class InertiaTensor:
    """Printed inertia tensor (kg m²), body axes, matrix elements; paper 000 eqs. 1, 8, 002 1, 4.

    ``elements`` maps ``xx`` … ``zz`` (all nine) to the figure; ``kind`` is ``predicted`` (sum of
    components) or ``estimated`` (flight).
    """

    paper: str
    equation: str
    date: datetime.date
    kind: str
    elements: Mapping[str, Printed]


@dataclass(frozen=True)
class InertiaComparison:
    """One cell triple of paper 000 Table 1 (kg m²).

    ``window`` is ``pre_soi``, ``post_prm`` or ``post_probe``; ``slew_day`` the day of the slews
    (captions of Appendix B). The error is in percent of the prediction for moments, in kg m² for
    products.
    """

    window: str
    slew_day: datetime.date
    element: str
    predicted_kg_m2: Printed
    estimated_kg_m2: Printed
    error_percent: Printed | None
    error_kg_m2: Printed | None


@dataclass(frozen=True)
class BiasThrust:
    """One row of paper 000 Table 2: thrust (N) from one wheel bias, wheel rates in rpm.

    The printed header says RWA-1, 2 and 3 and days of 2004; both contradict the text (see
    ``docs/reference/published-data.md``).
    """

    day_of_year: int
    rwa1_rpm: Printed
    rwa2_rpm: Printed
    rwa3_rpm: Printed
    predicted_n: Printed
    unadjusted_n: Printed
    adjusted_tau_decay_65_ms_n: Printed
    adjusted_tau_decay_40_ms_n: Printed


@dataclass(frozen=True)
class ThrusterPulses:
    """On-time and mean pulse size of one thruster on day 28 (paper 000 section V)."""

    thruster: str
    on_time_s: Printed
    mean_pulse_ms: Printed


@dataclass(frozen=True)
class TorqueEstimate:
    """One row of paper 000 Table A1: torque in µN m along body axes."""

    source: str
    torque_micro_n_m: Mapping[str, Printed]


@dataclass(frozen=True)
class ThrustComparison:
    """One row of paper 003 Table 1 or 2 (N, percent); None where the table says N/A.

    ``other_n`` is the navigation team's figure (Table 1) or the flight software's (Table 2).
    """

    thruster: str
    this_study_n: Printed
    other_n: Printed | None
    difference_percent: Printed | None


@dataclass(frozen=True)
class Perturbation:
    """One assumed error of the list of paper 003 section IV, in percent."""

    quantity: str
    elements: tuple[str, ...]
    error_percent: float


Record = TypeVar("Record")


def _read(
    text: str, columns: Sequence[str], where: str, build: Callable[[Mapping[str, str]], Record]
) -> tuple[Record, ...]:
    return tuple(build(MappingProxyType(row)) for row in csv_rows(text, columns, where=where))


def _figure(row: Mapping[str, str], column: str, where: str) -> Printed:
    return parse_printed(row[column], where=f"{where}: {column}")


def _figure_or_none(
    row: Mapping[str, str], column: str, where: str, *, zero_is_exact: bool
) -> Printed | None:
    if not row[column]:
        return None
    exact = zero_is_exact and row[column] == "0"
    return parse_printed(row[column], where=f"{where}: {column}", exact=exact)


def parse_inertia_tensors(text: str) -> tuple[InertiaTensor, ...]:
    """Build the records of ``inertia_tensors.csv``; InputError for a wrong header or figure."""
    where = "inertia_tensors.csv"
    columns = ("paper", "equation", "date", "kind", *(f"inertia_{e}_kg_m2" for e in ELEMENTS))
    return _read(
        text,
        columns,
        where,
        lambda row: InertiaTensor(
            row["paper"],
            row["equation"],
            datetime.date.fromisoformat(row["date"]),
            row["kind"],
            MappingProxyType({e: _figure(row, f"inertia_{e}_kg_m2", where) for e in ELEMENTS}),
        ),
    )


def parse_inertia_comparisons(text: str) -> tuple[InertiaComparison, ...]:
    """Build the records of ``inertia_000_table_1.csv``; a bare 0 % is exact."""
    where = "inertia_000_table_1.csv"
    columns = (
        "window",
        "slew_year",
        "slew_day_of_year",
        "element",
        "predicted_kg_m2",
        "estimated_kg_m2",
        "error_percent",
        "error_kg_m2",
    )
    return _read(
        text,
        columns,
        where,
        lambda row: InertiaComparison(
            row["window"],
            datetime.date(int(row["slew_year"]), 1, 1)
            + datetime.timedelta(days=int(row["slew_day_of_year"]) - 1),
            row["element"],
            _figure(row, "predicted_kg_m2", where),
            _figure(row, "estimated_kg_m2", where),
            _figure_or_none(row, "error_percent", where, zero_is_exact=True),
            _figure_or_none(row, "error_kg_m2", where, zero_is_exact=False),
        ),
    )


def parse_bias_thrusts(text: str) -> tuple[BiasThrust, ...]:
    """Build the records of ``thrust_000_table_2.csv``."""
    where = "thrust_000_table_2.csv"
    figures = (
        "rwa1_rpm",
        "rwa2_rpm",
        "rwa3_rpm",
        "predicted_n",
        "unadjusted_n",
        "adjusted_tau_decay_65_ms_n",
        "adjusted_tau_decay_40_ms_n",
    )
    return _read(
        text,
        ("day_of_year", *figures),
        where,
        lambda row: BiasThrust(
            int(row["day_of_year"]), *(_figure(row, name, where) for name in figures)
        ),
    )


def parse_day_28_pulses(text: str) -> tuple[ThrusterPulses, ...]:
    """Build the records of ``pulses_000_day_28.csv``."""
    where = "pulses_000_day_28.csv"
    return _read(
        text,
        ("thruster", "on_time_s", "mean_pulse_ms"),
        where,
        lambda row: ThrusterPulses(
            row["thruster"],
            _figure(row, "on_time_s", where),
            _figure(row, "mean_pulse_ms", where),
        ),
    )


def parse_torques(text: str) -> tuple[TorqueEstimate, ...]:
    """Build the records of ``torque_000_table_a1.csv``; a bare 0 is exact."""
    where = "torque_000_table_a1.csv"
    return _read(
        text,
        ("source", *(f"torque_{axis}_micro_n_m" for axis in AXES)),
        where,
        lambda row: TorqueEstimate(
            row["source"],
            MappingProxyType(
                {
                    axis: parse_printed(
                        row[f"torque_{axis}_micro_n_m"],
                        where=f"{where}: {axis}",
                        exact=row[f"torque_{axis}_micro_n_m"] == "0",
                    )
                    for axis in AXES
                }
            ),
        ),
    )


def parse_thrust_comparisons(text: str, other: str, where: str) -> tuple[ThrustComparison, ...]:
    """Build the records of paper 003 Table 1 (``other`` navigation) or 2 (flight_software).

    A bare 0 % is exact.
    """
    return _read(
        text,
        ("thruster", "this_study_n", f"{other}_n", "difference_percent"),
        where,
        lambda row: ThrustComparison(
            row["thruster"],
            _figure(row, "this_study_n", where),
            _figure_or_none(row, f"{other}_n", where, zero_is_exact=False),
            _figure_or_none(row, "difference_percent", where, zero_is_exact=True),
        ),
    )


def parse_perturbations(text: str) -> tuple[Perturbation, ...]:
    """Build the records of ``perturbations_003.csv``."""
    where = "perturbations_003.csv"
    return _read(
        text,
        ("quantity", "elements", "error_percent"),
        where,
        lambda row: Perturbation(
            row["quantity"],
            tuple(row["elements"].split()),
            _figure(row, "error_percent", where).value,
        ),
    )


def inertia_tensors() -> tuple[InertiaTensor, ...]:
    """Inertia tensors of 2000-03-15 (paper 000 eqs. 1 and 8, paper 002 eqs. 1 and 4)."""
    return parse_inertia_tensors(package_text("inertia_tensors.csv"))


def inertia_comparisons() -> tuple[InertiaComparison, ...]:
    """Paper 000 Table 1."""
    return parse_inertia_comparisons(package_text("inertia_000_table_1.csv"))


def bias_thrusts() -> tuple[BiasThrust, ...]:
    """Paper 000 Table 2."""
    return parse_bias_thrusts(package_text("thrust_000_table_2.csv"))


def day_28_pulses() -> tuple[ThrusterPulses, ...]:
    """On-times and mean pulse sizes of the bias of day 28 (paper 000 section V)."""
    return parse_day_28_pulses(package_text("pulses_000_day_28.csv"))


def torque_estimates() -> tuple[TorqueEstimate, ...]:
    """Paper 000 Table A1."""
    return parse_torques(package_text("torque_000_table_a1.csv"))


def a_branch_thrusts() -> tuple[ThrustComparison, ...]:
    """Paper 003 Table 1: A branch at the swap of March 2009, against navigation."""
    name = "thrust_003_table_1.csv"
    return parse_thrust_comparisons(package_text(name), "navigation", name)


def b_branch_thrusts() -> tuple[ThrustComparison, ...]:
    """Paper 003 Table 2: B branch in 2012, against flight software."""
    name = "thrust_003_table_2.csv"
    return parse_thrust_comparisons(package_text(name), "flight_software", name)


def perturbations() -> tuple[Perturbation, ...]:
    """Assumed parameter errors of paper 003 section IV."""
    return parse_perturbations(package_text("perturbations_003.csv"))
