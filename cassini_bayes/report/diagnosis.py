"""The report of a diagnosis: one HTML page, figures and ``diagnosis.json`` in a folder."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pandas as pd

from cassini_bayes import __version__
from cassini_bayes.computing.processes import in_processes
from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.correlations import POINTWISE, InnovationTests
from cassini_bayes.diagnosis.diagnosis import Diagnosis
from cassini_bayes.diagnosis.discrepancy import Curve, curves_of
from cassini_bayes.files.storage import write_bytes, write_text
from cassini_bayes.files.tables import frame_csv
from cassini_bayes.report.plots import Figure, encode, settle
from cassini_bayes.report.plots.criticism import (
    cause_figure,
    correlation_figure,
    discrepancy_figure,
    innovation_figure,
    whiteness_figure,
)
from cassini_bayes.report.templating import address_of, rendered

MOST_CAUSES: Final = 12
UNITS: Final = {"rmse_nms": "N m s", "rmse_n": "N", "rmse_s": "s"}  # of what is left
CAPTIONS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "causes": "Causes, most probable first: posterior probability and evidence.",
        "innovations": "Measured less predicted momentum after fitting, in body axes.",
        "discrepancy": "Discrepancy: torque that the baseline lacks, integrated from the first "
        "row, about body axes, as unknown infers it. Where the band holds zero nothing need be "
        "missing. What thrusts can take up in a bias widens the band.",
        "correlation": "What the innovations go with. Each value is standard normal if the model "
        "is true; a driver that the model can take up itself has no test.",
        "whiteness": "Whiteness: autocorrelation of the innovations, less what fitting makes of "
        "white noise.",
    }
)


@dataclass(frozen=True)
class Picture:
    """A figure of the report with what it shows; the name is that of its file.

    ``make`` makes it, or nothing where there is nothing to show.
    """

    name: str
    make: Callable[[], Figure | None]

    @property
    def caption(self) -> str:
        """What it shows; of several of a kind the same."""
        return CAPTIONS[self.name.partition("_")[0]]


@dataclass(frozen=True)
class Drawn:
    """A picture drawn, for its files and the page."""

    name: str
    caption: str
    png: bytes
    svg: bytes


def innovation_pictures(diagnosis: Diagnosis[Any], curves: Sequence[Curve]) -> list[Picture]:
    """``innovations``, ``discrepancy``, ``correlation_1`` …, ``whiteness``; none without rows."""
    left, after = diagnosis.verdict.none.remainder, diagnosis.extended.remainder
    if left is None:
        return []
    before_tests, after_tests = diagnosis.shown.detail
    has_cause = after is not None and after is not left
    tests = before_tests, after_tests if has_cause else None
    after_rows = after.rows if after is not None and has_cause else ()
    return [
        Picture("innovations", partial(innovation_figure, left.rows, after_rows)),
        Picture("discrepancy", partial(discrepancy_figure, curves)),
        *(
            Picture(f"correlation_{i}", partial(correlation_figure, event.event, *tests))
            for i, event in enumerate(left.rows, start=1)
        ),
        Picture("whiteness", partial(whiteness_figure, *tests)),
    ]


def cause_picture(record: Mapping[str, Any]) -> Picture:
    """Probability and evidence of the causes of a record."""
    return Picture("causes", partial(cause_figure, record["causes"]))


def drawn(pictures: Sequence[Picture], processes: int = 1) -> list[Drawn]:
    """Pictures that show something made, laid out and drawn, shared out among processes."""
    # the last ones take longest: they go first, so that the work is shared out evenly
    results = in_processes(_drawn, pictures[::-1], processes)[::-1]
    return [image for image in results if image is not None]


def _drawn(picture: Picture) -> Drawn | None:
    figure = picture.make()
    if figure is None:
        return None
    settle(figure, solutions=1)
    return Drawn(picture.name, picture.caption, encode(figure, "png"), encode(figure, "svg"))


def write_diagnosis(diagnosis: Diagnosis[Any], folder: Path, name: str, processes: int = 1) -> None:
    """Write ``diagnosis.json``, tables, ``figures/`` and ``report.html``.

    ``discrepancy.csv`` and ``correlation.csv`` hold what the figures of those names show.
    ``processes`` is how many draw the figures side by side.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    record, curves = diagnosis.record, tuple[Curve, ...]()
    if isinstance(diagnosis.case, BalanceCase) and diagnosis.shown.detail is not None:
        rng = np.random.default_rng(record["seed"])
        curves = curves_of(diagnosis.case, diagnosis.verdict, rng)
        write_text(folder / "discrepancy.csv", frame_csv(curve_table(curves)))
        table = driver_table(*diagnosis.shown.detail)
        write_text(folder / "correlation.csv", frame_csv(table))
    pictures = [cause_picture(record), *innovation_pictures(diagnosis, curves)]
    images = drawn(pictures, processes)
    write_text(folder / "diagnosis.json", diagnosis_json(record))
    for image in images:
        write_bytes(folder / "figures" / f"{image.name}.png", image.png)
        write_bytes(folder / "figures" / f"{image.name}.svg", image.svg)
    write_text(folder / "report.html", render_diagnosis(record, images, name, curves))


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
    return json.dumps(_finite(record), indent=1, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def sentences(record: Mapping[str, Any]) -> list[str]:
    """The verdict in words."""
    best = record["causes"][0]
    none = next(c for c in record["causes"] if c["name"] == "none")
    lines = []
    if best["name"] == "none":
        lines.append(f"The baseline explains these events (probability {none['probability']:.3f}).")
    elif best["name"] == "unknown":
        lines.append(
            f"The data reject the baseline and no cause of the catalogue mends it "
            f"(probability of unknown {best['probability']:.3f})."
        )
        if record["runner_up"] is not None:
            lines.append(_runner_up_sentence(record))
    else:
        lines.append(
            f"{best['name']} explains what the baseline does not (probability "
            f"{best['probability']:.3f}, log Bayes factor {best['log_bayes_factor']:.1f} nats)."
        )
    if best["confounded_with"]:
        lines.append(f"These data cannot tell it from {', '.join(best['confounded_with'])}.")
    if len(record["extended"]["causes"]) > 1:
        second = record["extended"]["causes"][-1]
        lines.append(
            f"A second cause, {second}, gains {record['second_cause_nats']:.1f} nats beside it."
        )
    if record["p_value"] is not None:
        lines.append(
            f"p-value of the baseline (refitted bootstrap of slow innovations): "
            f"{record['p_value']:.3f}; of the extended model: {record['gain']['p_value']:.3f}."
        )
    return lines


def _runner_up_sentence(record: Mapping[str, Any]) -> str:
    """The best cause that there is, its size, and what it leaves."""
    left = record["runner_up"]
    cause = next(item for item in record["causes"] if item["name"] == left["name"])
    sizes = "; ".join(_size(key, size) for key, size in cause["parameters"].items())
    remains = [
        f"RMS {value:.3g} {unit} where the baseline leaves {record['baseline'][key]:.3g} {unit}"
        for key, unit in UNITS.items()
        if (value := left.get(key)) is not None
    ]
    if left["p_value"] is not None:
        remains.append(f"p-value {left['p_value']:.3f}")
    text = (
        f"The best cause, {left['name']}, gains {cause['log_bayes_factor']:+,.1f} nats over the "
        f"baseline and is {left['behind_unknown_nats']:,.1f} nats behind unknown ({sizes})."
    )
    return f"{text} It leaves {', '.join(remains)}." if remains else text


def _size(key: str, size: Mapping[str, Any]) -> str:
    low, high = (_number(end) for end in size["hdi_90"])
    return f"{key}: {_number(size['mean'])} ± {_number(size['sd'], '.2g')} [{low}, {high}]"


def gain_sentence(record: Mapping[str, Any]) -> str:
    """What was gained on held-out events, in words."""
    gain = record["gain"]
    if gain["elpd_diff"] is None:
        return (
            "Held-out gain: not measurable (it takes three telemetry events or more, or three "
            "totals rows or more; not a mix of both)."
        )
    return (
        f"Held-out log score, leave one event out: {gain['elpd_diff']:+.1f} ± "
        f"{gain['elpd_diff_se']:.1f} nats (one standard error over events): {gain['verdict']}. "
        f"Held-out RMSE ratio {gain['heldout_rmse_ratio']:.3f}."
    )


def _number(value: float | None, form: str = ".4g") -> str:
    return "–" if value is None else format(value, form)


def _cause_row(cause: Mapping[str, Any], record: Mapping[str, Any]) -> dict[str, str]:
    sizes = [_size(key, size) for key, size in cause["parameters"].items()]
    widths = record["sensitivity"]
    return {
        "name": cause["name"],
        "probability": f"{cause['probability']:.4f}",
        "bayes": f"{cause['log_bayes_factor']:+.1f}",
        "size": "; ".join(sizes),
        "confounded": ", ".join(cause["confounded_with"]),
        "sensitivity": " / ".join(f"{widths[w].get(cause['name'], 0.0):.3f}" for w in widths),
    }


def _closure_rows(record: Mapping[str, Any], curves: Sequence[Curve]) -> list[dict[str, str]]:
    """End-point closure before and after, and the inferred unexplained momentum at the end."""
    missing = {
        (curve.event, axis): (curve.mean[-1, c], curve.low[-1, c], curve.high[-1, c])
        for curve in curves
        for c, axis in enumerate("xyz")
    }
    rows = []
    for row in record["closure"]:
        cells = {"event": row["event"], "axis": row["axis"].upper(), "missing": "–"}
        for model in ("baseline", "extended"):
            value, sd = row[f"{model}_n_m_s"], row[f"{model}_sd_n_m_s"]
            cells[model] = f"{value:+.4f} ± {sd:.4f} ({value / sd:+.1f} σ)"
        if (row["event"], row["axis"]) in missing:
            mean, low, high = missing[row["event"], row["axis"]]
            cells["missing"] = f"{mean:+.4f} [{low:+.4f}, {high:+.4f}]"
        rows.append(cells)
    return rows


def render_diagnosis(
    record: Mapping[str, Any],
    pictures: Sequence[Drawn],
    name: str,
    curves: Sequence[Curve] = (),
) -> str:
    """The page as HTML; every text is escaped."""
    before, after = record["baseline"], record["extended"]
    labels = {
        "log_evidence": "log evidence (nats)",
        **{key: f"RMS residual ({unit})" for key, unit in UNITS.items()},
        "elpd": "held-out log score (nats)",
        "elpd_se": "its standard error (nats)",
        **{f"heldout_{key}": f"held-out RMS residual ({unit})" for key, unit in UNITS.items()},
        "heldout_coverage_90": "coverage of held-out 90 % central intervals (1)",
    }
    return rendered(
        "diagnosis.html.jinja",
        name=name,
        sentences=sentences(record),
        symptoms=record["symptoms"],
        findings=record.get("findings", []),
        pictures=[
            {
                "name": image.name,
                "caption": image.caption,
                "address": address_of(image.png, "image/png"),
            }
            for image in pictures
        ],
        closure=_closure_rows(record, curves),
        causes=[_cause_row(cause, record) for cause in record["causes"][:MOST_CAUSES]],
        separation=record["separation"],
        extended_name=", ".join(after["causes"]) or "none",
        comparison=[
            {
                "what": text,
                "before": _number(before[key], ".6g"),
                "after": _number(after[key], ".6g"),
            }
            for key, text in labels.items()
            if before.get(key) is not None or after.get(key) is not None
        ],
        gain_sentence=gain_sentence(record),
        made=f"cassini_bayes {__version__}",
    )
