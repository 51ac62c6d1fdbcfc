"""The report of a run: one HTML file that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from jinja2 import Environment, PackageLoader, StrictUndefined

from cassini_bayes.files.storage import write_text
from cassini_bayes.report.checks import (
    balance_table,
    budget_event_table,
    budget_table,
    convergence_table,
    coverage,
    delta_v_table,
    nuisance_table,
    predictive_table,
    prior_table,
    scalar_table,
    variant_table,
)
from cassini_bayes.report.plots import Figure, encode, is_corner
from cassini_bayes.report.plots.quantities import INTERVAL, INTERVAL_SHORT
from cassini_bayes.report.plots.tables import all_events_of, events_of
from cassini_bayes.report.telemetry import (
    event_table,
    inertia_numbers,
    inertia_sentence,
    inertia_table,
    method_table,
    observability_table,
    thrust_method_tables,
    torque_table,
)
from cassini_bayes.report.thrusts import (
    key_numbers,
    summary_sentences,
    thrust_matrix,
    thrust_tables,
)
from cassini_bayes.results.review import Review

__all__ = ["render_report", "write_report"]

STOP_RULE: Final = "Stop rule"


@dataclass(frozen=True)
class Picture:
    """A figure as a data address, and whether it is wide enough to need enlarging on a phone."""

    name: str
    address: str


def write_report(review: Review, figures: Mapping[str, Figure], path: Path) -> None:
    """Write the report as one self-contained HTML file, atomically.

    Pictures are inside the page (SVG; corner plots PNG); it uses no script, font or network.

    Raises
    ------
    InputError
        The place cannot be written.
    """
    write_text(path, render_report(review, figures))


def render_report(review: Review, figures: Mapping[str, Figure]) -> str:
    """The report as HTML; every text of the review is escaped."""
    environment = Environment(
        loader=PackageLoader("cassini_bayes", "report/templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    has_budget = not review.budget.empty
    return environment.get_template("report.html.jinja").render(
        name=review.name,
        warnings=review.warnings,
        facts=review.facts,
        interval=INTERVAL,
        interval_short=INTERVAL_SHORT,
        n_events=len(all_events_of(review)),
        has_thrusts=bool(events_of(review)),
        telemetry=review.telemetry,
        telemetry_events=event_table(review),
        inertia=inertia_table(review),
        inertia_methods=method_table(review),
        thrust_methods=thrust_method_tables(review),
        torques=torque_table(review),
        observability=observability_table(review),
        summary=[*inertia_sentence(review), *summary_sentences(review)],
        key_numbers=[*inertia_numbers(review), *key_numbers(review)],
        pictures={name: Picture(name, _address(name, figure)) for name, figure in figures.items()},
        thrust_matrix=thrust_matrix(review),
        thrust_events=thrust_tables(review),
        has_baseline=not review.baseline.empty,
        nuisances=nuisance_table(review),
        priors=prior_table(review),
        conflicts=list(review.nuisances[review.nuisances["verdict"] == "conflict"]["name"]),
        budget=budget_table(review),
        budget_events=budget_event_table(review) if has_budget else None,
        predictive=predictive_table(review) if not review.predictive.empty else None,
        coverage=coverage(review),
        balance=balance_table(review),
        delta_v=delta_v_table(review),
        variants=variant_table(review),
        convergence=convergence_table(review),
        scalars=scalar_table(review),
        stop_rule=review.facts.get(STOP_RULE, ""),
    )


def _address(name: str, figure: Figure) -> str:
    kind, media = ("png", "image/png") if is_corner(name) else ("svg", "image/svg+xml")
    content = encode(figure, "png" if kind == "png" else "svg")
    return f"data:{media};base64,{base64.b64encode(content).decode('ascii')}"
