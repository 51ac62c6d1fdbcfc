"""Results of prediction, by one command: ``cassini-bayes calibrate prediction``.

Writes the page, its CSV and its figures: leave-one-event-out over the flight events beside the
published columns, the ΔV requirement, the ground-software method, and what the priors of the firing
logic change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from cassini_bayes.events.totals import read_totals
from cassini_bayes.files.storage import write_bytes, write_text
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.report.plots import encode
from cassini_bayes.report.plots.prediction import (
    leave_one_out_figure,
    requirement_figure,
    totals_figure,
)
from cassini_bayes.studies.prediction.page import page_text
from cassini_bayes.studies.prediction.study import COLUMNS, Study, run_study, table_csv

__all__ = ["Study", "page_text", "prediction_results", "run_study"]


def prediction_results(
    events: str,
    priors: str,
    page: Path,
    *,
    seed: int,
    command: Sequence[str],
    progress: Callable[[str, int, int], None],
) -> Study:
    """Run the study and write its page, table and figures."""
    read = read_priors(priors)
    flight = read_totals(events, read.spacecraft)
    columns = {source: read_totals(events, read.spacecraft, source) for source in COLUMNS}
    study = run_study(flight, columns, read, seed, progress)
    figures = {
        "": leave_one_out_figure(study.folds, columns),
        "_totals": totals_figure(study.folds, columns),
        "_requirement": requirement_figure(
            {name: found[2] for name, found in study.requirement.items()}
        ),
    }
    for suffix, figure in figures.items():
        write_bytes(page.with_name(f"{page.stem}{suffix}.png"), encode(figure, "png"))
    write_text(page.with_suffix(".csv"), table_csv(study))
    write_text(page, page_text(study, read, page.stem, seed, command))
    return study
