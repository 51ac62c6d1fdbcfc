"""Tables and tensors of papers 000, 002 and 003 as typed records."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
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


@dataclass(frozen=True)
class Row:
    """Cells of one row of a file by column."""

    file: str
    cells: Mapping[str, str]

    def __getitem__(self, column: str) -> str:
        """The text of a cell."""
        return self.cells[column]

    def figure(self, column: str, *, zero_is_exact: bool = False) -> Printed:
        """The printed figure of a cell; a bare 0 may be exact."""
        exact = zero_is_exact and self[column] == "0"
        return parse_printed(self[column], where=f"{self.file}: {column}", exact=exact)

    def figure_or_none(self, column: str, *, zero_is_exact: bool = False) -> Printed | None:
        """The same; None of an empty cell."""
        return self.figure(column, zero_is_exact=zero_is_exact) if self[column] else None


def records(
    file: str, text: str | None, columns: Sequence[str], build: Callable[[Row], Record]
) -> tuple[Record, ...]:
    """Records of a file of this package, or of a text in its place.

    Raises
    ------
    InputError
        A wrong header or figure, or a row with another number of cells.
    """
    text = package_text(file) if text is None else text
    return tuple(build(Row(file, cells)) for cells in csv_rows(text, columns, where=file))


def day_of(year: int, day_of_year: int) -> datetime.date:
    """The date of a day of a year, from 1."""
    return datetime.date(year, 1, 1) + datetime.timedelta(days=day_of_year - 1)


def inertia_tensors(text: str | None = None) -> tuple[InertiaTensor, ...]:
    """Inertia tensors of 2000-03-15 (paper 000 eqs. 1 and 8, paper 002 eqs. 1 and 4)."""
    figures = {element: f"inertia_{element}_kg_m2" for element in ELEMENTS}

    def build(row: Row) -> InertiaTensor:
        elements = {element: row.figure(column) for element, column in figures.items()}
        date = datetime.date.fromisoformat(row["date"])
        known = MappingProxyType(elements)
        return InertiaTensor(row["paper"], row["equation"], date, row["kind"], known)

    columns = ("paper", "equation", "date", "kind", *figures.values())
    return records("inertia_tensors.csv", text, columns, build)


def inertia_comparisons(text: str | None = None) -> tuple[InertiaComparison, ...]:
    """Paper 000 Table 1; a bare 0 % is exact."""

    def build(row: Row) -> InertiaComparison:
        return InertiaComparison(
            row["window"],
            day_of(int(row["slew_year"]), int(row["slew_day_of_year"])),
            row["element"],
            row.figure("predicted_kg_m2"),
            row.figure("estimated_kg_m2"),
            row.figure_or_none("error_percent", zero_is_exact=True),
            row.figure_or_none("error_kg_m2"),
        )

    names = [field.name for field in fields(InertiaComparison) if field.name != "slew_day"]
    columns = (names[0], "slew_year", "slew_day_of_year", *names[1:])
    return records("inertia_000_table_1.csv", text, columns, build)


def bias_thrusts(text: str | None = None) -> tuple[BiasThrust, ...]:
    """Paper 000 Table 2."""
    day, *figures = (field.name for field in fields(BiasThrust))
    return records(
        "thrust_000_table_2.csv",
        text,
        (day, *figures),
        lambda row: BiasThrust(int(row[day]), *map(row.figure, figures)),
    )


def day_28_pulses(text: str | None = None) -> tuple[ThrusterPulses, ...]:
    """On-times and mean pulse sizes of the bias of day 28 (paper 000 section V)."""
    name, *figures = (field.name for field in fields(ThrusterPulses))
    return records(
        "pulses_000_day_28.csv",
        text,
        (name, *figures),
        lambda row: ThrusterPulses(row[name], *map(row.figure, figures)),
    )


def torque_estimates(text: str | None = None) -> tuple[TorqueEstimate, ...]:
    """Paper 000 Table A1; a bare 0 is exact."""
    figures = {axis: f"torque_{axis}_micro_n_m" for axis in AXES}

    def build(row: Row) -> TorqueEstimate:
        torque = {axis: row.figure(name, zero_is_exact=True) for axis, name in figures.items()}
        return TorqueEstimate(row["source"], MappingProxyType(torque))

    return records("torque_000_table_a1.csv", text, ("source", *figures.values()), build)


def a_branch_thrusts(text: str | None = None) -> tuple[ThrustComparison, ...]:
    """Paper 003 Table 1: A branch at the swap of March 2009, against navigation."""
    return _thrust_comparisons("thrust_003_table_1.csv", text, "navigation_n")


def b_branch_thrusts(text: str | None = None) -> tuple[ThrustComparison, ...]:
    """Paper 003 Table 2: B branch in 2012, against flight software."""
    return _thrust_comparisons("thrust_003_table_2.csv", text, "flight_software_n")


def _thrust_comparisons(file: str, text: str | None, other: str) -> tuple[ThrustComparison, ...]:
    """Thrusts against those of a column; a bare 0 % is exact."""
    name, study, share = "thruster", "this_study_n", "difference_percent"

    def build(row: Row) -> ThrustComparison:
        percent = row.figure_or_none(share, zero_is_exact=True)
        return ThrustComparison(row[name], row.figure(study), row.figure_or_none(other), percent)

    return records(file, text, (name, study, other, share), build)


def perturbations() -> tuple[Perturbation, ...]:
    """Assumed parameter errors of paper 003 section IV."""
    quantity, elements, error = (field.name for field in fields(Perturbation))
    return records(
        "perturbations_003.csv",
        None,
        (quantity, elements, error),
        lambda row: Perturbation(
            row[quantity], tuple(row[elements].split()), row.figure(error).value
        ),
    )
