"""What the papers say over the years: ``cassini-bayes calibrate papers``.

Thrust against pressure, Table 1 of paper 003 with its navigation column, inertia at four dates, and
the eight flight biases under other beliefs. One page, with a table beside it for each of the last
three.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.totals import read_totals
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.report.study_page import markdown_table, table_of
from cassini_bayes.studies.a_branch_table import (
    losses,
    ranking,
    shift_from_ratio,
    table_1,
    without_navigation,
)
from cassini_bayes.studies.flight_priors import IDEAL, TESTED, UPLINKED, compare_priors
from cassini_bayes.studies.inertia_epochs import (
    AXES,
    BIAS_SD,
    CLAIMED_SD,
    PREDICTION_SD,
    WHEEL_SD,
    estimator_error,
    moment_ratios,
)
from cassini_bayes.studies.pressure_laws import BEFORE, THRUST_ERROR, recharge_prediction
from cassini_bayes.studies.study import Study

MODULE: Final = "studies.papers_over_years"
INTERCEPT_SD: Final = 0.2  # of the affine law, as in a mission's priors
SCATTERS: Final = (0.026, 0.06)
"""Of healthy thrusters: those of the B branch, and the six healthy ones of Table 1 itself."""
PAIR: Final = "thruster_degraded:z3+thruster_degraded:z4"
SHIFT: Final = "center_of_mass:y"
LOST: Final = ("z3", "z4")
SHOWN: Final = ("unknown", PAIR, "thruster_degraded:z3", "thruster_degraded:z4", SHIFT)


def study_papers(study: Study, events: Path, priors: Path) -> None:
    """Work everything out and write the page; ``events`` are the flight biases, as totals rows."""
    causes = _causes()
    ratios, dates = moment_ratios()
    read = read_priors(priors)
    beliefs = compare_priors(read_totals(events, read.spacecraft), read, study.seed)
    parts = (_pressure(study.seed), _table_1(causes), _inertia(ratios, dates), _beliefs(beliefs))
    tables = {
        "-table-1": causes,
        "-inertia": pd.DataFrame(np.expm1(ratios), index=list(dates), columns=list(AXES))
        .rename_axis("date")
        .reset_index(),
        "-beliefs": beliefs,
    }
    study.publish("The papers over the years", "\n\n".join(parts), MODULE, tables, {})


def _pressure(seed: int) -> str:
    laws = {
        name: recharge_prediction(sd, np.random.default_rng(seed))
        for name, sd in (("proportional", 0.0), ("affine", INTERCEPT_SD))
    }
    rows = (
        [name, f"{100 * (law.mean - 1):+.0f} ± {100 * law.sd:.0f} %", f"{law.log_density:.2f}"]
        for name, law in laws.items()
    )
    affine = laws["affine"]
    odds = np.exp(affine.log_density - laws["proportional"].log_density)
    share, before = affine.intercept, 100 * (1 - BEFORE[0])
    return f"""\
Four questions that one event cannot answer. No goal belongs to them; a value with ± is a mean and
one standard deviation.

## Thrust against pressure

Two laws of thrust against tank pressure, from the thrust at launch and in 2005 alone, with
{100 * THRUST_ERROR:.0f} % for each figure and each pressure. The affine law has an intercept, whose
share of the thrust is N(0, {INTERCEPT_SD}²) beforehand.

{markdown_table(("law", "rise at the recharge of 2006-04-10", "log density of +50 %"), rows)}

The papers print a rise of about 50 %. The odds are {odds:.1f} to 1 for the affine law. With it the
intercept's share is {share[0]:.2f} ± {share[1]:.2f}. The pressure just before the recharge is
printed nowhere: {before:.0f} ± {100 * BEFORE[1]:.0f} % below that of 2005 is assumed."""


def _causes() -> pd.DataFrame:
    """Every hypothesis on Table 1 by scatter, with navigation's column and without."""
    tables = {True: table_1(), False: without_navigation(table_1())}
    return pd.concat(
        ranking(table, scatter).assign(scatter=scatter, with_navigation=navigated)
        for navigated, table in tables.items()
        for scatter in SCATTERS
    )


