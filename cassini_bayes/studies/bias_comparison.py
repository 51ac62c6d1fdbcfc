"""The eight flight biases of paper 001, simulated, beside the four columns of its tables.

A simulated event is reduced to the rows of those tables: on-time and pulses of every thruster or
pair, computed ΔV along Z, hydrazine. Differences to flight then say how good the simulation is, and
which settings of its controller the flight data support.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.published import WheelBiasTable
from cassini_bayes.simulation import (
    Motion,
    Plan,
    ScenarioFile,
    hydrazine_g,
    make_plan,
    simulate_plan,
)
from cassini_bayes.simulation.telemetry import computed_delta_v_m_s
from cassini_bayes.studies.scenario import draw_truth

FIRST_OF_PAIR: Final[Mapping[str, str]] = {"y1_y3": "y1", "y2_y4": "y2"}
UNITS: Final = ("y1_y3", "y2_y4", "z1", "z2", "z3", "z4")
ROWS: Final = (
    *(f"on_time_{unit}" for unit in UNITS),
    *(f"pulses_{unit}" for unit in UNITS),
    "delta_v_z",
    "hydrazine",
)
KINDS: Final = ("on_time", "pulses", "delta_v_z", "hydrazine")
PRINTED: Final = ("ideal", "calibrated", "fsds", "flight")


@dataclass(frozen=True, eq=False)
class Comparison:
    """Simulated rows of every event: ``values[event]`` is (seeds, rows of :data:`ROWS`)."""

    tables: tuple[WheelBiasTable, ...]
    values: Mapping[str, Array]

    def mean(self, event: str) -> Array:
        """Mean over seeds (rows,)."""
        return np.asarray(self.values[event].mean(axis=0))

    def spread(self, event: str) -> Array:
        """Standard deviation over seeds (rows,); 0 for a single seed."""
        values = self.values[event]
        return np.asarray(values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(len(ROWS)))

    def column(self, column: str) -> Array:
        """A printed column of all events, or ``simulation``: (events, seeds or 1, rows)."""
        if column == "simulation":
            return np.array([self.values[table.event] for table in self.tables])
        return np.array([[printed_rows(table, column)] for table in self.tables])


def table_rows(plan: Plan, motion: Motion) -> Array:
    """An event as the rows of :data:`ROWS`: s, counts, mm/s, g."""
    names = [FIRST_OF_PAIR.get(unit, unit) for unit in UNITS]
    on_time = [float(motion.pulses[name].width_s.sum()) for name in names]
    pulses = [float(motion.pulses[name].width_s.size) for name in names]
    delta_v = computed_delta_v_m_s(plan, motion, np.array([motion.duration_s]))[0, 2]
    return np.array([*on_time, *pulses, 1e3 * delta_v, hydrazine_g(plan, motion)])


def simulate_biases(
    file: ScenarioFile, tables: Iterable[WheelBiasTable], seeds: Iterable[int]
) -> Comparison:
    """Simulate the scenario's events for every seed."""
    scenario = file.scenario
    rows: dict[str, list[Array]] = {event.id: [] for event in scenario.event}
    for seed in seeds:
        truth = draw_truth(file, seed)
        for event in scenario.event:
            plan = make_plan(scenario, file.spacecraft, event, truth)
            done = simulate_plan(plan, scenario, seed)
            rows[event.id].append(table_rows(plan, done.motion))
    return Comparison(tuple(tables), {event: np.array(result) for event, result in rows.items()})


def printed_rows(table: WheelBiasTable, column: str) -> Array:
    """A printed column as the rows of :data:`ROWS`; NaN where the table has a dash."""
    cells = [table.get(row, column) for row in ROWS]
    return np.array([np.nan if cell is None else cell.value for cell in cells])


def mean_absolute_differences(comparison: Comparison, column: str) -> dict[str, float]:
    """Mean |column − flight| by kind of row, over events (and seeds for ``simulation``).

    A pair counts once. As paper 001 averages: every thruster or pair of every event alike.
    """
    difference = np.abs(comparison.column(column) - comparison.column("flight"))
    of_kind = {kind: [row.startswith(kind) for row in ROWS] for kind in KINDS}
    return {kind: float(difference[..., rows].mean()) for kind, rows in of_kind.items()}


@dataclass(frozen=True)
class Signature:
    """Figures of the controller from a column, over all events.

    Attributes
    ----------
    mean_width_ms
        Total on-time over pulses of the units that fire most (25 pulses or more in flight).
    minor_width_ms
        The same of units that hardly fire (fewer than 10 pulses in flight).
    minor_pulses
        Pulses of those units.
    shared_s
        Σ |Z1 + Z3 − Z2 − Z4| of on-time: 0 if pairs always fire as pairs.
    shared_pulses
        The same of pulses.
    """

    mean_width_ms: float
    minor_width_ms: float
    minor_pulses: float
    shared_s: float
    shared_pulses: float


def signature(comparison: Comparison, column: str) -> Signature:
    """The signature of a printed column or of ``simulation`` (mean over seeds)."""
    flight, stacked = comparison.column("flight"), comparison.column(column)
    n = len(UNITS)
    on_time, pulses = stacked[..., :n], stacked[..., n : 2 * n]
    counted = flight[..., n : 2 * n]
    major = np.broadcast_to(counted >= 25, pulses.shape)
    minor = np.broadcast_to(counted < 10, pulses.shape)
    seeds = stacked.shape[1]
    balance = np.array([0.0, 0.0, 1.0, -1.0, 1.0, -1.0])
    minor_pulses = float(pulses[minor].sum())
    return Signature(
        mean_width_ms=1e3 * float(on_time[major].sum() / pulses[major].sum()),
        minor_width_ms=1e3 * float(on_time[minor].sum() / minor_pulses) if minor_pulses else np.nan,
        minor_pulses=minor_pulses / seeds,
        shared_s=float(np.abs(on_time @ balance).sum() / seeds),
        shared_pulses=float(np.abs(pulses @ balance).sum() / seeds),
    )
