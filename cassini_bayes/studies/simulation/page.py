"""The page: sections put together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from cassini_bayes.files.tables import rows_csv
from cassini_bayes.studies.simulation.biases import bias_sections
from cassini_bayes.studies.simulation.fsds import fsds_section
from cassini_bayes.studies.simulation.mechanics import momentum_section
from cassini_bayes.studies.simulation.propellant import propellant_section
from cassini_bayes.studies.study import Study

FULL: Final[Mapping[str, int]] = {"eight wheel biases": 24, "scan of settings": 4}
QUICK: Final[Mapping[str, int]] = {"eight wheel biases": 4, "scan of settings": 1}
"""Numbers of seeds."""

BODY: Final = """{seeds} seeds, {scan_seeds} for the scan. The physics and the settings are told in
[The simulation](../topics/simulation.md), what the figures mean in
[findings](simulation-findings.md).

## Momentum, impulse, speed

{momentum}

Agreement with an independent integration is a test (`tests/simulation/`); agreement
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


def simulation_results(study: Study, numbers: Mapping[str, int]) -> None:
    """Measure everything and write the page with its tables and figures.

    ``numbers`` of seeds as in :data:`FULL`; they are counted from the study's own.
    """
    fsds, fsds_rows = fsds_section()
    propellant, propellant_rows = propellant_section()
    seeds, scan_seeds = (range(study.seed, study.seed + n) for n in numbers.values())
    (skill, on_times, pulses, scan), tables, figures = bias_sections(seeds, scan_seeds)
    body = BODY.format(
        seeds=len(seeds),
        scan_seeds=len(scan_seeds),
        momentum=momentum_section(),
        fsds=fsds,
        skill=skill,
        on_times=on_times,
        pulses=pulses,
        propellant=propellant,
        scan=scan,
    )
    tables |= {"_fsds": rows_csv(fsds_rows), "_propellant": rows_csv(propellant_rows)}
    study.publish("The simulation: results", body, "studies.simulation", tables, figures)
