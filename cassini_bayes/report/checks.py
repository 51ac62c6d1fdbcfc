"""Nuisances, error budget, model against measurement, ΔV and convergence: tables and figures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Final

import numpy as np
import pandas as pd
from markupsafe import Markup

from cassini_bayes.report.cells import (
    MN,
    Cell,
    Column,
    Table,
    as_percent,
    between,
    flagged,
    formatted,
    in_units,
    mean_sd,
    or_missing,
    percent,
    signed,
    tabulate,
    two_digits,
)
from cassini_bayes.report.page import Chapter, Drawing, Paragraph, Section, TableBlock
from cassini_bayes.report.plots.budget import budget_figure
from cassini_bayes.report.plots.checks import balance_figure, convergence_figure, predictive_figure
from cassini_bayes.report.plots.corners import nuisance_corner
from cassini_bayes.report.plots.delta_v import delta_v_figure, delta_v_thrust_figure
from cassini_bayes.report.plots.nuisances import nuisance_figure, torque_figure
from cassini_bayes.report.plots.quantities import (
    INTERVAL,
    INTERVAL_SHORT,
    MISSING,
    NORMAL_INTERVAL,
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

STOP_RULE: Final = "Stop rule"
FIXED_REPLICATE_S: Final = 1e-9
SIGMAS: Final = ("noise-only", "full", "consider")
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
            partial(nuisance_corner, review, names, title),
            portrait=True,
            fold=f"Corner plot: {title[0].lower()}{title[1:]}",
        )
        for i, (names, title) in enumerate(nuisance_pages(review), start=1)
    )
    yield Section(
        Chapter.NUISANCES,
        (
            Paragraph(Markup("{}{}").format(verdict, rule)),
            Drawing(
                "nuisances",
                "Prior and posterior intervals of every nuisance",
                f"Bars: {INTERVAL} of the posterior in units of the prior's standard deviation, "
                "measured from the prior's mean. Grey: 90 % equal-tailed interval of the prior. "
                "Numbers at the right: posterior and prior, mean ± standard deviation.",
                partial(nuisance_figure, review),
            ),
            TableBlock(nuisance_table(review), fold="Every nuisance in numbers"),
            TableBlock(
                prior_table(review),
                style="words",
                fold="What each parameter means, and where its prior comes from",
            ),
            *corners,
        ),
        name="nuisances",
        frame=review.nuisances,
    )


def torques(review: Review) -> Iterator[Section]:
    """External torques against their priors."""
    drawing = Drawing(
        "torques",
        "Prior and posterior intervals of the external torque of every event",
        f"External torque of each event (integrated out analytically, drawn back): {INTERVAL} in "
        "units of the prior's standard deviation. Grey: 90 % equal-tailed interval of the prior.",
        partial(torque_figure, review),
        fold="External torque of every event",
    )
    yield Section(Chapter.NUISANCES, (drawing,))


def budget(review: Review) -> Iterator[Section]:
    """Where each thrust's variance comes from."""
    if review.budget.empty:
        return
    yield Section(
        Chapter.BUDGET,
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
                partial(budget_figure, review),
            ),
            TableBlock(
                budget_table(review), fold="Error budget of every thruster, mean over events"
            ),
            TableBlock(
                budget_event_table(review),
                fold="Error budget of every thruster in every event",
            ),
        ),
        name="budget",
        frame=review.budget,
    )


def predictive(review: Review) -> Iterator[Section]:
    """On-times of the same biases flown again, where events are totals rows."""
    if review.predictive.empty:
        return
    inside, predicted = coverage(review)
    yield Section(
        Chapter.CHECKS,
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
                partial(predictive_figure, review),
            ),
            TableBlock(predictive_table(review), fold="On-times of every thruster in every event"),
        ),
        title="On-times",
        name="predictive",
        frame=review.predictive,
    )


