"""Telemetry in words and tables: inertia both ways, what could be seen, rows used."""

from __future__ import annotations

from typing import Final

import pandas as pd

from cassini_bayes.report.cells import Cell, Table, percent
from cassini_bayes.report.plots.inertia import observed_name
from cassini_bayes.report.plots.quantities import MISSING, display_scale, number, plus_minus
from cassini_bayes.results.review import Review

MICRO: Final = 1e6
MOMENTS: Final = ("xx", "yy", "zz")


def inertia_sentence(review: Review) -> list[str]:
    """The three moments of inertia in a sentence; nothing without telemetry."""
    if review.telemetry is None:
        return []
    table = review.telemetry.inertia.set_index("element")
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
    if review.telemetry is None:
        return []
    table = review.telemetry.inertia.set_index("element")
    return [(f"inertia {e}", f"{_moment(table, e)} kg m²") for e in MOMENTS]


def inertia_table(review: Review) -> Table | None:
    """All six elements: prior, posterior with the stationary wheels, and without their spin."""
    if review.telemetry is None:
        return None
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
        for _, row in review.telemetry.inertia.iterrows()
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


def method_table(review: Review) -> Table | None:
    """The papers' estimates of the inertia, one row per method and events."""
    if review.telemetry is None or review.telemetry.inertia_methods.empty:
        return None
    table = review.telemetry.inertia_methods
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
    after = review.telemetry.inertia.set_index("element")
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
    if review.telemetry is None or review.baseline.empty:
        return []
    tables = []
    for event in review.telemetry.events["event"]:
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


def torque_table(review: Review) -> Table | None:
    """External torque of quiescent events: from the wheels' drift, and the posterior."""
    if review.telemetry is None or review.telemetry.torque_methods.empty:
        return None
    summary = review.summary[review.summary["quantity"] == "external_torque_n_m"]
    after = summary.set_index(["event", "item"])
    rows = []
    for _, row in review.telemetry.torque_methods.iterrows():
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


def event_table(review: Review) -> Table | None:
    """Telemetry events: rows read and used, and how many of them the noise explains."""
    if review.telemetry is None:
        return None
    rows = tuple(
        (
            Cell(str(row["event"])),
            Cell(str(row["kind"])),
            Cell(f"{row['duration_s']:.0f}"),
            Cell(f"{row['rows_read']:,}"),
            Cell(f"{row['rows_used']:,}"),
            *(Cell(percent(float(row[f"inside_90_{axis}"]))) for axis in "xyz"),
        )
        for _, row in review.telemetry.events.iterrows()
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


def observability_table(review: Review) -> Table | None:
    """Expected posterior over prior width of every quantity."""
    if review.telemetry is None:
        return None
    rows = []
    for _, row in review.telemetry.observability.table.iterrows():
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
