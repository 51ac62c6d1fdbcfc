"""The report of a run: one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path

from cassini_bayes.files.storage import write_text
from cassini_bayes.report.page import Section
from cassini_bayes.report.plots import Picture
from cassini_bayes.report.plots.quantities import INTERVAL, INTERVAL_SHORT
from cassini_bayes.report.plots.tables import all_events_of, events_of
from cassini_bayes.report.sections import figures_of, pictures_of, sections_of, write_tables
from cassini_bayes.report.sweep import with_section
from cassini_bayes.report.telemetry import inertia_numbers
from cassini_bayes.report.templating import address_of, rendered
from cassini_bayes.report.thrusts import key_numbers, summary_sentences
from cassini_bayes.report.verdict import NOT_CONVERGED, verdict
from cassini_bayes.results.review import Review, is_converged

__all__ = [
    "figures_of",
    "pictures_of",
    "render_report",
    "sections_of",
    "write_report",
    "write_tables",
]


def write_report(
    review: Review,
    sections: Sequence[Section],
    pictures: Mapping[str, Picture],
    path: Path,
    sweep: str = "",
) -> None:
    """Write the report as one self-contained HTML file, atomically.

    Pictures are inside the page (SVG; corner plots PNG); it uses no script, font or network.
    ``sweep`` is the section of a sweep of the same fit.

    Raises
    ------
    InputError
        The place cannot be written.
    """
    html = render_report(review, sections, pictures)
    write_text(path, with_section(html, sweep) if sweep else html)


def render_report(
    review: Review, sections: Sequence[Section], pictures: Mapping[str, Picture]
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
        doubt="" if is_converged(review) else NOT_CONVERGED,
        verdict=verdict(review),
        summary=summary_sentences(review),
        key_numbers=[*inertia_numbers(review), *key_numbers(review)],
        pictures={name: _address(picture) for name, picture in pictures.items()},
        chapters=[
            (chapter, list(group)) for chapter, group in groupby(sections, lambda own: own.chapter)
        ],
    )


def _address(picture: Picture) -> str:
    kind, content = picture.shown
    return address_of(content, {"svg": "image/svg+xml", "png": "image/png"}[kind])
