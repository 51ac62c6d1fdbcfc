"""The report of a diagnosis: one HTML page, figures, tables and ``diagnosis.json`` in a folder."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from cassini_bayes.diagnosis.correlations import POINTWISE, InnovationTests
from cassini_bayes.diagnosis.diagnosis import Diagnosis
from cassini_bayes.diagnosis.discrepancy import Curve
from cassini_bayes.files.storage import remove_leftovers, write_bytes, write_text
from cassini_bayes.files.tables import finite, frame_csv
from cassini_bayes.report.diagnosis_page import render_diagnosis
from cassini_bayes.report.diagnosis_pictures import cause_picture, drawn, pictures_of
from cassini_bayes.report.diagnosis_verdict import verdict_sentences
from cassini_bayes.report.draft_file import write_drafts


def write_diagnosis(diagnosis: Diagnosis[Any], folder: Path, name: str, processes: int = 1) -> None:
    """Write ``diagnosis.json``, tables, ``figures/``, ``drafts/`` and ``report.html``.

    ``discrepancy.csv`` and ``correlation.csv`` hold what the figures of those names show,
    ``drafts`` the files of effects that predict what was held out. Figures are drawn by
    ``processes`` side by side.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    record = diagnosis.record
    record["verdict"] = verdict_sentences(record)
    remove_leftovers(folder)
    detail = diagnosis.shown.detail
    if detail is not None:
        write_text(folder / "discrepancy.csv", frame_csv(curve_table(diagnosis.curves)))
        table = driver_table(detail.before, detail.after)
        write_text(folder / "correlation.csv", frame_csv(table))
    shown = [*pictures_of(diagnosis.shown), *pictures_of(diagnosis.curves)]
    images = drawn([cause_picture(record), *shown], processes)
    for image in images:
        write_bytes(folder / "figures" / f"{image.name}.png", image.png)
        write_bytes(folder / "figures" / f"{image.name}.svg", image.svg)
    write_drafts(diagnosis.drafts, folder / "drafts")
    page = render_diagnosis(record, images, name, diagnosis.curves, diagnosis.drafts)
    write_text(folder / "report.html", page)
    # last: a folder with it holds a whole diagnosis, whatever was killed before
    write_text(folder / "diagnosis.json", diagnosis_json(record))


def curve_table(curves: Sequence[Curve]) -> pd.DataFrame:
    """Discrepancy curves row by row: N m s about body axes, 90 % central intervals."""
    return pd.concat(
        pd.DataFrame(
            {"event": curve.event, "time_s": curve.time_s}
            | {
                f"{axis}_{what}_n_m_s": getattr(curve, what)[:, c]
                for c, axis in enumerate("xyz")
                for what in ("mean", "low", "high")
            }
        )
        for curve in curves
    )


def driver_table(before: InnovationTests, after: InnovationTests) -> pd.DataFrame:
    """Standardised correlations with every driver, σ, and their bands' half-widths."""
    later = {(t.event, t.axis, t.driver): t.z for t in after.drivers}
    return pd.DataFrame(
        {
            "event": t.event,
            "axis": t.axis,
            "driver": t.driver,
            "baseline_z": t.z,
            "extended_z": later.get((t.event, t.axis, t.driver), np.nan),
            "single_95_z": POINTWISE,
            "family_95_z": before.family_z,
        }
        for t in before.drivers
    )


def diagnosis_json(record: Mapping[str, Any]) -> str:
    """The record as JSON; numbers that are not finite become null."""
    return json.dumps(finite(record), indent=1, allow_nan=False) + "\n"
