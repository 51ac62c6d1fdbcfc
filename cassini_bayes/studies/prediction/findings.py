"""What is found about prediction: folds, scores, requirement, sensitivity."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.files.tables import rows_csv
from cassini_bayes.prediction.beliefs import Beliefs, read_beliefs
from cassini_bayes.prediction.firing import NAMES
from cassini_bayes.prediction.leave_one_out import HeldOut, Skill, leave_one_out, skill
from cassini_bayes.prediction.navigation import Requirement, requirements
from cassini_bayes.prediction.requests import request_of
from cassini_bayes.prediction.scores import central_interval
from cassini_bayes.priors.reader import Priors

COLUMNS: Final[Mapping[str, str]] = {
    "gsw_ideal": "ideal (paper 001)",
    "gsw": "calibrated on these events (paper 001)",
    "fsds": "FSDS, closed loop (paper 001)",
}
SCALED: Final = ("halved", "doubled")


@dataclass(frozen=True)
class Findings:
    """Everything the page reports."""

    events: tuple[TotalsEvent, ...]
    columns: Mapping[str, tuple[TotalsEvent, ...]]
    folds: tuple[HeldOut, ...]
    scores: Mapping[str, Skill]
    requirement: Mapping[str, tuple[Requirement, ...]]
    sensitivity: Mapping[str, Mapping[str, Skill]]


def find(
    flight: tuple[TotalsEvent, ...],
    columns: Mapping[str, tuple[TotalsEvent, ...]],
    priors: Priors,
    seed: int,
    progress: Callable[[str, int, int], None],
) -> Findings:
    """Leave one out, with the firing logic's priors as they are, halved and doubled."""
    beliefs = read_beliefs()
    folds = leave_one_out(flight, priors, beliefs, seed, told=partial(progress, "events left out"))
    judged = {
        held.event.id: requirements(held.learned, request_of(held.event), seed) for held in folds
    }
    sensitivity = {}
    for label, width in zip(SCALED, (0.5, 2.0), strict=True):
        sensitivity[label] = skill(
            leave_one_out(
                flight,
                priors,
                scaled_firing(beliefs, width),
                seed,
                told=partial(progress, f"priors {label}"),
            )
        )
    return Findings(
        events=flight,
        columns=columns,
        folds=folds,
        scores=skill(folds),
        requirement=judged,
        sensitivity=sensitivity,
    )


def scaled_firing(beliefs: Beliefs, width: float) -> Beliefs:
    """The half-normal priors of the firing logic with their scales multiplied."""
    return Beliefs(
        {
            name: replace(
                distribution,
                keywords={**distribution.keywords, "scale": width * distribution.scale},
            )
            if name in NAMES and distribution.name == "halfnorm"
            else distribution
            for name, distribution in beliefs.distributions.items()
        }
    )


def table_csv(findings: Findings) -> str:
    """Every on-time: event, unit, flight, the columns, predicted median and 90 % interval."""
    header = ["event", "unit", "flight_s", *(f"{source}_s" for source in COLUMNS)]
    table = [[*header, "median_s", "low_90_s", "high_90_s"]]
    for held in findings.folds:
        prediction = held.prediction
        draws = prediction.unit_on_time_s()
        low, high = central_interval(draws)
        median = np.median(draws, axis=0)
        for i, (name, unit) in enumerate(
            zip(prediction.unit_names(), prediction.units, strict=True)
        ):
            others = [
                next(e for e in rows if e.id == held.event.id).on_time_s[unit[0]]
                for rows in findings.columns.values()
            ]
            values = (held.event.on_time_s[unit[0]], *others, median[i], low[i], high[i])
            table.append([held.event.id, name, *(f"{value:.3f}" for value in values)])
    return rows_csv(table)


def hydrazine_floor(findings: Findings) -> dict[str, float]:
    """Leave-one-out differences (g) of the printed flight hydrazine, on-times being known.

    Linear regressions through the origin on F T (printed thrust, total on-time): of flight; of
    flight with a coefficient of its own for the couple axis; of FSDS instead of flight.
    """
    units = findings.folds[0].prediction.units
    couple = sorted({k for unit in units[:2] for k in unit})
    grams = np.array([event.hydrazine_g for event in findings.events], dtype=np.float64)
    thrust = np.array([event.thrust_predicted_n for event in findings.events], dtype=np.float64)
    on_time = {
        source: thrust[:, None] * np.array([event.on_time_s for event in events])
        for source, events in (("flight", findings.events), ("fsds", findings.columns["fsds"]))
    }
    total = on_time["flight"].sum(1)
    flown = on_time["flight"][:, couple].sum(1)
    designs = {
        "flight": total[:, None],
        "flight, by axis": np.stack([total - flown, flown], axis=-1),
        "fsds": on_time["fsds"].sum(1)[:, None],
    }
    result = {}
    for label, design in designs.items():
        misses = []
        for row in range(len(grams)):
            kept = np.arange(len(grams)) != row
            beta = np.linalg.lstsq(design[kept], grams[kept], rcond=None)[0]
            misses.append(abs(float(grams[row] - design[row] @ beta)))
        result[label] = float(np.mean(misses))
    return result
