"""Results of the simulation, by one command: ``python -m cassini_bayes.simulation_results``.

Writes ``simulation.md``, its CSV tables and figures into a folder (``docs/results``): momentum,
integrator order, impulse, the FSDS case of paper 000, the eight biases of paper 001, and which
settings of the thruster controller those support.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
import platform
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np
from numpy.typing import NDArray

from cassini_bayes.bias_comparison import (
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
from cassini_bayes.plots import encode
from cassini_bayes.plots.simulation import comparison_figure, motion_figure
from cassini_bayes.published import published_constants, wheel_bias_tables
from cassini_bayes.pulses import PULSE_SHAPES
from cassini_bayes.scenario import draw_truth
from cassini_bayes.simulation import (
    Motion,
    ScenarioFile,
    SimulatedEvent,
    make_plan,
    read_scenario,
    simulate_plan,
    stream,
)
from cassini_bayes.simulation.arrays import make_thrusters
from cassini_bayes.simulation.engine import Steps, simulate_motion
from cassini_bayes.simulation.kernel import thrust_step
from cassini_bayes.simulation.telemetry import record_interval_s
from cassini_bayes.storage import write_bytes, write_text

Array = NDArray[np.float64]
SEEDS: Final = 24
SCAN_SEEDS: Final = 4
TAIL_OFFS_S: Final = (0.032, 0.040, 0.044)
SCENARIOS: Final = Path("runs/scenarios")

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


@dataclass(frozen=True)
class Report:
    """Sections of the page, and the files beside it."""

    text: str
    files: Mapping[str, bytes]


def with_settings(file: ScenarioFile, **updates: object) -> ScenarioFile:
    """A scenario file with other settings."""
    return replace(file, scenario=file.scenario.model_copy(update=updates))


def simulated(file: ScenarioFile, seed: int) -> tuple[SimulatedEvent, ...]:
    """All events of a scenario, without effects."""
    truth = draw_truth(file, seed)
    scenario = file.scenario
    return tuple(
        simulate_plan(make_plan(scenario, file.spacecraft, event, truth), scenario, seed)
        for event in scenario.event
    )


def relative_drift(motion: Motion) -> float:
    """Largest |H − H(0) − ∫τ dt| over the largest |H|, inertial frame."""
    momentum = motion.momentum_inertial_n_m_s()
    gain = momentum - momentum[0] - motion.angular_impulse_n_m_s
    return float(np.abs(gain).max() / np.linalg.norm(momentum, axis=1).max())


def naive_thrust_n(motion: Motion, thrusters: Sequence[str], lever_m: float) -> float:
    """Least-squares thrust from the Z balance at the samples (paper 000 eqs. 17, 22).

    ``thrusters`` of the −Z and +Z pair in the order (y1, y3, y2, y4), one lever for all.
    """
    time = motion.time_s
    momentum = motion.momentum_body_n_m_s()
    gyroscopic = np.cross(motion.rate_rad_s, momentum)
    steps = 0.5 * (gyroscopic[1:] + gyroscopic[:-1]) * np.diff(time)[:, None]
    integral = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    balance = (momentum - momentum[0] + integral)[:, 2]
    logs = [motion.pulses[name].on_time_s(time) for name in thrusters]
    column = lever_m * (logs[2] + logs[3] - logs[0] - logs[1])
    return float(column @ balance / (column @ column))


def momentum_section() -> str:
    """Momentum, integrator order, impulse and speed, as a table."""
    slews = read_scenario(SCENARIOS / "slews_2000.toml")
    biases = read_scenario(SCENARIOS / "biases_2009_2010.toml")
    hour = simulated(slews, 1)[0].motion
    bias = simulated(biases, 1)[0].motion
    worst = max(impulse_error(width) for width in (0.007, 0.02, 0.125, 0.25, 0.5, 0.75))
    rows = [
        [
            "relative drift of inertial momentum, slews, 4200 s",
            f"{relative_drift(hour):.1e}",
            "1e-8",
        ],
        [
            "drift beyond the torque's integral, wheel bias",
            f"{relative_drift(bias):.1e}",
            "1e-8",
        ],
        ["largest relative error of a pulse's impulse, 7 to 750 ms", f"{worst:.1e}", "1e-6"],
        ["speed, wheel bias, 5 ms steps, one core", f"{speed(biases):,.0f} × real time", "2,000"],
        [
            "speed, slews with two appendages, 5 ms steps",
            f"{speed(slews):,.0f} × real time",
            "2,000",
        ],
    ]
    return markdown(["figure", "measured", "required"], rows)


def impulse_error(width_s: float) -> float:
    """Relative error of the impulse of one pulse against the closed form of its shape."""
    file = read_scenario(SCENARIOS / "fsds_2005.toml")
    truth = draw_truth(file, 1)
    plan = make_plan(file.scenario, file.spacecraft, file.scenario.event[0], truth)
    thrusters = make_thrusters(plan)
    on, width = np.array([0.0]), np.array([width_s])
    level = total = 0.0
    for i in range(800):
        level, gained = thrust_step(level, 0.005 * i, 0.005, on, width, 1, thrusters)
        total += gained
    taus = [plan.parameters[f"tau_{which}_s"] for which in ("delay", "rise", "fall")]
    expected = float(PULSE_SHAPES[plan.propulsion.pulse_shape].effective_time(width_s, *taus))
    return abs(total / expected - 1.0)


def speed(file: ScenarioFile) -> float:
    """Simulated seconds per second of processor time: the best of five, after compilation."""
    truth = draw_truth(file, 1)
    scenario = file.scenario
    plan = make_plan(scenario, file.spacecraft, scenario.event[0], truth)
    steps = Steps.of(scenario.step_s, scenario.cycle_s, record_interval_s(scenario.telemetry))
    best = math.inf
    for _ in range(6):
        began = time.process_time()
        motion = simulate_motion(plan, steps, stream(1, "start"), stream(1, "knowledge"))
        best = min(best, time.process_time() - began)
    return motion.duration_s / best


def fsds_section() -> tuple[str, list[list[str]]]:
    """The FSDS case of paper 000 beside the paper's figures."""
    file = read_scenario(SCENARIOS / "fsds_2005.toml")
    lever = file.given()["thruster_lx_m"]
    header = [
        "case",
        "Y2 on-time [s]",
        *("pulses", "of 125 ms", "250 ms", "longer", "other thrusters"),
        *("naive thrust [N]", "effective / commanded", "corrected [N]"),
    ]
    rows = [["paper 000", *_paper_fsds_cells()]]
    for shape in ("first_order", "published_2005"):
        for name, updates in (("", {}), (", no hysteresis", {"hysteresis": 0.0})):
            scenario = file.scenario.model_copy(
                update={
                    "propulsion": file.scenario.propulsion.model_copy(
                        update={"pulse_shape": shape}
                    ),
                    "rcs": file.scenario.rcs.model_copy(update=updates),
                }
            )
            (event,) = simulated(replace(file, scenario=scenario), 1)
            rows.append(_fsds_row(f"{shape}{name}", event, lever))
    return markdown(header, rows), [header, *rows]