def balance(review: Review) -> Iterator[Section]:
    """Momentum left over per event and axis."""
    recorded = len(review.model.telemetry)
    yield Section(
        Chapter.CHECKS,
        (
            Drawing(
                "balance",
                "Momentum left over per event and axis",
                balance_caption(
                    telemetry=recorded > 0,
                    totals=review.balance["event"].nunique() > recorded,
                ),
                partial(balance_figure, review),
                fold="Momentum left over, drawn",
            ),
            TableBlock(balance_table(review), fold="Momentum balance of every event and axis"),
        ),
        title="Momentum balance",
        name="balance",
        frame=review.balance,
    )


def balance_caption(*, telemetry: bool, totals: bool) -> str:
    """What is left over, and of what noise, for the kinds of events that there are."""
    of_totals = (
        "Thruster impulse plus external torque minus the change of the wheels' momentum; its noise "
        "is of dead-band rates and attitudes and of rounding. "
    )
    of_telemetry = (
        "Thruster impulse plus external torque up to the last usable row minus the momentum gained "
        "by body and wheels until then; its noise is that of the channels in that row, of the "
        "torque that wanders, and of what counters leave open. "
    )
    told = [f"Totals: {of_totals}", f"Telemetry: {of_telemetry}"]
    what = "".join(told) if telemetry and totals else of_telemetry if telemetry else of_totals
    return (
        f"{what}Symbols and bars: posterior mean and {NORMAL_INTERVAL}. Grey: {NORMAL_INTERVAL} "
        "of the noise that the model allows for."
    )


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
        yield Section(Chapter.DELTA_V, (text, none))
        return
    drawing = Drawing(
        "delta_v",
        "Printed velocity change against the fitted on-board computation",
        "Left: printed ΔV and the fit of the on-board computation. Right: their difference. Thick "
        "bars: the computed value; thin bars: with the channel's own noise, as fitted; both 90 % "
        "intervals (mean ± 1.645 standard deviations).",
        partial(delta_v_figure, review),
        fold="Printed ΔV against the on-board computation, drawn",
    )
    blocks = (text, drawing, TableBlock(delta_v_table(review), fold="ΔV of every event"))
    yield Section(Chapter.DELTA_V, blocks, name="delta_v", frame=review.delta_v)


def variants(review: Review) -> Iterator[Section]:
    """Thrusts under every use of ΔV, where they were asked for."""
    if review.variants.empty:
        return
    drawing = Drawing(
        "delta_v_thrusts",
        "Thrust of every thruster in every bias under three uses of the velocity change",
        f"Posterior mean and {INTERVAL} of every thrust with ΔV left out, as declared, and as if "
        "it had been measured.",
        partial(delta_v_thrust_figure, review),
        fold="Every thrust under the three uses of ΔV, drawn",
    )
    yield Section(
        Chapter.DELTA_V,
        (TableBlock(variant_table(review), style="dense"), drawing),
        title="Thrust under the three uses of ΔV",
        name="variants",
        frame=review.variants,
    )


def convergence(review: Review) -> Iterator[Section]:
    """How well the posterior is sampled."""
    rule = review.facts.get(STOP_RULE, "")
    stated = Paragraph(Markup("<strong>Stop rule:</strong> {}.").format(rule))
    yield Section(
        Chapter.CONVERGENCE,
        (
            *((stated,) if rule else ()),
            Drawing(
                "convergence",
                "R-hat and effective sample sizes of every scalar",
                "Every scalar of the posterior is one symbol: R-hat between independent ensembles, "
                "bulk and tail effective sample size.",
                partial(convergence_figure, review),
                fold="R-hat and effective sample sizes of every scalar, drawn",
            ),
            TableBlock(convergence_table(review), fold="Walked parameters"),
            TableBlock(scalar_table(review), fold=f"Every scalar of the posterior ({INTERVAL})"),
        ),
    )


