"""Telemetry in words, tables and figures: what could be seen, inertia both ways, rows used."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Final

import pandas as pd
from markupsafe import Markup

from cassini_bayes.balance.statistics import BLOCK_S
from cassini_bayes.report.cells import (
    Cell,
    Table,
    as_percent,
    formatted,
    in_units,
    mean_sd,
    tabulate,
    two_digits,
)
from cassini_bayes.report.page import Bullets, Chapter, Drawing, Paragraph, Section, TableBlock
from cassini_bayes.report.plots.inertia import inertia_figure, observability_figure
from cassini_bayes.report.plots.quantities import (
    INTERVAL,
    MISSING,
    display_scale,
    number,
    observed_name,
    plus_minus,
)
from cassini_bayes.report.plots.time_series import series_figure
from cassini_bayes.report.verdict import MOMENTS
from cassini_bayes.results.review import Review

MICRO: Final = 1e6


def observability(review: Review) -> Iterator[Section]:
    """Expected width of every quantity, before anything is sampled."""
    if not review.model.telemetry:
        return
    yield Section(
        Chapter.OBSERVABILITY,
        (
            Paragraph(
                "Worked out before sampling, at the prior means, from the same columns as the "
                "likelihood: how narrow the posterior can be expected to be. Noise levels are told "
                "by the scatter of the rows and are not in this table."
            ),
            Bullets(review.observability.sentences),
            Drawing(
                "observability",
                "Expected and obtained posterior over prior width of thrust levels, inertia and "
                "nuisances",
                "Bars: posterior over prior standard deviation expected before sampling. Circles: "
                "what came out.",
                partial(observability_figure, review),
                fold="Expected before sampling and what came out, drawn",
            ),
            TableBlock(observability_table(review), fold="Expected width of every quantity"),
        ),
        name="observability",
        frame=review.observability.table,
    )


def inertia(review: Review) -> Iterator[Section]:
    """The inertia tensor both ways."""
    if not review.model.telemetry:
        return
    caption = (
        f"Posterior mean and {INTERVAL} of every element; shaded: 90 % equal-tailed interval of "
        "the prior."
    )
    if not review.inertia_methods.empty:
        caption += (
            " Diamonds: the papers' least squares on the same telemetry, with the root sum square "
            "of the shifts from their hand-picked perturbations."
        )
    yield Section(
        Chapter.INERTIA,
        (
            Paragraph(
                Markup(
                    "Two conventions. <em>Stationary wheels included</em>: the tensor I about the "
                    "centre of mass with the wheels as if not spinning relative to the body; wheel "
                    "momentum then counts spin relative to the body (the papers' convention). "
                    "<em>Less the wheels' spin inertia</em>: I − Σ I<sub>w</sub> a aᵀ over the "
                    "wheels in use, which goes with wheel momentum at inertial spin rates (as in "
                    "Basilisk's equations for balanced wheels); the wheels' mass and transverse "
                    "inertia stay in both."
                )
            ),
            TableBlock(inertia_table(review)),
            Paragraph(review.physicality.sentence),
            Drawing(
                "inertia",
                "Elements of the inertia tensor: prior, posterior, least squares",
                caption,
                partial(inertia_figure, review),
                fold="The inertia tensor, drawn",
            ),
        ),
        name="inertia",
        frame=review.inertia,
    )


def inertia_methods(review: Review) -> Iterator[Section]:
    """The papers' least squares for the inertia, where there are slews."""
    if not review.inertia_methods.empty:
        yield Section(
            Chapter.INERTIA,
            (TableBlock(method_table(review)),),
            title="The methods it replaces",
            name="inertia_methods",
            frame=review.inertia_methods,
        )


def thrust_methods(review: Review) -> Iterator[Section]:
    """The papers' thrusts of telemetry, event by event; their file is that of all methods."""
    tables = thrust_method_tables(review)
    if tables:
        text = Paragraph(
            "Least squares over the rows of one event (paper 000 eqs. 18–23): one unknown per "
            "thruster or per pair that always fires together; one for all paired thrusters; one "
            "for all. Pulses are taken as rectangular, then the estimate is divided by T (paper "
            "003 eq. 7) or by the impulse ratio R (paper 000), both at the prior mean of the "
            "tail-off. Bars: root sum square of the shifts from the hand-picked perturbations. "
            "† on-time below 5 s."
        )
        yield Section(
            Chapter.NUMBERS,
            (text, *(TableBlock(table, fold=table.title) for table in tables)),
            title="The papers' estimates from the same telemetry",
        )


