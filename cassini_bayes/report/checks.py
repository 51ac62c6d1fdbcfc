"""Nuisances, error budget, model against measurement, ΔV and convergence: tables and figures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd
from markupsafe import Markup

from cassini_bayes.report.cells import MN, Cell, Table, or_missing, percent
from cassini_bayes.report.page import (
    BUDGET,
    CHECKS,
    CONVERGENCE,
    DELTA_V,
    NUISANCES,
    Drawing,
    Paragraph,
    Section,
    Shown,
)
from cassini_bayes.report.plots.quantities import (
    INTERVAL,
    INTERVAL_SHORT,
    MISSING,
    display_scale,
    interval,
    number,
    plus_minus,
)
from cassini_bayes.report.plots.tables import (
    NOISE_ONLY,
    NONLINEAR,
    SHARE,
    budget_blocks,
    events_of,
    grid,
    nuisance_pages,
    parameter_scale,
    thrusters_of,
)
from cassini_bayes.results.review import Review

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure

STOP_RULE: Final = "Stop rule"
FIXED_REPLICATE_S: Final = 1e-9
UNLIKELY_TAIL: Final = 0.005


def nuisances(review: Review) -> Iterator[Section]:
    """Every walked parameter, its prior beside its posterior."""
    conflicts = review.nuisances[review.nuisances["verdict"] == "conflict"]["name"]
    named = Markup(", ").join(Markup("<code>{}</code>").format(name) for name in conflicts)
    verdict = "No nuisance is in conflict with its prior. "
    if len(conflicts):
        verdict = Markup("<strong>In conflict with their priors:</strong> {}. ").format(named)
    rule = (
        "A parameter is in conflict when the data move it by more than 2.58 standard deviations of "
        "what prior and data together lead one to expect (1 % two-sided); where the data narrow it "
        "by less than 5 % the prior is returned."
    )
    corners = (
        Drawing(
            f"corner_nuisances_{i}",
            "Corner plot of nuisances with priors",
            f"Nuisances, part {i}: contours and prior as in the corner plot of the thrust levels.",
            partial(_corner_figure, review, names, title),
            portrait=True,
        )
        for i, (names, title) in enumerate(nuisance_pages(review), start=1)
    )
    yield Section(
        NUISANCES,
        (
            Paragraph(Markup("{}{}").format(verdict, rule)),
            Drawing(
                "nuisances",
                "Prior and posterior intervals of every nuisance",
                f"Bars: {INTERVAL} of the posterior in units of the prior's standard deviation, "
                "measured from the prior's mean. Grey: 90 % equal-tailed interval of the prior. "
                "Numbers at the right: posterior and prior, mean ± standard deviation.",
                partial(_nuisance_figure, review),
            ),
            Shown(nuisance_table(review)),
            Shown(
                prior_table(review),
                style="words",
                fold="What each parameter means, and where its prior comes from",
            ),
            *corners,
        ),
        name="nuisances",
        frame=review.nuisances,
    )


def _nuisance_figure(review: Review) -> Figure:
    from cassini_bayes.report.plots.nuisances import nuisance_figure

    return nuisance_figure(review)


def _corner_figure(review: Review, names: list[str], title: str) -> Figure | None:
    from cassini_bayes.report.plots.corners import nuisance_corner

    return nuisance_corner(review, names, title)


def torques(review: Review) -> Iterator[Section]:
    """External torques against their priors."""
    drawing = Drawing(
        "torques",
        "Prior and posterior intervals of the external torque of every event",
        f"External torque of each event (integrated out analytically, drawn back): {INTERVAL} in "
        "units of the prior's standard deviation. Grey: 90 % equal-tailed interval of the prior.",
        partial(_torque_figure, review),
    )
    yield Section(NUISANCES, (drawing,))


def _torque_figure(review: Review) -> Figure | None:
    from cassini_bayes.report.plots.nuisances import torque_figure

    return torque_figure(review)


def budget(review: Review) -> Iterator[Section]:
    """Where each thrust's variance comes from."""
    if review.budget.empty:
        return
    yield Section(
        BUDGET,
        (
            Paragraph(
                Markup(
                    "<em>Noise-only σ</em>: with every nuisance known. <em>Full σ</em>: the "
                    "posterior. <em>Consider σ</em>: the nuisances at one prior standard deviation "
                    "each, not estimated from these data, as in a navigation consider covariance. "
                    "Shares divide the full variance; a share can be negative where the data tie "
                    "blocks together."
                )
            ),
            Drawing(
                "budget",
                "Shares of the variance of each thrust by block, and three standard deviations",
                "Left: share of each thrust's posterior variance by block of nuisances, mean over "
                "events. Right: the three standard deviations, mean and range over events.",
                partial(_budget_figure, review),
            ),
            Shown(budget_table(review)),
            Shown(
                budget_event_table(review),
                fold="Error budget of every thruster in every event",
            ),
        ),
        name="budget",
        frame=review.budget,
    )


def _budget_figure(review: Review) -> Figure:
    from cassini_bayes.report.plots.budget import budget_figure

    return budget_figure(review)