def nuisance_table(review: Review) -> Table:
    """Prior and posterior of every walked parameter, with the verdict."""
    styles = {"conflict": "flag", "informed": ""}
    table = review.nuisances
    scales = [parameter_scale(review, str(name)) for name in table["name"]]
    shown = ("prior_mean", "prior_sd", "mean", "sd", "hdi_90_low", "hdi_90_high")
    return tabulate(
        in_units(table, scales, *shown),
        {
            "parameter": "name",
            "unit": "unit",
            "prior mean ± sd": mean_sd("prior_mean", "prior_sd"),
            "posterior mean ± sd": mean_sd(),
            INTERVAL_SHORT: between(),
            "narrowed by": as_percent("contraction"),
            "shift [σ]": lambda row: signed(row["surprise"]),
            "verdict": lambda row: Cell(row["verdict"], styles.get(row["verdict"], "muted")),
        },
    )


def prior_table(review: Review) -> Table:
    """What every walked parameter means, and where its prior comes from."""
    columns = ("name", "block", "meaning", "source")
    heads = ("parameter", "block", "meaning", "source of the prior")
    return tabulate(review.nuisances, dict(zip(heads, columns, strict=True)))


def budget_table(review: Review) -> Table:
    """Means over events, one row per thruster."""
    means = review.budget.drop(columns=["event"]).groupby("thruster").mean()
    rows = means.loc[thrusters_of(review)].reset_index()
    return tabulate(rows, {"thruster": "thruster", **_budget_columns(review)})


def budget_event_table(review: Review) -> Table:
    """The error budget of every thruster in every event."""
    columns = {"event": "event", "thruster": "thruster", **_budget_columns(review)}
    return tabulate(review.budget, columns, heads=2)


def _budget_columns(review: Review) -> dict[str, Column]:
    heads = {NOISE_ONLY: "all nuisances known", NONLINEAR: "joint", "noise": "noise scales"}
    sigmas = {name: f"{name.replace(' ', '_').replace('-', '_')}_sd_n" for name in SIGMAS}
    return {f"{name} σ [mN]": _milli(column) for name, column in sigmas.items()} | {
        f"{heads.get(block, block)} [%]": _share(block) for block in budget_blocks(review.budget)
    }


def _milli(column: str) -> Column:
    return lambda row: number(MN * float(row[column]), MN * float(row[column]))


def _share(block: str) -> Column:
    return lambda row: percent(float(row[block + SHARE])).removesuffix(" %")


def coverage(review: Review) -> tuple[int, int]:
    """(on-times inside their interval, on-times that the model predicts)."""
    table = review.predictive
    predicted = table[(table["sd_s"] > FIXED_REPLICATE_S) & table["mean_s"].notna()]
    inside = predicted["measured_s"].between(predicted["hdi_90_low_s"], predicted["hdi_90_high_s"])
    return int(inside.sum()), len(predicted)


def predictive_table(review: Review) -> Table:
    """Measured on-times and replicates; what the limit cycle sets is said to be so."""

    def predicted(row: pd.Series) -> bool:
        return float(row["sd_s"]) > FIXED_REPLICATE_S

    def replicates(row: pd.Series) -> Cell:
        if not predicted(row):
            return Cell("set by the limit cycle", "muted")
        return Cell(plus_minus(row["mean_s"], row["sd_s"]))

    def range_of(row: pd.Series) -> str:
        return interval(row["hdi_90_low_s"], row["hdi_90_high_s"]) if predicted(row) else MISSING

    def tail(row: pd.Series) -> Cell:
        probability = float(row["tail_probability"]) if predicted(row) else np.nan
        return flagged(or_missing(probability, ".3f"), probability < UNLIKELY_TAIL)

    return tabulate(
        review.predictive,
        {
            "event": "event",
            "thruster": "thruster",
            "measured [s]": formatted("measured_s", ".2f"),
            "replicates, mean ± sd [s]": replicates,
            f"{INTERVAL_SHORT} [s]": range_of,
            "tail probability": tail,
        },
        heads=2,
    )


