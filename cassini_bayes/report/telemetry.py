"""Telemetry in words, tables and figures: what could be seen, inertia both ways, rows used."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Final

import pandas as pd
from markupsafe import Markup

from cassini_bayes.report.cells import Cell, Table, percent
from cassini_bayes.report.page import (
    CHECKS,
    INERTIA,
    NUISANCES,
    NUMBERS,
    SEEN,
    Bullets,
    Drawing,
    Paragraph,
    Section,
    Shown,
)
from cassini_bayes.report.plots.quantities import (
    INTERVAL,
    MISSING,
    display_scale,
    number,
    observed_name,
    plus_minus,
)
from cassini_bayes.results.review import Review

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure
    from cassini_bayes.results.time_series import EventSeries

MICRO: Final = 1e6
MOMENTS: Final = ("xx", "yy", "zz")


def observability(review: Review) -> Iterator[Section]:
    """Expected width of every quantity, before anything is sampled."""
    if not review.model.telemetry:
        return
    yield Section(
        SEEN,
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
                partial(_observability_figure, review),
            ),
            Shown(observability_table(review), fold="Expected width of every quantity"),
        ),
        name="observability",
        frame=review.observability.table,
    )


def _observability_figure(review: Review) -> Figure:
    from cassini_bayes.report.plots.inertia import observability_figure

    return observability_figure(review)


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
        INERTIA,
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
            Shown(inertia_table(review)),
            Paragraph(review.physicality.sentence),
            Drawing(
                "inertia",
                "Elements of the inertia tensor: prior, posterior, least squares",
                caption,
                partial(_inertia_figure, review),
            ),
        ),
        name="inertia",
        frame=review.inertia,
    )


def _inertia_figure(review: Review) -> Figure | None:
    from cassini_bayes.report.plots.inertia import inertia_figure

    return inertia_figure(review)


def inertia_methods(review: Review) -> Iterator[Section]:
    """The papers' least squares for the inertia, where there are slews."""
    if not review.inertia_methods.empty:
        yield Section(
            INERTIA,
            (Shown(method_table(review)),),
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
            NUMBERS,
            (text, *(Shown(table, fold=table.title) for table in tables)),
            title="The papers' estimates from the same telemetry",
        )