def predictive(review: Review) -> Iterator[Section]:
    """On-times of the same biases flown again, where events are totals rows."""
    if review.predictive.empty:
        return
    inside, predicted = coverage(review)
    yield Section(
        CHECKS,
        (
            Paragraph(
                "Each posterior draw flies the same bias again: new rates in the dead-band, and "
                "the thrusters that answer the momentum demand make up the difference. "
                f"{inside} of the {predicted} on-times so predicted lie inside their {INTERVAL}. "
                "The others are set by the limit cycle whatever the thrust is, and are not "
                "predicted."
            ),
            Drawing(
                "predictive",
                "Measured on-times against replicates, and their differences",
                f"Above: measured on-times (symbols) on the {INTERVAL} of the replicates (bars). "
                "Below: the same, minus the replicates' mean. A negative replicate means that the "
                "opposite thrusters would have fired.",
                partial(_predictive_figure, review),
            ),
            Shown(predictive_table(review), fold="On-times of every thruster in every event"),
        ),
        title="On-times",
        name="predictive",
        frame=review.predictive,
    )


def _predictive_figure(review: Review) -> Figure:
    from cassini_bayes.report.plots.checks import predictive_figure

    return predictive_figure(review)


def balance(review: Review) -> Iterator[Section]:
    """Momentum left over per event and axis."""
    last = "; of telemetry events what is left at the last usable row"
    yield Section(
        CHECKS,
        (
            Drawing(
                "balance",
                "Momentum left over per event and axis",
                "Thruster impulse plus external torque minus the change of the wheels' momentum"
                f"{last if review.model.telemetry else ''}. Symbols and bars: posterior mean and "
                "90 % interval (mean ± 1.645 standard deviations). Grey: 90 % interval of the "
                "noise that the model allows for (dead-band rates and attitudes, rounding).",
                partial(_balance_figure, review),
            ),
            Shown(balance_table(review), fold="Momentum balance of every event and axis"),
        ),
        title="Momentum balance",
        name="balance",
        frame=review.balance,
    )


def _balance_figure(review: Review) -> Figure:
    from cassini_bayes.report.plots.checks import balance_figure

    return balance_figure(review)


def delta_v(review: Review) -> Iterator[Section]:
    """Printed velocity changes, and the on-board computation as fitted."""
    if not events_of(review):
        return
    text = Paragraph(
        Markup(
            "A velocity change is a second handle on thrust only if it was <em>measured</em>, by "
            "Doppler tracking or an accelerometer. One <em>computed</em> on board from assumed "
            "thrust, mass and tail-off repeats those assumptions: it says what the flight software "
            "believes, and nothing about the true thrust. Declared as computed it is fitted with "
            "constants of its own and leaves every thrust where it was."
        )
    )
    if review.delta_v.empty:
        none = Paragraph("No event of this run declares a computed ΔV.")
        yield Section(DELTA_V, (text, none))
        return
    drawing = Drawing(
        "delta_v",
        "Printed velocity change against the fitted on-board computation",
        "Left: printed ΔV and the fit of the on-board computation. Right: their difference. Thick "
        "bars: the computed value; thin bars: with the channel's own noise, as fitted; both 90 % "
        "intervals (mean ± 1.645 standard deviations).",
        partial(_delta_v_figure, review),
    )
    blocks = (text, drawing, Shown(delta_v_table(review)))
    yield Section(DELTA_V, blocks, name="delta_v", frame=review.delta_v)


def _delta_v_figure(review: Review) -> Figure:
    from cassini_bayes.report.plots.delta_v import delta_v_figure

    return delta_v_figure(review)


def variants(review: Review) -> Iterator[Section]:
    """Thrusts under every use of ΔV, where they were asked for."""
    if review.variants.empty:
        return
    drawing = Drawing(
        "delta_v_thrusts",
        "Thrust of every thruster in every bias under three uses of the velocity change",
        f"Posterior mean and {INTERVAL} of every thrust with ΔV left out, as declared, and as if "
        "it had been measured.",
        partial(_variant_figure, review),
    )
    yield Section(
        DELTA_V,
        (Shown(variant_table(review)), drawing),
        title="Thrust under the three uses of ΔV",
        name="variants",
        frame=review.variants,
    )


def _variant_figure(review: Review) -> Figure:
    from cassini_bayes.report.plots.delta_v import delta_v_thrust_figure

    return delta_v_thrust_figure(review)


def convergence(review: Review) -> Iterator[Section]:
    """How well the posterior is sampled."""
    rule = review.facts.get(STOP_RULE, "")
    stated = Paragraph(Markup("<strong>Stop rule:</strong> {}.").format(rule))
    yield Section(
        CONVERGENCE,
        (
            *((stated,) if rule else ()),
            Drawing(
                "convergence",
                "R-hat and effective sample sizes of every scalar",
                "Every scalar of the posterior is one symbol: R-hat between independent ensembles, "
                "bulk and tail effective sample size.",
                partial(_convergence_figure, review),
            ),
            Shown(convergence_table(review), fold="Walked parameters", open=True),
            Shown(scalar_table(review), fold=f"Every scalar of the posterior ({INTERVAL})"),
        ),
    )


def _convergence_figure(review: Review) -> Figure:
    from cassini_bayes.report.plots.checks import convergence_figure

    return convergence_figure(review)


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


def budget_table(review: Review) -> Table:
    """Means over events, one row per thruster."""
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
    """(on-times inside their interval, on-times that the model predicts)."""
    table = review.predictive
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


def delta_v_table(review: Review) -> Table:
    """Printed ΔV and the fit of the on-board computation."""
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


def variant_table(review: Review) -> Table:
    """Mean thrust under each use of ΔV, and the largest shift against the first use."""
    table = review.variants
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
