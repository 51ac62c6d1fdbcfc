"""Tables of nuisances, error budget, predictive checks, ΔV and convergence."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.report.cells import MN, Cell, Table, or_missing, percent
from cassini_bayes.report.plots.budget import NOISE_ONLY, NONLINEAR, SHARE, budget_blocks
from cassini_bayes.report.plots.quantities import (
    INTERVAL_SHORT,
    MISSING,
    display_scale,
    interval,
    number,
    plus_minus,
)
from cassini_bayes.report.plots.tables import grid, parameter_scale, thrusters_of
from cassini_bayes.results.review import Review

FIXED_REPLICATE_S: Final = 1e-9
UNLIKELY_TAIL: Final = 0.005


def nuisance_table(review: Review) -> Table:
    """Prior and posterior of every walked parameter, with the verdict."""
    rows = []
    for _, row in review.nuisances.iterrows():
        scale = parameter_scale(review, str(row["name"]))
        f = scale.factor
        flag = (
            "flag"
            if row["verdict"] == "conflict"
            else "muted"
            if row["verdict"] != "informed"
            else ""
        )
        surprise = float(row["surprise"])
        rows.append(
            (
                Cell(str(row["name"])),
                Cell(scale.unit),
                Cell(plus_minus(row["prior_mean"] * f, row["prior_sd"] * f)),
                Cell(plus_minus(row["mean"] * f, row["sd"] * f)),
                Cell(interval(row["hdi_90_low"] * f, row["hdi_90_high"] * f)),
                Cell(percent(float(row["contraction"]))),
                Cell(f"{surprise:+.1f}".replace("-", "−") if math.isfinite(surprise) else MISSING),
                Cell(str(row["verdict"]), flag),
            )
        )
    return Table(
        (
            "parameter",
            "unit",
            "prior mean ± sd",
            "posterior mean ± sd",
            INTERVAL_SHORT,
            "narrowed by",
            "shift [σ]",
            "verdict",
        ),
        tuple(rows),
    )


def prior_table(review: Review) -> Table:
    """What every walked parameter means, and where its prior comes from."""
    return Table(
        ("parameter", "block", "meaning", "source of the prior"),
        tuple(
            tuple(Cell(str(row[c])) for c in ("name", "block", "meaning", "source"))
            for _, row in review.nuisances.iterrows()
        ),
    )


def budget_table(review: Review) -> Table | None:
    """Means over events, one row per thruster; None without thrusts."""
    if review.budget.empty:
        return None
    numeric = review.budget.drop(columns=["event"]).groupby("thruster").mean()
    rows = [_budget_row((name,), numeric.loc[name], review) for name in thrusters_of(review)]
    return Table(("thruster", *_budget_columns(review)), tuple(rows))


def budget_event_table(review: Review) -> Table:
    """The error budget of every thruster in every event."""
    rows = [
        _budget_row((str(row["event"]), str(row["thruster"])), row, review)
        for _, row in review.budget.iterrows()
    ]
    return Table(("event", "thruster", *_budget_columns(review)), tuple(rows), heads=2)


def _budget_columns(review: Review) -> tuple[str, ...]:
    heads = {NOISE_ONLY: "all nuisances known", NONLINEAR: "joint", "noise": "noise scales"}
    shares = (f"{heads.get(block, block)} [%]" for block in budget_blocks(review.budget))
    return ("noise-only σ [mN]", "full σ [mN]", "consider σ [mN]", *shares)


def _budget_row(heads: Iterable[str], row: pd.Series, review: Review) -> tuple[Cell, ...]:
    sigmas = (MN * float(row[c]) for c in ("noise_only_sd_n", "full_sd_n", "consider_sd_n"))
    shares = (float(row[b + SHARE]) for b in budget_blocks(review.budget))
    return (
        *(Cell(head) for head in heads),
        *(Cell(number(s, s)) for s in sigmas),
        *(Cell(percent(s).removesuffix(" %")) for s in shares),
    )


def coverage(review: Review) -> tuple[int, int]:
    """(on-times inside their interval, on-times that the model predicts); (0, 0) without any."""
    table = review.predictive
    if table.empty:
        return 0, 0
    told = table[(table["sd_s"] > FIXED_REPLICATE_S) & table["mean_s"].notna()]
    inside = (told["measured_s"] >= told["hdi_90_low_s"]) & (
        told["measured_s"] <= told["hdi_90_high_s"]
    )
    return int(inside.sum()), len(told)


def predictive_table(review: Review) -> Table:
    """Measured on-times and replicates; what the limit cycle sets is said to be so."""
    rows = []
    for _, row in review.predictive.iterrows():
        told = float(row["sd_s"]) > FIXED_REPLICATE_S
        tail = float(row["tail_probability"])
        rows.append(
            (
                Cell(str(row["event"])),
                Cell(str(row["thruster"])),
                Cell(or_missing(row["measured_s"], ".2f")),
                Cell(plus_minus(row["mean_s"], row["sd_s"]) if told else "set by the limit cycle",
                     "" if told else "muted"),
                Cell(interval(row["hdi_90_low_s"], row["hdi_90_high_s"]) if told else MISSING),
                Cell(f"{tail:.3f}" if told and math.isfinite(tail) else MISSING,
                     "flag" if told and tail < UNLIKELY_TAIL else ""),
            )
        )  # fmt: skip
    return Table(
        (
            "event",
            "thruster",
            "measured [s]",
            "replicates, mean ± sd [s]",
            f"{INTERVAL_SHORT} [s]",
            "tail probability",
        ),
        tuple(rows),
        heads=2,
    )


def balance_table(review: Review) -> Table:
    """Momentum left over per event and axis."""
    rows = []
    for _, row in review.balance.iterrows():
        z = float(row["standardised"])
        rows.append(
            (
                Cell(str(row["event"])),
                Cell(str(row["axis"])),
                Cell(plus_minus(row["residual_n_m_s"], row["sd_n_m_s"])),
                Cell(number(row["noise_sd_n_m_s"], row["noise_sd_n_m_s"])),
                Cell(f"{z:+.1f}".replace("-", "−") if math.isfinite(z) else MISSING,
                     "flag" if abs(z) > 3 else ""),
            )
        )  # fmt: skip
    return Table(
        (
            "event",
            "axis",
            "momentum left over, mean ± sd [N m s]",
            "noise σ [N m s]",
            "in noise σ",
        ),
        tuple(rows),
        heads=2,
    )


def delta_v_table(review: Review) -> Table | None:
    """Printed ΔV and the fit of the on-board computation; None without one."""
    if review.delta_v.empty:
        return None
    rows = []
    for _, row in review.delta_v.iterrows():
        mean, sd = float(row["computed_mean_mm_s"]), float(row["computed_sd_mm_s"])
        rows.append(
            (
                Cell(str(row["event"])),
                Cell(or_missing(row["printed_mm_s"], ".2f")),
                Cell(plus_minus(mean, sd)),
                Cell(number(float(row["printed_mm_s"]) - mean, sd)),
            )
        )
    return Table(
        (
            "event",
            "printed [mm/s]",
            "computed channel, mean ± sd [mm/s]",
            "printed − computed [mm/s]",
        ),
        tuple(rows),
    )


def variant_table(review: Review) -> Table | None:
    """Mean thrust under each use of ΔV, and the largest shift against the first use."""
    table = review.variants
    if table.empty:
        return None
    names = list(dict.fromkeys(table["variant"]))
    means, sds = (
        {n: grid(table[table["variant"] == n], column, review) for n in names}
        for column in ("mean_n", "sd_n")
    )
    reference = names[0]
    rows = []
    for name in names:
        shift = (means[name] - means[reference]) / sds[reference]
        worst = shift.flat[int(np.nanargmax(np.abs(shift)))]
        sd = float(np.nanmean(sds[name]))
        rows.append(
            (
                Cell(name),
                Cell(number(float(np.nanmean(means[name])), sd)),
                Cell(number(sd * MN, sd * MN)),
                Cell(MISSING if name == reference else f"{worst:+.2f}".replace("-", "−")),
            )
        )
    return Table(
        (
            "use of ΔV",
            "mean of all thrusts [N]",
            "mean of their sd [mN]",
            f"largest shift against “{reference}” [its sd]",
        ),
        tuple(rows),
    )


def convergence_table(review: Review) -> Table:
    """Autocorrelation time, R-hat and effective sample size of walked parameters."""
    return Table(
        ("walked parameter", "autocorrelation time τ [steps]", "R-hat", "effective sample"),
        tuple(
            (
                Cell(str(row["name"])),
                Cell(or_missing(row["tau_steps"], ".1f")),
                Cell(or_missing(row["rhat"], ".4f"), "flag" if row["rhat"] >= 1.01 else ""),
                Cell(or_missing(row["ess"], ".0f")),
            )
            for _, row in review.convergence.iterrows()
        ),
    )


def scalar_table(review: Review) -> Table:
    """Every scalar of the posterior with its prior and sampling diagnostics."""
    scales = _quantity_scales(review.summary)
    rows = []
    for _, row in review.summary.iterrows():
        factor, unit = scales[str(row["quantity"])]
        rows.append(
            (
                Cell(str(row["name"])),
                Cell(unit),
                Cell(plus_minus(row["mean"] * factor, row["sd"] * factor)),
                Cell(interval(row["hdi_90_low"] * factor, row["hdi_90_high"] * factor)),
                Cell(plus_minus(row["prior_mean"] * factor, row["prior_sd"] * factor)),
                Cell(or_missing(row["rhat"], ".4f")),
                Cell(or_missing(row["ess_bulk"], ".0f")),
                Cell(or_missing(row["ess_tail"], ".0f")),
            )
        )
    return Table(
        (
            "scalar",
            "unit",
            "mean ± sd",
            INTERVAL_SHORT,
            "prior mean ± sd",
            "R-hat",
            "ESS bulk",
            "ESS tail",
        ),
        tuple(rows),
    )


def _quantity_scales(summary: pd.DataFrame) -> dict[str, tuple[float, str]]:
    """One factor and unit per quantity, so that its rows can be compared."""
    scales = {}
    for quantity, rows in summary.groupby("quantity"):
        largest = rows[["mean", "prior_mean", "prior_sd"]].abs().max()
        scale = display_scale(str(rows["unit"].iloc[0]), *(float(v) for v in largest))
        scales[str(quantity)] = (scale.factor, scale.unit)
    return scales