def torque_methods(review: Review) -> Iterator[Section]:
    """Torques from the wheels' drift, where an event is quiescent."""
    if not review.torque_methods.empty:
        yield Section(
            NUISANCES,
            (
                Paragraph(
                    "While nothing fires and nothing turns, an external torque shows as a drift of "
                    "the wheels (paper 000, App. A): wheel inertias times drift rates, beside the "
                    "posterior."
                ),
                Shown(torque_table(review)),
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
        CHECKS,
        (
            Paragraph(
                "The balance of every row that enters the likelihood, at the posterior. Rows taken "
                "while a pulse was being delivered are left out by design. The noise band holds "
                "white channel noise and the torque noise of the fit; 90 % of rows should lie "
                "inside."
            ),
            Shown(event_table(review)),
            *mends,
        ),
        title="Telemetry, row by row",
        name="telemetry",
        frame=review.events,
    )


def series(review: Review) -> Iterator[Section]:
    """The balance of every telemetry event, row by row."""
    for i, own in enumerate(review.series, start=1):
        above = (
            "angular momentum gained since the first row (body and wheels) against what thrusters "
            "and torque delivered"
            if own.quantity == "momentum gained"
            else "the body's own angular momentum against what the conserved total leaves to it"
        )
        drawing = Drawing(
            f"series_{i}",
            f"Measured and predicted angular momentum of {own.event} and their difference",
            f"{own.event}, above: {above}. Below: the difference, on the noise that the model "
            "allows for.",
            partial(_series_figure, own),
        )
        yield Section(CHECKS, (drawing,), name=f"series_{i}", frame=own.table())


def _series_figure(own: EventSeries) -> Figure:
    from cassini_bayes.report.plots.time_series import series_figure

    return series_figure(own)


def inertia_sentence(review: Review) -> list[str]:
    """The three moments of inertia in a sentence; nothing without telemetry."""
    if not review.model.telemetry:
        return []
    table = review.inertia.set_index("element")
    values = ", ".join(_moment(table, element) for element in MOMENTS)
    return [
        f"The moments of inertia about X, Y, Z are {values} kg m² (mean ± standard deviation; "
        "about the centre of mass, wheels included as if not spinning)."
    ]


def _moment(table: pd.DataFrame, element: str) -> str:
    return plus_minus(
        float(table.loc[element, "mean_kg_m2"]), float(table.loc[element, "sd_kg_m2"])
    )


def inertia_numbers(review: Review) -> list[tuple[str, str]]:
    """The moments of inertia for the head of the page."""
    if not review.model.telemetry:
        return []
    table = review.inertia.set_index("element")
    return [(f"inertia {e}", f"{_moment(table, e)} kg m²") for e in MOMENTS]


def inertia_table(review: Review) -> Table:
    """All six elements: prior, posterior with the stationary wheels, and without their spin."""
    rows = tuple(
        (
            Cell(f"I {row['element']}"),
            Cell(plus_minus(row["prior_mean_kg_m2"], row["prior_sd_kg_m2"])),
            Cell(plus_minus(row["mean_kg_m2"], row["sd_kg_m2"])),
            Cell(plus_minus(row["without_wheels_mean_kg_m2"], row["without_wheels_sd_kg_m2"])),
            Cell(
                number(
                    row["mean_kg_m2"] - row["without_wheels_mean_kg_m2"],
                    0.01 * max(abs(row["mean_kg_m2"] - row["without_wheels_mean_kg_m2"]), 1e-3),
                )
            ),
        )
        for _, row in review.inertia.iterrows()
    )
    return Table(
        (
            "element",
            "prior mean ± sd [kg m²]",
            "posterior, stationary wheels included, mean ± sd [kg m²]",
            "posterior, less the wheels' spin inertia, mean ± sd [kg m²]",
            "difference of the means [kg m²]",
        ),
        rows,
    )


def method_table(review: Review) -> Table:
    """The papers' estimates of the inertia, one row per method and events."""
    table = review.inertia_methods
    elements = list(dict.fromkeys(table["element"]))
    rows = []
    for label, own in table.groupby("label", sort=False):
        by_element = own.set_index("element")
        rows.append(
            (
                Cell(str(label)),
                *(_estimate(by_element.loc[e]) if e in by_element.index else Cell(MISSING)
                  for e in elements),
            )
        )  # fmt: skip
    after = review.inertia.set_index("element")
    rows.append(
        (
            Cell("posterior of this run"),
            *(Cell(plus_minus(after.loc[e, "mean_kg_m2"], after.loc[e, "sd_kg_m2"]))
              for e in elements),
        )
    )  # fmt: skip
    return Table(("method", *(f"I {e} [kg m²]" for e in elements)), tuple(rows))


def _estimate(row: pd.Series) -> Cell:
    estimate, bar = float(row["estimate_kg_m2"]), float(row["bar_rss_kg_m2"])
    if estimate != estimate:
        return Cell(MISSING, "muted")
    return Cell(plus_minus(estimate, bar))


def thrust_method_tables(review: Review) -> list[Table]:
    """The papers' thrust estimates of every telemetry event, one table each: methods by thruster.

    † marks on-times below 5 s, not valid by the papers' own rule.
    """
    if review.baseline.empty:
        return []
    tables = []
    for event in [term.id for term in review.model.telemetry if term.event.fires]:
        own = review.baseline[review.baseline["event"] == event]
        if own.empty:
            continue
        names = list(dict.fromkeys(own["thruster"]))
        rows = []
        for method, estimates in own.groupby("method", sort=False):
            by_name = estimates.set_index("thruster")
            label = str(method).replace(", per event", "")
            label += "" if "," in label else ", divided by T"
            cells = (
                _thrust(by_name.loc[n]) if n in by_name.index else Cell(MISSING, "muted")
                for n in names
            )
            rows.append((Cell(label), *cells))
        columns = ("method", *(f"{name} [N]" for name in names))
        tables.append(Table(columns, tuple(rows), title=str(event)))
    return tables


def _thrust(row: pd.Series) -> Cell:
    text = plus_minus(float(row["estimate_n"]), float(row["bar_rss_n"]))
    return Cell(text) if row["valid"] else Cell(f"{text} †", "muted")


def torque_table(review: Review) -> Table:
    """External torque of quiescent events: from the wheels' drift, and the posterior."""
    summary = review.summary[review.summary["quantity"] == "external_torque_n_m"]
    after = summary.set_index(["event", "item"])
    rows = []
    for _, row in review.torque_methods.iterrows():
        own = after.loc[(row["event"], row["axis"])]
        rows.append(
            (
                Cell(str(row["event"])),
                Cell(str(row["axis"])),
                Cell(plus_minus(MICRO * row["estimate_n_m"], MICRO * row["bar_rss_n_m"])),
                Cell(plus_minus(MICRO * own["mean"], MICRO * own["sd"])),
                Cell(plus_minus(MICRO * own["prior_mean"], MICRO * own["prior_sd"])),
            )
        )
    return Table(
        (
            "event",
            "axis",
            "from the wheels' drift ± perturbations (rss) [µN m]",
            "posterior mean ± sd [µN m]",
            "prior mean ± sd [µN m]",
        ),
        tuple(rows),
        heads=2,
    )


def event_table(review: Review) -> Table:
    """Telemetry events: rows read and used, and how many of them the noise explains."""
    rows = tuple(
        (
            Cell(str(row["event"])),
            Cell(str(row["kind"])),
            Cell(f"{row['duration_s']:.0f}"),
            Cell(f"{row['rows_read']:,}"),
            Cell(f"{row['rows_used']:,}"),
            *(Cell(percent(float(row[f"inside_90_{axis}"]))) for axis in "xyz"),
        )
        for _, row in review.events.iterrows()
    )
    return Table(
        (
            "event",
            "kind",
            "duration [s]",
            "rows read",
            "rows in the balance",
            *(f"inside the 90 % band, {axis}" for axis in "xyz"),
        ),
        rows,
    )


def observability_table(review: Review) -> Table:
    """Expected posterior over prior width of every quantity."""
    rows = []
    for _, row in review.observability.table.iterrows():
        scale = display_scale(str(row["unit"]), float(row["prior_sd"]), float(row["expected_sd"]))
        before, after = (float(row[c]) * scale.factor for c in ("prior_sd", "expected_sd"))
        rows.append(
            (
                Cell(observed_name(str(row["quantity"]))),
                Cell(scale.unit),
                Cell(number(before, before)),
                Cell(number(after, after)),
                Cell(percent(float(row["ratio"]))),
                Cell(str(row["verdict"]), "muted" if row["verdict"] == "not seen" else ""),
            )
        )
    return Table(
        ("quantity", "unit", "prior sd", "expected sd", "expected / prior", "verdict"), tuple(rows)
    )
