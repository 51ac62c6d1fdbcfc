"""The comparison of error bars: sets of events for both readings, one verdict, one page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report.plots.perturbation_coverage import coverage_length_figure
from cassini_bayes.report.study_page import table_of
from cassini_bayes.studies.perturbation_coverage import (
    BOTH,
    EVENT_MEAN,
    LAPLACE,
    MODULE,
    POSTERIOR,
    READINGS,
    RSS,
    SQUARES,
    THRUSTER,
    THRUSTER_EVENT,
    WORST,
    CoverageCampaign,
    Reading,
    coverage_table,
)
from cassini_bayes.studies.study import Study

LEAST_TOLERANCE: Final = 0.03
FULL: Final[Mapping[str, int]] = dict.fromkeys(READINGS, 60)
QUICK: Final[Mapping[str, int]] = dict.fromkeys(READINGS, 10)
"""Sets of events for each reading of the sizes."""


def compare_error_bars(
    study: Study, events: Path, priors: Path, numbers: Mapping[str, int]
) -> bool:
    """Simulate and estimate sets of events for each reading, and write the results.

    ``numbers`` are sets by reading, as in :data:`FULL`. Returns whether the posterior's intervals
    hold what they claim.
    """
    result: dict[Reading, Mapping[str, Array]] = {}
    for reading in READINGS:
        campaign = CoverageCampaign(events, priors, reading, seed=study.seed)
        name = reading.replace(" ", "-")
        arrays = study.repeat(name, f"sizes as {reading}", campaign, numbers[reading])
        result[reading] = {k: np.asarray(v, dtype=np.float64) for k, v in arrays.items()}
    table = coverage_table(result)
    study.publish(
        "What hand-picked perturbation bars are worth",
        _body(study.page.stem, table, result),
        MODULE,
        {"": table},
        {"": coverage_length_figure(table, WORST)},
    )
    return bool(holds_claim(table[table["method"] == POSTERIOR]).all())


def holds_claim(rows: pd.DataFrame) -> pd.Series:
    """Whether coverage is the claimed probability within 3 % or three standard errors."""
    return (rows["coverage"] - rows["claim"]).abs() <= _tolerance(rows)


def _tolerance(rows: pd.DataFrame) -> pd.Series:
    return (3.0 * rows["coverage_error"]).clip(lower=LEAST_TOLERANCE)


def _row(table: pd.DataFrame, reading: str, estimand: str, method: str, claim: float) -> pd.Series:
    own = (table["reading"] == reading) & (table["estimand"] == estimand)
    own &= table["method"] == method
    if method != WORST:
        own &= table["claim"] == claim
    return table[own].iloc[0]


def _percent(row: pd.Series) -> str:
    return f"{100 * row['coverage']:.0f} ± {100 * row['coverage_error']:.0f} %"


def _tables(table: pd.DataFrame) -> str:
    parts = []
    for reading in READINGS:
        own, worst = (
            table[table["reading"] == reading],
            "all" if reading == "maximum" else "nothing",
        )
        claims = own["claim"].map(lambda claim: f"{100 * claim:.0f} %")
        shown = own.assign(
            claims=claims.where(own["method"] != WORST, worst),
            held=own.apply(_percent, axis=1),
            length=1e3 * own["mean_length_n"],
        )
        rows = table_of(
            shown,
            "estimate | interval | claims | holds the truth in | mean length [mN] | intervals",
            "{estimand} | {method} | {claims} | {held} | {length:.1f} | {intervals}",
        )
        parts.append(f"### Sizes drawn as {reading}\n\n{rows}\n")
    return "\n".join(parts)


def verdict(table: pd.DataFrame) -> str:
    """The comparison in plain sentences, made from its numbers."""
    lines = []
    for reading in READINGS:
        mean, single = (
            {m: _row(table, reading, e, m, 0.9) for m in (RSS, WORST, POSTERIOR, LAPLACE)}
            for e in (EVENT_MEAN, THRUSTER_EVENT)
        )
        pooled = {
            m: _row(table, reading, THRUSTER, m, 0.9)
            for m in (RSS, WORST, SQUARES, BOTH, POSTERIOR, LAPLACE)
        }
        posterior, both = pooled[POSTERIOR], pooled[BOTH]
        against = [posterior["mean_length_n"] / pooled[m]["mean_length_n"] for m in (RSS, BOTH)]
        lines.append(
            f"**Sizes drawn as {reading}.** RSS bars scaled to claim 90 % hold the mean thrust of "
            f"an event in {_percent(mean[RSS])} of the cases and a thruster over all events in "
            f"{_percent(pooled[RSS])}; the worst case in {_percent(mean[WORST])} and "
            f"{_percent(pooled[WORST])}. The fit's own standard error, as a 90 % interval, holds a "
            f"thruster over all events in {_percent(pooled[SQUARES])}; RSS bars and standard error "
            f"in quadrature in {_percent(both)}. The posterior's 90 % intervals hold "
            f"{_percent(mean[POSTERIOR])} and {_percent(posterior)}, Laplace's "
            f"{_percent(mean[LAPLACE])} and {_percent(pooled[LAPLACE])}. For a thruster over all "
            f"events the posterior's interval is {against[0]:.2f} times as long as the RSS bars "
            f"and {against[1]:.2f} times as long as bars and standard error together. A thruster "
            "in one event is not determined by totals for least squares (its answer of least norm "
            f"lies inside the 90 % RSS bars in {_percent(single[RSS])}); the posterior's interval "
            f"holds it in {_percent(single[POSTERIOR])}."
        )
    return "\n\n".join([_in_short(table), *lines])


def _in_short(table: pd.DataFrame) -> str:
    """How many of the stated probabilities each method meets, in which direction it errs, at what
    length; the answer of least norm is not held against the bars.
    """
    selected = table[table["claim"].notna()]
    fair = selected[
        (selected["estimand"] != THRUSTER_EVENT) | ~selected["method"].isin((RSS, SQUARES, BOTH))
    ]
    parts = []
    for method in (RSS, SQUARES, BOTH, LAPLACE, POSTERIOR):
        rows = fair[fair["method"] == method]
        met = holds_claim(rows)
        short = int((rows["coverage"] < rows["claim"])[~met].sum())
        long = int((~met).sum()) - short
        errs = [f"{n} too {word}" for n, word in ((short, "short"), (long, "long")) if n]
        also = f" ({', '.join(errs)})" if errs else ""
        parts.append(f"{method} {int(met.sum())} of {len(rows)}{also}")
    widest = 100.0 * float(_tolerance(fair).max())
    lengths = [
        _row(table, reading, name, BOTH, 0.9)["mean_length_n"]
        / _row(table, reading, name, POSTERIOR, 0.9)["mean_length_n"]
        for reading in READINGS
        for name in (EVENT_MEAN, THRUSTER)
    ]
    return (
        "**In short.** Stated probabilities that are met (coverage within 3 % or three standard "
        f"errors of the claim, over both readings and two claims): {'; '.join(parts)}. Met means "
        f"not shown to be missed: three standard errors are up to {widest:.0f} %. Bars and "
        f"standard error together are {min(lengths):.1f} to {max(lengths):.1f} times as long as "
        "the posterior's intervals (90 %)."
    )


def _body(stem: str, table: pd.DataFrame, found: Mapping[Reading, Mapping[str, Array]]) -> str:
    sets = int(table["sets"].iloc[0])
    events = found[READINGS[0]][f"{EVENT_MEAN}.truth"].size
    chains = sum(int(arrays["by_chain"].sum()) for arrays in found.values())
    worst_k = max(float(arrays["pareto_k"].max()) for arrays in found.values())
    return f"""{_introduction(sets, events)}