def _paper_fsds_cells() -> list[str]:
    """What paper 000 prints of its case, in the order of the table."""
    constants = published_constants()
    printed = {
        key: constants.value("paper_000_fsds", key)
        for key in ("on_time_y2_s", "estimated_thrust_n", "impulse_ratio", "corrected_thrust_n")
    }
    widths = [
        round(constants.value("paper_000_fsds", f"pulses_{width}_ms"))
        for width in (125, 250, 500, 750)
    ]
    return [
        f"{printed['on_time_y2_s']:g}",
        str(sum(widths)),
        str(widths[0]),
        str(widths[1]),
        str(widths[2] + widths[3]),
        "–",
        f"{printed['estimated_thrust_n']:g}",
        f"{printed['impulse_ratio']:g}",
        f"{printed['corrected_thrust_n']:g}",
    ]


def _fsds_row(name: str, event: SimulatedEvent, lever: float) -> list[str]:
    motion = event.motion
    widths = motion.pulses["y2"].width_s
    counted = Counter(round(1e3 * w) for w in widths)
    taus = [event.plan.parameters[f"tau_{which}_s"] for which in ("delay", "rise", "fall")]
    shape = PULSE_SHAPES[event.plan.propulsion.pulse_shape]
    ratio = float(np.sum(shape.effective_time(widths, *taus)) / np.sum(widths))
    thrust = naive_thrust_n(motion, ("y1", "y3", "y2", "y4"), lever)
    others = sum(log.width_s.size for k, log in motion.pulses.items() if k not in ("y2", "y4"))
    return [
        name,
        f"{widths.sum():.3f}",
        str(widths.size),
        str(counted[125]),
        str(counted[250]),
        str(widths.size - counted[125] - counted[250]),
        str(others),
        f"{thrust:.3f}",
        f"{ratio:.4f}",
        f"{thrust / ratio:.3f}",
    ]