def _table_1(causes: pd.DataFrame) -> str:
    table, (shift, shift_sd) = table_1(), shift_from_ratio(table_1())
    known = causes.set_index(["with_navigation", "scatter", "name"])
    rows = (
        [
            f"`{name}`",
            *(f"{known.log_bayes_factor[flag, s, name]:+.1f}" for flag, s in _columns()),
        ]
        for name in SHOWN
    )
    first = causes[causes.with_navigation].groupby("scatter").first()
    verdicts = " and ".join(
        f"`{row.name}` (probability {row.probability:.2f}) at {100 * scatter:.1f} %"
        for scatter, row in zip(first.index, first.itertuples(index=False), strict=True)
    )
    weak = (
        [
            what,
            f"{100 * s:.1f} %",
            *(_percent(losses(table, s)[group][i]) for group in ("z3", "z4")),
        ]
        for s in SCATTERS
        for i, what in enumerate(("from the common level", "since 2007"))
    )
    header = ("cause", *(f"{_word(flag)}, scatter {100 * s:.1f} %" for flag, s in _columns()))
    return f"""\
## Table 1 of paper 003 with its navigation column

The study's estimates are torques over lever arms, navigation's are forces from Doppler. A shift of
the centre of mass moves one column, a weak thruster both. There are six estimates (Y1 = Y3 and Y2 =
Y4 are one each) and four of navigation, good to 2 % each. Log Bayes factors against `none`:

{markdown_table(header, rows)}

Most probable are {verdicts}. The scatter is that of healthy thrusters: of the B branch, or of the
six healthy thrusters of the table itself. Study over navigation alone allows a shift of the centre
of mass along Y of {shift:.3f} ± {shift_sd:.3f} m.

What Z3 and Z4 have lost, if they are weak. Their own level of 2007 is not known: its prior is the
common level with the scatter. Paper 003 prints 23 % and 17 % since 2007. Nothing here was tuned to
them.

{markdown_table(("loss", "scatter", "Z3", "Z4"), weak)}"""


def _columns() -> list[tuple[bool, float]]:
    return [(navigated, scatter) for navigated in (True, False) for scatter in SCATTERS]


def _word(navigated: bool) -> str:
    return "with navigation" if navigated else "without"


def _percent(value: tuple[float, float]) -> str:
    return f"{100 * value[0]:.0f} ± {100 * value[1]:.0f} %"


def _inertia(ratios: Array, dates: Sequence[str]) -> str:
    error, doubled = estimator_error(ratios), estimator_error(ratios, CLAIMED_SD / 2)
    rows = (
        [date, *(f"{100 * value:+.1f} %" for value in np.expm1(row))]
        for date, row in zip(dates, ratios, strict=True)
    )
    low, high = error.quantile(0.05), error.quantile(0.95)
    return f"""\
## Inertia at four dates

Estimated over predicted moments of inertia, less one (papers 000 and 002):

{markdown_table(("date", *AXES), rows)}

A wrong wheel inertia scales all estimates alike, and a biased prediction all dates of its axis.
Neither changes from date to date. With {100 * WHEEL_SD:.0f} % on the wheels, {100 * BIAS_SD:.0f} %
on the predictions of an axis and {100 * PREDICTION_SD:.1f} % on each prediction, all integrated
out, the estimator's own error is **{100 * error.mean:.1f} %** (one standard deviation; central 90 %
interval {100 * low:.1f} to {100 * high:.1f} %). The papers say ± 1 %. Read as one standard
deviation, changes as large as these have p = {error.p_claimed:.2g}; read as two,
p = {doubled.p_claimed:.1g}. How far each axis was turned is printed for no date, so the error is
the same for all axes."""


def _beliefs(table: pd.DataFrame) -> str:
    rows = table_of(
        table.assign(tau=1e3 * table.tau_fall_s, tau_sd=1e3 * table.tau_fall_s_sd).assign(
            cm=1e3 * table.cm_y_m, cm_sd=1e3 * table.cm_y_m_sd
        ),
        "priors | log evidence | τ_fall, ms | c.m. y, mm | mean thrust, N | Z1, N | Z3, N",
        "{priors} | {log_evidence:.2f} | {tau:.1f} ± {tau_sd:.1f} | {cm:.1f} ± {cm_sd:.1f}"
        " | {thrust_mean_n:.3f} ± {thrust_mean_n_sd:.3f} | {thrust_z1_n:.3f} | {thrust_z3_n:.3f}",
    )
    centre, tilt = (
        ", ".join(f"{IDEAL[name][0]:g}" for name in names)
        for names in (("cm_x_m", "cm_y_m"), ("rwa4_tilt_u_rad", "rwa4_tilt_v_rad"))
    )
    tested, uplinked = (1e3 * belief["tau_fall_s"][0] for belief in (TESTED, UPLINKED))
    return f"""\
## The eight flight biases under other beliefs

{rows}

*Today*: printed values with a date, 2011. *Ideal column*: centre of mass ({centre} m) and tilt
of RWA-4 ({tilt} rad) that paper 001 computed its ideal on-times with, as these show
([prediction](prediction.md)). *Tested*: {tested:.1f} ms, of the A branch at 400 psia. *Uplinked*:
{uplinked:.0f} ms, which explained velocity changes, as wide as the test's."""
