"""The report of a run: one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from cassini_bayes.files.storage import write_text
from cassini_bayes.report.page import Section
from cassini_bayes.report.plots import encode, is_corner
from cassini_bayes.report.plots.quantities import INTERVAL, INTERVAL_SHORT
from cassini_bayes.report.plots.tables import all_events_of, events_of
from cassini_bayes.report.sections import figures_of, sections_of, write_tables
from cassini_bayes.report.telemetry import inertia_numbers, inertia_sentence
from cassini_bayes.report.templating import address_of, rendered
from cassini_bayes.report.thrusts import key_numbers, summary_sentences
from cassini_bayes.results.review import Review

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure

__all__ = ["figures_of", "render_report", "sections_of", "write_report", "write_tables"]


def write_report(
    review: Review, sections: Sequence[Section], figures: Mapping[str, Figure], path: Path
) -> None:
    """Write the report as one self-contained HTML file, atomically.

    Pictures are inside the page (SVG; corner plots PNG); it uses no script, font or network.

    Raises
    ------
    InputError
        The place cannot be written.
    """
    write_text(path, render_report(review, sections, figures))


def render_report(
    review: Review, sections: Sequence[Section], figures: Mapping[str, Figure]
) -> str:
    """The report as HTML; every text of the review is escaped."""
    return rendered(
        "report.html.jinja",
        name=review.name,
        warnings=review.warnings,
        facts=review.facts,
        interval=INTERVAL,
        interval_short=INTERVAL_SHORT,
        n_events=len(all_events_of(review)),
        has_thrusts=bool(events_of(review)),
        has_telemetry=bool(review.model.telemetry),
        summary=[*inertia_sentence(review), *summary_sentences(review)],
        key_numbers=[*inertia_numbers(review), *key_numbers(review)],
        pictures={name: _address(name, figure) for name, figure in figures.items()},
        chapters=[
            (chapter, list(own)) for chapter, own in groupby(sections, lambda own: own.chapter)
        ],
    )


def _address(name: str, figure: Figure) -> str:
    kind, media = ("png", "image/png") if is_corner(name) else ("svg", "image/svg+xml")
    return address_of(encode(figure, "png" if kind == "png" else "svg"), media)
