"""The text of the results page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from cassini_bayes.prediction.leave_one_out import KINDS
from cassini_bayes.priors.reader import Priors
from cassini_bayes.studies.prediction.findings import Findings, hydrazine_floor
from cassini_bayes.studies.prediction.tables import (
    GOALS,
    event_table,
    firing_table,
    ground_table,
    requirement_table,
    score_table,
    sensitivity_table,
    skill_table,
)

KINDS_TEXT: Final[Mapping[str, str]] = {
    "on_time": "on-times",
    "delta_v_z": "ΔVz",
    "hydrazine": "hydrazine",
}


def page_body(findings: Findings, priors: Priors, stem: str) -> str:
    """The text of the page."""
    sections = (
        "How close does a prediction come to what was flown? Every flight event is predicted from\n"
        f"the other {len(findings.events) - 1}, its own wheel rates and its date\n"
        "([the model](../topics/prediction.md)).",
        _skill(findings, stem),
        _hydrazine(findings),
        _requirement(findings, stem),
        _ground(findings, priors),
        _sensitivity(findings),
    )
    return "\n\n".join(sections)


def _skill(findings: Findings, stem: str) -> str:
    scores = findings.scores
    verdicts = "; ".join(
        f"{KINDS_TEXT[kind]} "
        f"{'reached' if scores[kind].mean_absolute_difference <= goal else '**missed**'} "
        f"({scores[kind].mean_absolute_difference:.2f} against {goal:g} {KINDS[kind]})"
        for kind, goal in GOALS.items()
    )
    covered = scores["on_time"].coverage
    return f"""## Leave one event out

Mean absolute difference to flight over the eight events. A pair counts once, as in paper 001. A
prediction's point value is its median. "Calibrated" was tuned on these very events.

{skill_table(findings)}

Goals: {verdicts}; 90 % intervals hold {100 * covered:.0f} % of on-times (goal: 80 to 100 %,
{"reached" if 0.8 <= covered <= 1.0 else "**missed**"}).

{score_table(scores)}

The interval is the central 90 % one. Interval score and CRPS have the unit of the kind. The CRPS of
a point prediction is its absolute difference, so it compares directly with the first table.

![On-times of the eight events less flight.]({stem}.png)

![ΔVz and hydrazine less flight.]({stem}_totals.png)

Flight, and the predicted median with its central 90 % interval. On-times are in s, of each thruster
of a pair. All on-times with the published columns: [{stem}.csv]({stem}.csv).

{event_table(findings)}"""


def _hydrazine(findings: Findings) -> str:
    floor = hydrazine_floor(findings)
    return f"""## Hydrazine

What is the best that any prediction of on-times could reach? Take the flight's own on-times and
the printed thrust, and regress the printed hydrazine on impulse, leaving one event out. This
still differs by {floor["flight"]:.2f} g ({floor["flight, by axis"]:.2f} g with a coefficient of
its own for the couple axis). So nearly all of the difference above is in the printed masses.

The printed masses are whole grams except one (2.6 g, also the figure of FSDS). Regressed on the
on-times of FSDS instead of those of flight, the same masses differ by {floor["fsds"]:.2f} g."""


def _requirement(findings: Findings, stem: str) -> str:
    met = sum(result[2].met for result in findings.requirement.values())
    left = [
        100.0 * result[2].without_m_s["limit cycle"] / abs(result[2].nominal_m_s)
        for result in findings.requirement.values()
    ]
    return f"""## The navigation requirement

Goal (paper 001): ΔV within 3 % of nominal at 3 σ in each component. That is a spread of 1 %, or a
probability of 99.73 %. Nominal is the predicted median; spread is half the central 68 % interval.
"Without" a source is the spread if that source were known exactly. ΔVx and ΔVy are next to nothing,
because couples cancel. 3 % of them has no meaning; their spread is in the last column.

{requirement_table(findings)}

Reached in {met} of {len(findings.requirement)} events. The limit cycle is what limits it. How
often a bias fires against itself differs from event to event, and eight totals do not say why.
Without it, {min(left):.1f} to {max(left):.1f} % would be left.

![What each source leaves of the spread.]({stem}_requirement.png)"""


def _ground(findings: Findings, priors: Priors) -> str:
    ground, implied = ground_table(findings, priors)
    return f"""## The ground-software method, rebuilt

Does our calculation give the "ideal" column of Tables 3.a–3.h? It takes wheel rates, printed thrust
and table mass. The paper does not print the centre of mass, the wheel inertias and the alignment of
its runs. The first row takes those of the priors file (2005 and 2011), the second the seven values
that the 48 printed ideal on-times imply by least squares. Differences are absolute.

{ground}

Implied:

{implied}

What remains is rounding of thrust (0.01 N is 1.3 %), rates (1 rpm) and on-times. Hydrazine uses
I_sp = 160 s, as the coefficients of eq. 19 are printed nowhere. The flight calibration behind the
"calibrated" column (a gain array and matrix equations) is not printed, and not rebuilt."""


def _sensitivity(findings: Findings) -> str:
    return f"""## How far the answer depends on the priors of the firing logic

The scales of its half-normal priors are halved and doubled, everything else is the same:

{sensitivity_table(findings)}

Posterior of the firing logic with the event left out, mean ± standard deviation. Units are those of
its priors, `prediction.toml`.

{firing_table(findings)}"""
