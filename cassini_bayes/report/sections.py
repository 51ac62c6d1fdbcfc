"""The registry of a run's tables: one function each for file, section and figure.

A function takes the review and yields a :class:`~cassini_bayes.report.page.Section`, or nothing
where it has nothing to say. To add a table, write one and name it in :data:`SECTIONS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cassini_bayes.files.storage import write_text
from cassini_bayes.files.tables import frame_csv
from cassini_bayes.report import checks, priors, telemetry, thrusts
from cassini_bayes.report.page import Section
from cassini_bayes.report.plots import Picture, draw, draw_encoded
from cassini_bayes.results.review import Review

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure

SECTIONS: Final[tuple[Callable[[Review], Iterator[Section]], ...]] = (
    telemetry.observability,
    telemetry.inertia,
    telemetry.inertia_methods,
    thrusts.thrusts,
    thrusts.thrust_numbers,
    telemetry.thrust_methods,
    thrusts.joint,
    priors.prior_slider,
    checks.nuisances,
    checks.torques,
    telemetry.torque_methods,
    checks.budget,
    telemetry.telemetry,
    telemetry.series,
    checks.predictive,
    checks.balance,
    checks.delta_v,
    checks.variants,
    checks.convergence,
)
"""In the order of the page."""


def sections_of(review: Review) -> tuple[Section, ...]:
    """All sections of a run's report."""
    return tuple(section for make in SECTIONS for section in make(review))


def write_tables(sections: Sequence[Section], folder: Path) -> None:
    """The sections' tables as CSV, ``<name>.csv`` each.

    Raises
    ------
    InputError
        The place cannot be written.
    """
    for section in sections:
        if section.frame is not None:
            write_text(folder / f"{section.name}.csv", frame_csv(section.frame))


def figures_of(sections: Sequence[Section]) -> dict[str, Figure]:
    """Every figure by name, in the order of the page; one with nothing to show is absent."""
    return draw(_drawings(sections))


def pictures_of(sections: Sequence[Section], processes: int = 1) -> dict[str, Picture]:
    """The same as files, drawn in several processes."""
    return draw_encoded(_drawings(sections), processes)


def _drawings(sections: Sequence[Section]) -> dict[str, Callable[[], Figure | None]]:
    return {drawing.name: drawing.draw for section in sections for drawing in section.drawings}