def bias_sections(seeds: int, scan_seeds: int) -> tuple[list[str], dict[str, bytes]]:
    """The eight biases: skill of every column, the scan of settings, tables and figures."""
    file = read_scenario(SCENARIOS / "biases_2009_2010.toml")
    tables = wheel_bias_tables()
    full = simulate_biases(file, file.scenario, tables, range(1, seeds + 1))
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
        settings = file.scenario.rcs.model_copy(update=dict(updates))
        scenario = file.scenario.model_copy(update={"rcs": settings})
        found = simulate_biases(file, scenario, tables, range(1, scan_seeds + 1))
        scan_rows.append(_scan_row(name, found))
    for tau in TAIL_OFFS_S:
        changed = with_settings(file, truth={**file.scenario.truth, "tau_fall_s": tau})
        found = simulate_biases(changed, changed.scenario, tables, range(1, scan_seeds + 1))
        scan_rows.append(_scan_row(f"τ_fall {1e3 * tau:.0f} ms", found))
    scan_header = ["settings", *_KIND_NAMES.values(), *_HALVES, *_SIGNATURE_NAMES]
    event_header = ["event", "row", *PRINTED, "simulated_mean", "simulated_sd"]
    first = simulated(file, 1)[0]
    files = {
        "simulation_biases.csv": csv_bytes([event_header, *_event_rows(full)]),
        "simulation_skill.csv": csv_bytes([header, *skill]),
        "simulation_scan.csv": csv_bytes([scan_header, *scan_rows]),
        "simulation_biases.png": encode(comparison_figure(full), "png"),
        "simulation_event.png": encode(motion_figure(first), "png"),
    }
    return [
        markdown(header, skill),
        _on_time_table(full),
        markdown(scan_header, scan_rows),
    ], files


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


def _on_time_table(comparison: Comparison) -> str:
    names = [unit.replace("_", "–").upper() for unit in UNITS]
    header = ["event", "", *names, "ΔVz [mm/s]", "hydrazine [g]"]
    chosen = [*range(6), len(ROWS) - 2, len(ROWS) - 1]
    rows = []
    for table in comparison.tables:
        mean, spread = comparison.mean(table.event), comparison.spread(table.event)
        flight, fsds = printed_rows(table, "flight"), printed_rows(table, "fsds")
        rows.append([table.event, "flight", *(f"{flight[i]:.2f}" for i in chosen)])
        rows.append(["", "FSDS", *(f"{fsds[i]:.2f}" for i in chosen)])
        rows.append(["", "simulated", *(f"{mean[i]:.2f} ± {spread[i]:.2f}" for i in chosen)])
    return markdown(header, rows)


def markdown(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown."""
    header = list(header)
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)


def csv_bytes(rows: Iterable[Iterable[str]]) -> bytes:
    """Rows as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


PAGE: Final = """# The simulation: results

Written by `python -m cassini_bayes.simulation_results` ({seeds} seeds, {scan_seeds} for the scan)
with Python {python}, numpy {numpy}, numba {numba}. The physics and the settings are told in
[The simulation](../simulation.md); what the figures mean is told there as well.

## Momentum, impulse, speed

{momentum}

The integrator's fourth order is a test (`tests/test_simulation_dynamics.py`), and so is the
agreement with an independent integration.

## The FSDS case of paper 000

Wheels from rest to 1800 rpm, 0.75 N on all thrusters, τ_fall 65 ms; on-times as they are given to
the naive regression of the Z balance, sampled once per second.

{fsds}

## Eight wheel biases beside flight

Mean absolute difference to flight over all thrusters and pairs of the eight events (paper 001
averages like that). *Width*: on-time over pulses of units with 25 pulses or more in flight; *rare*:
units with fewer than 10; *shared*: Σ |Z1 + Z3 − Z2 − Z4|, which pairs that only fire as pairs leave
at zero.

{skill}

On-times in s, simulated mean ± standard deviation over seeds (all rows in `simulation_biases.csv`):

{on_times}

![On-times of the eight events as differences to flight.](simulation_biases.png)

## Which settings the flight data support

One setting changed at a time; the halves show that the choice does not rest on a few events.

{scan}

## One event

![Attitude error, rates, wheel speeds, momentum and firings of 2009-08-22.](simulation_event.png)
"""


def make_report(seeds: int = SEEDS, scan_seeds: int = SCAN_SEEDS) -> Report:
    """Measure everything and put the page together."""
    fsds, fsds_rows = fsds_section()
    (skill, on_times, scan), files = bias_sections(seeds, scan_seeds)
    text = PAGE.format(
        seeds=seeds,
        scan_seeds=scan_seeds,
        python=platform.python_version(),
        numpy=np.__version__,
        numba=numba.__version__,
        momentum=momentum_section(),
        fsds=fsds,
        skill=skill,
        on_times=on_times,
        scan=scan,
    )
    return Report(text, {**files, "simulation_fsds.csv": csv_bytes(fsds_rows)})


def write_report(report: Report, folder: Path) -> None:
    """Write the page and its files, each whole or not at all."""
    for name, content in report.files.items():
        write_bytes(folder / name, content)
    write_text(folder / "simulation.md", report.text)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command: measure, and write into ``--out``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--scan-seeds", type=int, default=SCAN_SEEDS)
    options = parser.parse_args(arguments)
    write_report(make_report(options.seeds, options.scan_seeds), options.out)


if __name__ == "__main__":
    main()