def torque_methods(review: Review) -> Iterator[Section]:
    """Torques from the wheels' drift, where an event is quiescent."""
    if not review.torque_methods.empty:
        yield Section(
            Chapter.NUISANCES,
            (
                Paragraph(
                    "While nothing fires and nothing turns, an external torque shows as a drift of "
                    "the wheels (paper 000, App. A): wheel inertias times drift rates, beside the "
                    "posterior."
                ),
                TableBlock(torque_table(review)),
            ),
            title="Torque of quiescent events",
            name="torque_methods",
            frame=review.torque_methods,
        )


def telemetry(review: Review) -> Iterator[Section]:
    """Rows read and used of every telemetry event."""
    if not review.model.telemetry:
        return
    mends = (Paragraph("Mended while reading:"), Bullets(review.mends)) if review.mends else ()
    yield Section(
        Chapter.CHECKS,
        (
            Paragraph(
                "The balance of every row that enters the likelihood, at the posterior. Rows taken "
                "while a pulse was being delivered are left out by design. Where hardly any others "
                f"are, rows are means over {BLOCK_S:g} s, and what is late in them is noise. The "
                "noise band holds white channel noise and the torque noise of the fit; 90 % of "
                "rows should lie inside."
            ),
            TableBlock(event_table(review)),
            *mends,
        ),
        title="Telemetry, row by row",
        name="telemetry",
        frame=review.events,
    )


def series(review: Review) -> Iterator[Section]:
    """The balance of every telemetry event, row by row."""
    for i, series in enumerate(review.series, start=1):
        above = (
            "angular momentum gained since the first row (body and wheels) against what thrusters "
            "and torque delivered"
            if series.quantity == "momentum gained"
            else "the body's own angular momentum against what the conserved total leaves to it"
        )
        drawing = Drawing(
            f"series_{i}",
            f"Measured and predicted angular momentum of {series.event} and their difference",
            f"{series.event}, above: {above}. Below: the difference, on the noise that the model "
            "allows for.",
            partial(series_figure, series),
            fold=f"{series.event}, drawn" if i > 1 else "",
        )
        yield Section(Chapter.CHECKS, (drawing,), name=f"series_{i}", frame=series.table())


def inertia_numbers(review: Review) -> list[tuple[str, str]]:
    """The moments of inertia for the head of the page."""
    if not review.model.telemetry:
        return []
    table = review.inertia.set_index("element")[["mean_kg_m2", "sd_kg_m2"]].astype(float)
    return [(f"inertia {e}", f"{plus_minus(*table.loc[e])} kg m²") for e in MOMENTS]


def inertia_table(review: Review) -> Table:
    """All six elements: prior, posterior with the stationary wheels, and without their spin."""

    def difference(row: pd.Series) -> str:
        shift = row["mean_kg_m2"] - row["without_wheels_mean_kg_m2"]
        return number(shift, 0.01 * max(abs(shift), 1e-3))

    included = "posterior, stationary wheels included, mean ± sd [kg m²]"
    less = "posterior, less the wheels' spin inertia, mean ± sd [kg m²]"
    without = mean_sd("without_wheels_mean_kg_m2", "without_wheels_sd_kg_m2")
    return tabulate(
        review.inertia,
        {
            "element": lambda row: f"I {row['element']}",
            "prior mean ± sd [kg m²]": mean_sd("prior_mean_kg_m2", "prior_sd_kg_m2"),
            included: mean_sd("mean_kg_m2", "sd_kg_m2"),
            less: without,
            "difference of the means [kg m²]": difference,
        },
    )


