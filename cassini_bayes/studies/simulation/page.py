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

BODY: Final = """\
Does the simulation obey physics, and does it fly as Cassini did? {seeds} seeds, {scan_seeds} for
the scan of settings. [The simulation](../topics/simulation.md) describes physics and settings,
[findings](simulation-findings.md) what the figures mean.

## Momentum, impulse, speed

{momentum}

Agreement with an independent integration is a test (`tests/simulation/`). Agreement with another
simulator, and its speed, are in [Open loop against Basilisk](simulation_basilisk.md).

## The FSDS case of paper 000

Wheels go from rest to 1800 rpm, all thrusters have 0.75 N, τ_fall is 65 ms. On-times are those that
the naive regression of the Z balance takes, sampled once per second. Simulated figures are means ±
standard deviations over 8 seeds (start in the dead-band, controller's knowledge).

{fsds}

## Eight wheel biases beside flight

Mean absolute difference to flight over all thrusters and pairs of the eight events, as paper 001
averages.

- *Width*: on-time over pulses, of units with 25 pulses or more in flight.
- *Rare*: units with fewer than 10 pulses.
- *Shared*: Σ |Z1 + Z3 − Z2 − Z4|. It is zero if pairs only fire as pairs.

{skill}

On-times (of each thruster of a pair), computed ΔV along Z, and hydrazine. Simulated figures are
means ± standard deviations over seeds. The same figures are in `simulation_biases.csv`.

{on_times}

Number of pulses, likewise:

{pulses}

![On-times of the eight events as differences to flight.](simulation_biases.png)

## Specific impulse behind the printed hydrazine

Equations (19) and (21) of paper 001 are fitted to the hydrazine that its tables print, with the
printed on-times, thrusts and durations. I_sp is constant, or P0 − P1 exp(−P2 μ) with μ the
thruster's duty cycle.

{propellant}

## Which settings the flight data support

One setting is changed at a time. The halves show that the choice does not rest on a few events.

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
