"""The page: sections put together, and the command that writes it."""

from __future__ import annotations

import argparse
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numba
import numpy as np

from cassini_bayes.files.storage import write_bytes, write_text
from cassini_bayes.studies.simulation.biases import bias_sections
from cassini_bayes.studies.simulation.fsds import fsds_section
from cassini_bayes.studies.simulation.mechanics import momentum_section
from cassini_bayes.studies.simulation.propellant import propellant_section
from cassini_bayes.studies.simulation.tables import csv_bytes

SEEDS: Final = 24
SCAN_SEEDS: Final = 4


@dataclass(frozen=True)
class Report:
    """Sections of the page, and the files beside it."""

    text: str
    files: Mapping[str, bytes]


PAGE: Final = """# The simulation: results

Written by `python -m cassini_bayes.studies.simulation` ({seeds} seeds, {scan_seeds} for the scan)
with Python {python}, numpy {numpy}, numba {numba}. The physics and the settings are told in
[The simulation](../simulation.md); what the figures mean is told there as well.

## Momentum, impulse, speed

{momentum}

Agreement with an independent integration is a test (`tests/test_simulation_dynamics.py`); agreement
with another simulator, and the speed beside it, are in [Open loop against
Basilisk](simulation_basilisk.md).

## The FSDS case of paper 000

Wheels from rest to 1800 rpm, 0.75 N on all thrusters, τ_fall 65 ms; on-times as they are given to
the naive regression of the Z balance, sampled once per second. Simulated: mean ± standard deviation
over 8 seeds (start in the dead-band, controller's knowledge).

{fsds}

## Eight wheel biases beside flight

Mean absolute difference to flight over all thrusters and pairs of the eight events (paper 001
averages like that). *Width*: on-time over pulses of units with 25 pulses or more in flight; *rare*:
units with fewer than 10; *shared*: Σ |Z1 + Z3 − Z2 − Z4|, which pairs that only fire as pairs leave
at zero.

{skill}

On-times (of each thruster of a pair), computed ΔV along Z and hydrazine; simulated: mean ± standard
deviation over seeds. The same figures are in `simulation_biases.csv`.

{on_times}

Number of pulses, likewise:

{pulses}

![On-times of the eight events as differences to flight.](simulation_biases.png)

## Specific impulse behind the printed hydrazine

Fits of paper 001's equations (19) and (21) to the hydrazine that its tables print, from the printed
on-times, thrusts and durations: I_sp constant, and I_sp = P0 − P1 exp(−P2 μ) with μ the thruster's
duty cycle.

{propellant}

## Which settings the flight data support

One setting changed at a time; the halves show that the choice does not rest on a few events.

{scan}

## One event

![Attitude error, rates, wheel speeds, momentum and firings of 2009-08-22.](simulation_event.png)
"""


def make_report(seeds: int = SEEDS, scan_seeds: int = SCAN_SEEDS) -> Report:
    """Measure everything and put the page together."""
    fsds, fsds_rows = fsds_section()
    propellant, propellant_rows = propellant_section()
    (skill, on_times, pulses, scan), files = bias_sections(seeds, scan_seeds)
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
        pulses=pulses,
        propellant=propellant,
        scan=scan,
    )
    tables = {
        "simulation_fsds.csv": csv_bytes(fsds_rows),
        "simulation_propellant.csv": csv_bytes(propellant_rows),
    }
    return Report(text, {**files, **tables})


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