def balance_table(review: Review) -> Table:
    """Momentum left over per event and axis."""
    return tabulate(
        review.balance,
        {
            "event": "event",
            "axis": "axis",
            "momentum left over, mean ± sd [N m s]": mean_sd("residual_n_m_s", "sd_n_m_s"),
            "noise σ [N m s]": two_digits("noise_sd_n_m_s"),
            "in noise σ": lambda row: flagged(
                signed(row["standardised"]), abs(row["standardised"]) > 3
            ),
        },
        heads=2,
    )


def delta_v_table(review: Review) -> Table:
    """Printed ΔV and the fit of the on-board computation."""
    mean, sd = "computed_mean_mm_s", "computed_sd_mm_s"
    return tabulate(
        review.delta_v,
        {
            "event": "event",
            "printed [mm/s]": formatted("printed_mm_s", ".2f"),
            "computed channel, mean ± sd [mm/s]": mean_sd(mean, sd),
            "printed − computed [mm/s]": lambda row: number(
                row["printed_mm_s"] - row[mean], row[sd]
            ),
        },
    )


def variant_table(review: Review) -> Table:
    """Mean thrust under each use of ΔV, and the largest shift against the first use."""
    mean, sd = (
        {
            str(name): grid(item, column, review)
            for name, item in review.variants.groupby("variant", sort=False)
        }
        for column in ("mean_n", "sd_n")
    )
    reference = next(iter(mean))
    shifts = {name: (mean[name] - mean[reference]) / sd[reference] for name in mean}
    rows = pd.DataFrame(
        {
            "use": list(mean),
            "mean": [np.nanmean(thrusts) for thrusts in mean.values()],
            "sd": [np.nanmean(spreads) for spreads in sd.values()],
            "shift": [shift.flat[int(np.nanargmax(np.abs(shift)))] for shift in shifts.values()],
        }
    )
    rows.loc[0, "shift"] = np.nan
    return tabulate(
        rows,
        {
            "use of ΔV": "use",
            "mean of all thrusts [N]": lambda row: number(row["mean"], row["sd"]),
            "mean of their sd [mN]": _milli("sd"),
            f"largest shift against “{reference}” [its sd]": lambda row: signed(
                row["shift"], "+.2f"
            ),
        },
    )


def convergence_table(review: Review) -> Table:
    """Autocorrelation time, R-hat and effective sample size of walked parameters."""
    return tabulate(
        review.convergence,
        {
            "walked parameter": "name",
            "autocorrelation time τ [steps]": formatted("tau_steps", ".1f"),
            "R-hat": lambda row: flagged(or_missing(row["rhat"], ".4f"), row["rhat"] >= 1.01),
            "effective sample": formatted("ess", ".0f"),
        },
    )


def scalar_table(review: Review) -> Table:
    """Every scalar of the posterior with its prior and sampling diagnostics.

    One unit per quantity, so that its rows can be compared.
    """
    table, units = review.summary, {}
    for quantity, rows in table.groupby("quantity"):
        largest = rows[["mean", "prior_mean", "prior_sd"]].abs().max()
        units[quantity] = display_scale(str(rows["unit"].iloc[0]), *map(float, largest))
    shown = ("mean", "sd", "hdi_90_low", "hdi_90_high", "prior_mean", "prior_sd")
    return tabulate(
        in_units(table, [units[quantity] for quantity in table["quantity"]], *shown),
        {
            "scalar": "name",
            "unit": "unit",
            "mean ± sd": mean_sd(),
            INTERVAL_SHORT: between(),
            "prior mean ± sd": mean_sd("prior_mean", "prior_sd"),
            "R-hat": formatted("rhat", ".4f"),
            "ESS bulk": formatted("ess_bulk", ".0f"),
            "ESS tail": formatted("ess_tail", ".0f"),
        },
    )