## Verdict

{verdict(table)}

![Coverage against length]({stem}.png)

Open symbols claim 68 % (dashed line), filled ones 90 % (full line); the worst case claims
certainty where sizes are largest errors.

## Numbers

{_tables(table)}
As a file: [{stem}.csv]({stem}.csv). Posterior draws are importance draws (largest Pareto k̂
{worst_k:.2f}); a chain stood in for them in {chains} of {2 * sets} sets.

The posterior also knows the priors of thrust and dead-band, which least squares does not ask for;
the truths are drawn from them.

What this does not say: the papers' estimates use the time history within an event, which totals do
not carry; with it a single event determines its thrusters, and its least squares is a better
estimate than the one of least norm held to account here. The perturbation bars themselves do not
depend on it."""


def _introduction(sets: int, events: int) -> str:
    return f"""\
Paper 003 puts error bars on thrusts by perturbing assumed parameters, each by an amount picked by
hand as about its largest error: centre of mass 10 %, moments of inertia 5 % and products 50 %,
wheel inertia 1 %, the column of wheel 4 in the wheels' matrix 1 %, thruster location 1 %, tail-off
10 %. Here the truth is known: the eight wheel biases of 2009-10 are flown again by the mechanism of
[the likelihood's derivation](../topics/totals-likelihood.md) §3, {sets} sets or {events} events for
each reading of those sizes, once as one standard deviation (normal), once as largest error
(uniform). Thrusts, dead-band rates, torques and the tail's rise come from the shipped priors.

Estimates: the *mean thrust of an event* (paper 000 eq. 23, weighted by on-time), every *thruster
over all events together* (pseudo-inverse of eight events, mean weighted by on-time), and a
*thruster in one event* (pseudo-inverse; totals give three equations for six unknowns, so it is the
answer of least norm; on-times below 5 s are left out, as the paper does). Intervals: the RSS of the
perturbations (scaled by 1 or 1.645 to claim 68 or 90 %), their sum, the standard error of the
least-squares fit (Student-t), both in quadrature, a Laplace approximation, and the posterior
(central), the last two with priors that are the sizes as drawn. ± is one standard error; a set
counts once, because its events share their errors.
"""
