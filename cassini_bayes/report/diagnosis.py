"""The report of a diagnosis: one HTML page, figures and ``diagnosis.json`` in a folder."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined

from cassini_bayes import __version__
from cassini_bayes.criticism.diagnosis import Diagnosis
from cassini_bayes.plots import Figure, encode, save_figures
from cassini_bayes.plots.criticism import cause_figure, innovation_figure
from cassini_bayes.storage import write_text

MOST_CAUSES: Final = 12


def diagnosis_figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Figures by name: ``causes``, and ``innovations`` where there is telemetry."""
    figures = {"causes": cause_figure(diagnosis.record["causes"])}
    rows, after = diagnosis.verdict.rows, diagnosis.extended_rows
    changed = bool(diagnosis.extended.hypothesis.effects)
    innovations = innovation_figure(rows, after if changed else ())
    if innovations is not None:
        figures["innovations"] = innovations
    return figures


def write_diagnosis(diagnosis: Diagnosis, folder: Path, name: str) -> None:
    """Write ``diagnosis.json``, ``figures/`` and ``report.html``.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    figures = diagnosis_figures(diagnosis)
    write_text(folder / "diagnosis.json", diagnosis_json(diagnosis.record))
    save_figures(figures, folder / "figures")
    write_text(folder / "report.html", render_diagnosis(diagnosis.record, figures, name))


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


def gain_sentence(record: Mapping[str, Any]) -> str:
    """What was gained on held-out events, in words."""
    gain = record["gain"]
    if gain["elpd_diff"] is None:
        return "Held-out gain: not measurable (it takes three telemetry events or more)."
    return (
        f"Held-out log score, leave one event out: {gain['elpd_diff']:+.1f} ± "
        f"{gain['elpd_diff_se']:.1f} nats (one standard error over events): {gain['verdict']}. "
        f"Held-out RMSE ratio {gain['heldout_rmse_ratio']:.3f}."
    )


def _number(value: float | None, form: str = ".4g") -> str:
    return "–" if value is None else format(value, form)


def _cause_row(cause: Mapping[str, Any], record: Mapping[str, Any]) -> dict[str, str]:
    sizes = [
        f"{key}: {_number(p['mean'])} ± {_number(p['sd'], '.2g')} "
        f"[{_number(p['hdi_90'][0])}, {_number(p['hdi_90'][1])}]"
        for key, p in cause["parameters"].items()
    ]
    widths = record["sensitivity"]
    return {
        "name": cause["name"],
        "probability": f"{cause['probability']:.4f}",
        "bayes": f"{cause['log_bayes_factor']:+.1f}",
        "size": "; ".join(sizes),
        "confounded": ", ".join(cause["confounded_with"]),
        "sensitivity": " / ".join(f"{widths[w].get(cause['name'], 0.0):.3f}" for w in widths),
    }


def render_diagnosis(record: Mapping[str, Any], figures: Mapping[str, Figure], name: str) -> str:
    """The page as HTML; every text is escaped."""
    environment = Environment(
        loader=PackageLoader("cassini_bayes", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    before, after = record["baseline"], record["extended"]
    labels = {
        "log_evidence": "log evidence (nats)",
        "rmse_nms": "RMS innovation (N m s)",
        "elpd": "held-out log score (nats)",
        "elpd_se": "its standard error (nats)",
        "heldout_rmse_nms": "held-out RMS residual (N m s)",
        "heldout_coverage_90": "coverage of held-out 90 % central intervals (1)",
    }
    pictures = [{"name": key, "address": _address(figure)} for key, figure in figures.items()]
    return environment.get_template("diagnosis.html.jinja").render(
        name=name,
        sentences=sentences(record),
        symptoms=record["symptoms"],
        pictures=pictures,
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
        ],
        gain_sentence=gain_sentence(record),
        made=f"cassini_bayes {__version__}",
    )


def _address(figure: Figure) -> str:
    content = base64.b64encode(encode(figure, "png")).decode("ascii")
    return f"data:image/png;base64,{content}"
