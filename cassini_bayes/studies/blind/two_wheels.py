"""Blind trials where two wheels steer with the thrusters: a platform's angle, or a leak, is hidden.

``cassini-bayes calibrate two-wheels`` flies the mosaic of ``runs/scenarios/hybrid_2012.toml`` with
everything drawn from the priors, diagnoses it without a hint, and writes
``docs/results/two-wheels.md``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.report.plots.two_wheels import two_wheel_figure
from cassini_bayes.studies.blind.campaign import read_trials, run_campaign
from cassini_bayes.studies.blind.flights import Blind
from cassini_bayes.studies.blind.rates import Record, alone, failed, first, interval, named
from cassini_bayes.studies.blind.strata import TWO_WHEELS, planned
from cassini_bayes.studies.study import Study

MODULE: Final = "studies.blind.trials"
"""Whose code, with all that it imports, a trial runs through."""
FULL: Final[Mapping[str, int]] = {"trials": planned(TWO_WHEELS)}
QUICK: Final[Mapping[str, int]] = {"trials": 6}
"""Numbers of trials, of each event."""
TITLE: Final = "Two wheels: hidden articulation and leaks"
BODY: Final = """\
A platform's angle (`wheel_articulation`) or a leak (`thruster_leak`, any thruster) of 5 to 10 σ is
hidden in an event of `{scenario}`, or nothing is; the diagnosis gets the telemetry and
`{priors}` without a hint and weighs all causes. Everything is drawn anew in every trial: parameters
from the priors, noise, start in the dead-band, wheel rates before the mosaic. σ is that of the
[blind campaign](../topics/criticism.md#6-blind-trials): √(δᵀV⁻¹δ), δ the change of the data, V what
noise and priors make of them. Each event is diagnosed alone.

{rates}

*Named*: the first cause is the hidden one, or one that the diagnosis reports as not to be told from
it; where nothing is hidden, that it is none. *Its probability* is the median of the hidden cause's.
*Held*: 90 % intervals of the size, given the hidden cause, that hold it; *size error*: the
posterior mean less the truth, median of its absolute value. All trials: [table](two-wheels.csv).

![Hidden and found sizes](two-wheels.png)

A platform's angle and the tilt u of its wheel are the same to first order (`wheel_alignment`). The
size decides: a wheel's alignment on its platform is known to 2 mrad, the angle of the platform to
10. The smallest are reported as a group of both. A leak of a Z thruster has a direction that no
other cause has. One of a Y thruster turns the body about Z as a steady torque may, and the mosaic's
turns of 14 mrad do not separate them: `external_torque` is in its group, and often first. What
tells them apart is [a change of attitude](leaks.md#a-leak-and-a-steady-torque).

Spin-ups (`--events spin-up`) are left out here: two wheels hold X and Y so still that the data say
next to nothing of I_xx and I_yy, and the diagnosis blames these where nothing is hidden
([why](../topics/telemetry-likelihood.md#10-two-wheels)).

## Trials in which another cause was first

{wrong}
"""


RATES: Final = (
    "event, hidden, trials, named, 95 % interval, itself first, its probability, held, size error"
)
WRONG: Final = (
    "event, trial, hidden, σ, named first, its probability, probability of the hidden one, alike"
)


def run_two_wheels(
    study: Study, scenario: Path, priors: Path, events: Sequence[str], trials: int
) -> None:
    """Run the trials of every event that are not kept yet; write page, table and figure."""
    tables = []
    for event in events:
        campaign = Blind(scenario, priors, study.seed, (event,), TWO_WHEELS, all_drawn=True)
        of_event = replace(study, work=study.work / event)
        run_campaign(of_event, campaign, trials)
        tables.append(
            trial_table(event, read_trials(of_event.work, study.seed), read_priors(priors))
        )
    table = pd.concat(tables, ignore_index=True)
    text = body(table, scenario, priors)
    study.publish(TITLE, text, MODULE, {"": table}, {"": two_wheel_figure(table)})


def trial_table(event: str, records: Sequence[Record], priors: Priors) -> pd.DataFrame:
    """One row per trial: what was hidden and named, with what probability, and the size found.

    Sizes are departures from the mean of the priors file, or all of a leak, in rad and N; NaN where
    nothing was hidden, or where a trial failed.
    """
    return pd.DataFrame([{"event": event, **_row(record, priors)} for record in records])


def _row(record: Record, priors: Priors) -> dict[str, object]:
    known = {
        "trial": record["index"],
        "stratum": record["stratum"],
        "named": named(record),
        "itself": alone(record),
        "error": record.get("error", ""),
    }
    if failed(record):
        return known
    size = record["sizes"][0] if record["sizes"] else {}
    prior = priors.parameters.get(str(size.get("parameter")))
    mean = 0.0 if prior is None else float(prior.mean)
    return known | {
        "hidden": record["hidden"][0]["name"] if record["hidden"] else "none",
        "sigma": record["hidden"][0]["sigma"] if record["hidden"] else np.nan,
        "first": first(record),
        "probability": record["causes"][0]["probability"],
        "probability_of_hidden": record["probability_of_truth"][0],
        "alike": " ".join(record["confounded_with"]),
        "size": size.get("true", np.nan) - mean,
        "found": size.get("mean", np.nan) - mean,
        "found_sd": size.get("sd", np.nan),
        "covers": float(size.get("covers", np.nan)),
    }


UNITS: Final[Mapping[str, tuple[float, str]]] = {
    "articulation": (1e3, "mrad"),
    "leak": (1e6, "µN"),
}
"""By stratum: factor and unit of a size as the page shows it."""


def body(table: pd.DataFrame, scenario: Path, priors: Path) -> str:
    """Text of the page."""
    return BODY.format(
        scenario=scenario,
        priors=priors,
        rates=_table(RATES, _rates(table)),
        wrong=_table(WRONG, _wrong(table)),
    )


def _table(head: str, rows: Iterator[str]) -> str:
    """A Markdown table; the names of its columns are parted by commas."""
    names = head.split(", ")
    return "\n".join([f"| {' | '.join(names)} |", "| --- " * len(names) + "|", *rows])


def _rates(table: pd.DataFrame) -> Iterator[str]:
    for (event, stratum), rows in table.groupby(["event", "stratum"], sort=False):
        hits, trials = int(rows["named"].sum()), len(rows)
        low, high = interval(hits, trials)
        yield (
            f"| {event} | {stratum} | {trials} | {hits} | {low:.2f} … {high:.2f}"
            f" | {int(rows['itself'].sum())} | {rows['probability_of_hidden'].median():.3f}"
            f" | {_sizes(str(stratum), rows)} |"
        )


def _sizes(stratum: str, own: pd.DataFrame) -> str:
    """Cells of coverage and error of the sizes of a stratum."""
    if stratum not in UNITS:
        return " | "
    factor, unit = UNITS[stratum]
    off = (own["found"] - own["size"]).abs()
    share = (off / own["size"].abs()).median()
    held = f"{own['covers'].sum():.0f} of {own['covers'].count()}"
    return f"{held} | {factor * off.median():.2g} {unit} ({share:.0%})"


def _wrong(table: pd.DataFrame) -> Iterator[str]:
    for row in table[~table["named"]].to_dict(orient="records"):
        if row["error"]:
            yield f"| {row['event']} | {row['trial']} | failed: {row['error']} | | | | | |"
            continue
        sigma = "" if np.isnan(row["sigma"]) else f"{row['sigma']:.1f}"
        yield (
            f"| {row['event']} | {row['trial']} | {row['hidden']} | {sigma} | {row['first']}"
            f" | {row['probability']:.3f} | {row['probability_of_hidden']:.3f} | {row['alike']} |"
        )