def method_table(review: Review) -> Table:
    """The papers' estimates of the inertia, one row per method and events."""
    table = review.inertia_methods
    posterior = review.inertia.assign(label="posterior of this run").rename(
        columns={"mean_kg_m2": "estimate_kg_m2", "sd_kg_m2": "bar_rss_kg_m2"}
    )
    rows = pd.concat([table, posterior[posterior["element"].isin(table["element"])]])
    return _wide(rows, "element", "I {} [kg m²]", _inertia)


def thrust_method_tables(review: Review) -> list[Table]:
    """The papers' thrust estimates of every telemetry event, one table each: methods by thruster.

    † marks on-times below 5 s, not valid by the papers' own rule.
    """
    if review.baseline.empty:
        return []
    fired = [term.id for term in review.model.telemetry if term.event.fires]
    rows = review.baseline.assign(label=[_method(str(m)) for m in review.baseline["method"]])
    return [
        replace(_wide(selected, "thruster", "{} [N]", _thrust), title=event)
        for event in fired
        if not (selected := rows[rows["event"] == event]).empty
    ]


def _wide(rows: pd.DataFrame, item: str, head: str, cell: Callable[[pd.Series], Cell]) -> Table:
    """Methods one under another, one column per ``item``; a dash where there is nothing."""
    items, labels = (list(dict.fromkeys(rows[column])) for column in (item, "label"))
    cells = {(row["label"], row[item]): cell(row) for _, row in rows.iterrows()}
    return Table(
        ("method", *(head.format(name) for name in items)),
        tuple(
            (Cell(label), *(cells.get((label, entry), Cell(MISSING, "muted")) for entry in items))
            for label in labels
        ),
    )


def _method(name: str) -> str:
    label = name.replace(", per event", "")
    return label if "," in label else f"{label}, divided by T"


def _inertia(row: pd.Series) -> Cell:
    text = plus_minus(float(row["estimate_kg_m2"]), float(row["bar_rss_kg_m2"]))
    return Cell(text, "muted" if text == MISSING else "")


def _thrust(row: pd.Series) -> Cell:
    text = plus_minus(float(row["estimate_n"]), float(row["bar_rss_n"]))
    return Cell(text) if row["valid"] else Cell(f"{text} †", "muted")


def torque_table(review: Review) -> Table:
    """External torque of quiescent events: from the wheels' drift, and the posterior."""
    posterior = review.summary[review.summary["quantity"] == "external_torque_n_m"]
    rows = review.torque_methods.merge(
        posterior.rename(columns={"item": "axis"}), on=["event", "axis"], how="left"
    )
    values = ["estimate_n_m", "bar_rss_n_m", "mean", "sd", "prior_mean", "prior_sd"]
    rows[values] *= MICRO
    return tabulate(
        rows,
        {
            "event": "event",
            "axis": "axis",
            "from the wheels' drift ± perturbations (rss) [µN m]": mean_sd(*values[:2]),
            "posterior mean ± sd [µN m]": mean_sd(),
            "prior mean ± sd [µN m]": mean_sd("prior_mean", "prior_sd"),
        },
        heads=2,
    )


def event_table(review: Review) -> Table:
    """Telemetry events: rows read and used, and how many of them the noise explains."""
    return tabulate(
        review.events,
        {
            "event": "event",
            "kind": "kind",
            "duration [s]": formatted("duration_s", ".0f"),
            "rows read": lambda row: f"{row['rows_read']:,}",
            "rows in the balance": lambda row: f"{row['rows_used']:,}",
            **{f"inside the 90 % band, {axis}": as_percent(f"inside_90_{axis}") for axis in "xyz"},
        },
    )


def observability_table(review: Review) -> Table:
    """Expected posterior over prior width of every quantity."""

    def verdict(row: pd.Series) -> Cell:
        return Cell(row["verdict"], "muted" if row["verdict"] == "not seen" else "")

    table = review.observability.table
    widths = table[["unit", "prior_sd", "expected_sd"]].itertuples(index=False)
    return tabulate(
        in_units(table, [display_scale(*width) for width in widths], "prior_sd", "expected_sd"),
        {
            "quantity": lambda row: observed_name(row["quantity"]),
            "unit": "unit",
            "prior sd": two_digits("prior_sd"),
            "expected sd": two_digits("expected_sd"),
            "expected / prior": as_percent("ratio"),
            "verdict": verdict,
        },
    )
