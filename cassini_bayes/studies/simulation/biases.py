"""The eight biases of paper 001 beside their tables, and the scan of settings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from cassini_bayes.files.tables import rows_csv
from cassini_bayes.published import wheel_bias_tables
from cassini_bayes.report.plots import Figure
from cassini_bayes.report.plots.simulation import OnTimePanel, comparison_figure, motion_figure
from cassini_bayes.report.study_page import markdown_table
from cassini_bayes.simulation import read_scenario
from cassini_bayes.studies.bias_comparison import (
    KINDS,
    PRINTED,
    ROWS,
    UNITS,
    Comparison,
    Signature,
    mean_absolute_differences,
    printed_rows,
    signature,
    simulate_biases,
)
from cassini_bayes.studies.simulation.cases import SCENARIOS, simulated, with_settings

TAIL_OFFS_S: Final = (0.032, 0.040, 0.044)

# Settings that differ from the scenario's, one line of the table each.
SCAN: Final[Mapping[str, Mapping[str, Any]]] = {
    "as in the scenario": {},
    "gain 5 s": {"rate_gain_s": 5.0, "rate_knowledge_rad_s": 1e-4},
    "gain 20 s": {"rate_gain_s": 20.0, "rate_knowledge_rad_s": 2.5e-5},
    "no hysteresis": {"hysteresis": 0.0},
    "hysteresis 0.3": {"hysteresis": 0.3},
    "knowledge ten times better": {"rate_knowledge_rad_s": 5e-6},
    "knowledge twice better": {"rate_knowledge_rad_s": 2.5e-5},
    "one cycle late": {"latency_cycles": 1},
    "union of two demands": {"mapping": "union"},
    "adaptive widths": {"pulse_law": "adaptive"},
}


def bias_sections(
    seeds: range, scan_seeds: range
) -> tuple[list[str], dict[str, str], dict[str, Figure]]:
    """The eight biases: skill of every column, the scan of settings; tables (CSV) and figures."""
    file = read_scenario(SCENARIOS / "biases_2009_2010.toml")
    tables = wheel_bias_tables()
    full = simulate_biases(file, tables, seeds)
    header = ["column", *_KIND_NAMES.values(), *_SIGNATURE_NAMES]
    skill = [
        [
            _COLUMN_NAMES[column],
            *_skill_cells(full, column),
            *_signature_cells(signature(full, column), column),
        ]
        for column in (*PRINTED[:3], "simulation", "flight")
    ]
    scan_rows = []
    for name, updates in SCAN.items():
        changed = with_settings(file, rcs=file.scenario.rcs.model_copy(update=dict(updates)))
        scan_rows.append(_scan_row(name, simulate_biases(changed, tables, scan_seeds)))
    for tau in TAIL_OFFS_S:
        changed = with_settings(file, truth={**file.scenario.truth, "tau_fall_s": tau})
        result = simulate_biases(changed, tables, scan_seeds)
        scan_rows.append(_scan_row(f"τ_fall {1e3 * tau:.0f} ms", result))
    scan_header = ["settings", *_KIND_NAMES.values(), *_HALVES, *_SIGNATURE_NAMES]
    event_header = ["event", "row", *PRINTED, "simulated_mean", "simulated_sd"]
    files = {
        "_biases": rows_csv([event_header, *_event_rows(full)]),
        "_skill": rows_csv([header, *skill]),
        "_scan": rows_csv([scan_header, *scan_rows]),
    }
    figures = {
        "_biases": comparison_figure(_panels(full), UNITS),
        "_event": motion_figure(simulated(file, seeds[0])[0]),
    }
    sections = [
        markdown_table(header, skill),
        _on_time_table(full),
        _pulse_table(full),
        markdown_table(scan_header, scan_rows),
    ]
    return sections, files, figures


_KIND_NAMES: Final = {
    "on_time": "on-time [s]",
    "pulses": "pulses",
    "delta_v_z": "ΔVz [mm/s]",
    "hydrazine": "hydrazine [g]",
}
_COLUMN_NAMES: Final = {
    "ideal": "ideal",
    "calibrated": "calibrated",
    "fsds": "FSDS",
    "flight": "flight",
    "simulation": "this simulation",
}
_SIGNATURE_NAMES: Final = (
    "width [ms]",
    "rare width [ms]",
    "rare pulses",
    "shared [s]",
    "shared pulses",
)
_HALVES: Final = ("on-time, 3.a–d [s]", "on-time, 3.e–h [s]")


def _skill_cells(comparison: Comparison, column: str) -> list[str]:
    skill = mean_absolute_differences(comparison, column)
    return ["–" if math.isnan(skill[kind]) else f"{skill[kind]:.2f}" for kind in KINDS]


def _signature_cells(found: Signature, column: str) -> list[str]:
    if column == "ideal":
        return ["–"] * len(_SIGNATURE_NAMES)
    return [
        f"{found.mean_width_ms:.1f}",
        f"{found.minor_width_ms:.0f}",
        f"{found.minor_pulses:.0f}",
        f"{found.shared_s:.1f}",
        f"{found.shared_pulses:.0f}",
    ]


def _scan_row(name: str, found: Comparison) -> list[str]:
    halves = [
        mean_absolute_differences(Comparison(tables, found.values), "simulation")["on_time"]
        for tables in (found.tables[:4], found.tables[4:])
    ]
    return [
        name,
        *_skill_cells(found, "simulation"),
        *(f"{half:.2f}" for half in halves),
        *_signature_cells(signature(found, "simulation"), "simulation"),
    ]


def _event_rows(comparison: Comparison) -> list[list[str]]:
    rows = []
    for table in comparison.tables:
        printed = [printed_rows(table, column) for column in PRINTED]
        mean, spread = comparison.mean(table.event), comparison.spread(table.event)
        for i, row in enumerate(ROWS):
            cells = ["" if np.isnan(column[i]) else f"{column[i]:g}" for column in printed]
            rows.append([table.event, row, *cells, f"{mean[i]:.4g}", f"{spread[i]:.3g}"])
    return rows


def _event_table(comparison: Comparison, header: Sequence[str], rows: Sequence[int]) -> str:
    """Some of the rows of :data:`ROWS`, all columns of every event beside the simulation."""
    lines = []
    for table in comparison.tables:
        mean, spread = comparison.mean(table.event), comparison.spread(table.event)
        for i, column in enumerate(PRINTED):
            values = printed_rows(table, column)
            cells = ["–" if np.isnan(values[row]) else _plain(values[row], row) for row in rows]
            lines.append([table.event if i == 0 else "", _COLUMN_NAMES[column], *cells])
        simulated_cells = [f"{_plain(mean[row], row)} ± {spread[row]:.2f}" for row in rows]
        lines.append(["", "simulated", *simulated_cells])
    return markdown_table(["event", "", *header], lines)


def _plain(value: float, row: int) -> str:
    return f"{value:.1f}" if ROWS[row].startswith(("pulses", "hydrazine")) else f"{value:.2f}"


def _on_time_table(comparison: Comparison) -> str:
    names = [f"{unit.replace('_', '–').upper()} [s]" for unit in UNITS]
    header = [*names, "ΔVz [mm/s]", "hydrazine [g]"]
    return _event_table(comparison, header, [*range(6), len(ROWS) - 2, len(ROWS) - 1])


def _pulse_table(comparison: Comparison) -> str:
    names = [unit.replace("_", "–").upper() for unit in UNITS]
    return _event_table(comparison, names, range(len(UNITS), 2 * len(UNITS)))


def _panels(comparison: Comparison) -> list[OnTimePanel]:
    """Every event's simulated and printed on-times, less flight's."""
    rows = slice(0, len(UNITS))
    return [
        OnTimePanel(
            table.event,
            {
                c: (printed_rows(table, c) - printed_rows(table, "flight"))[rows]
                for c in PRINTED[:3]
            },
            (comparison.mean(table.event) - printed_rows(table, "flight"))[rows],
            comparison.spread(table.event)[rows],
        )
        for table in comparison.tables
    ]
