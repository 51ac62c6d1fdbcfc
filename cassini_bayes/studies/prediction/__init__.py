"""Results of prediction, by one command: ``cassini-bayes calibrate prediction``.

Writes the page, its CSV and its figures: leave-one-event-out over the flight events beside the
published columns, the ΔV requirement, the ground-software method, and what the priors of the firing
logic change.
"""

from __future__ import annotations

from cassini_bayes.events.totals import read_totals
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.report.plots.prediction import (
    leave_one_out_figure,
    requirement_figure,
    totals_figure,
)
from cassini_bayes.studies.prediction.findings import COLUMNS, Findings, find, table_csv
from cassini_bayes.studies.prediction.page import page_body
from cassini_bayes.studies.study import Study

__all__ = ["Findings", "find", "page_body", "prediction_results"]


def prediction_results(study: Study, events: str, priors: str) -> Findings:
    """Leave every event out in turn, and write page, table and figures."""
    read = read_priors(priors)
    flight = read_totals(events, read.spacecraft)
    columns = {source: read_totals(events, read.spacecraft, source) for source in COLUMNS}
    findings = find(flight, columns, read, study.seed, study.progress)
    figures = {
        "": leave_one_out_figure(findings.folds, columns),
        "_totals": totals_figure(findings.folds, columns),
        "_requirement": requirement_figure(
            {name: result[2] for name, result in findings.requirement.items()}
        ),
    }
    body = page_body(findings, read, study.page.stem)
    tables = {"": table_csv(findings)}
    study.publish("Prediction: results", body, "studies.prediction", tables, figures)
    return findings
