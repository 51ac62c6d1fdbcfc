"""The page of a diagnosis: its record as HTML, the verdict first, long tables folded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from cassini_bayes import __version__
from cassini_bayes.diagnosis.discrepancy import Curve
from cassini_bayes.diagnosis.drafts import Draft
from cassini_bayes.effects.wording import rounded
from cassini_bayes.report.cells import Cell, Table
from cassini_bayes.report.diagnosis_pictures import Drawn
from cassini_bayes.report.diagnosis_slider import width_slider
from cassini_bayes.report.diagnosis_verdict import (
    UNITS,
    alike_nothing,
    gain_sentence,
    probability_words,
    verdict_sentences,
)
from cassini_bayes.report.draft_file import draft_files
from cassini_bayes.report.plots.quantities import MISSING
from cassini_bayes.report.templating import address_of, rendered

Record = Mapping[str, Any]
LEAST_SHOWN: Final = 0.001  # probability of a cause in the first table; others are folded
MOST_NAMED: Final = 3  # confounded causes in a cell, and events that one may begin with
LEAST_BEGINNING: Final = 0.05  # probability of such an event: judgement, less is not read


def render_diagnosis(
    record: Record,
    images: Sequence[Drawn],
    name: str,
    curves: Sequence[Curve] = (),
    drafts: Sequence[Draft] = (),
) -> str:
    """The page as HTML; every text is escaped."""
    nothing = alike_nothing(record) if record["causes"][0]["name"] == "none" else []
    first = [
        cause
        for cause in record["causes"]
        if cause["name"] in ("none", "unknown")
        or (cause["probability"] >= LEAST_SHOWN and cause["name"] not in nothing)
    ]
    folded = [cause for cause in record["causes"] if cause not in first]
    verdict = record.get("verdict") or verdict_sentences(record)
    return rendered(
        "diagnosis.html.jinja",
        name=name,
        answer=verdict[0],
        sentences=verdict[1:],
        key_numbers=_key_numbers(record),
        findings=record.get("findings", []),
        pictures={
            kind: [
                {
                    "name": image.name,
                    "alt": image.alt,
                    "caption": image.caption,
                    "address": address_of(image.png, "image/png"),
                }
                for image in images
                if image.kind == kind
            ]
            for kind in dict.fromkeys(image.kind for image in images)
        },
        causes=_cause_table(first, record),
        folded_causes=_cause_table(folded, record) if folded else None,
        fold=_fold_words(folded, nothing),
        widths=width_slider(record),
        separation=record["separation"],
        symptoms=_symptom_table(record),
        comparison=_comparison_table(record),
        fits=_fit_table(record),
        closure=_closure_table(record, curves),
        gain_sentence=gain_sentence(record),
        taken_up=_taken_up_table(record),
        drafts=_draft_table(record),
        visible=_visible_table(record),
        draft_files=[(draft.name, *draft_files(draft)) for draft in drafts if draft.is_gain],
        drivers=_driver_table(record),
        provenance=_provenance(record),
    )


def _key_numbers(record: Record) -> list[tuple[str, str]]:
    best, gain = record["causes"][0], record["gain"]
    numbers = [
        ("most probable", best["name"]),
        ("its probability", probability_words(best["probability"])),
    ]
    if best["name"] != "none":
        over = _signed(best["log_bayes_factor"], ",.1f", " nats")
        numbers.append(("evidence over none", over))
    if gain["elpd_diff"] is not None and best["name"] != "none":
        value = _signed(gain["elpd_diff"], ",.1f")
        numbers.append(("held-out gain", f"{value} ± {gain['elpd_diff_se']:,.1f} nats"))
    if record["p_value"] is not None:
        numbers.append(("p-value of the baseline", f"{record['p_value']:.3f}"))
        if best["name"] not in ("none", "unknown"):
            numbers.append(("p-value with the cause", f"{gain['p_value']:.3f}"))
    return numbers


def _signed(value: float, form: str, unit: str = "") -> str:
    return f"{value:+z{form}}{unit}".replace("-", "−")  # z: no negative zero


def _number(value: float | None, form: str = ".4g") -> str:
    return MISSING if value is None else format(value, form).replace("-", "−")


def _table(columns: Sequence[str], rows: Sequence[Sequence[str | Cell]], title: str) -> Table:
    cells = tuple(tuple(c if isinstance(c, Cell) else Cell(c) for c in row) for row in rows)
    return Table(tuple(columns), cells, title=title)


def _fold_words(folded: Sequence[Record], nothing: Sequence[str]) -> str:
    """The line behind which causes are folded away."""
    count = len(folded)
    if nothing:
        return (
            f"{len(nothing)} of {count} others cannot be told apart from nothing: their evidence "
            "is within three nats of the baseline's"
        )
    return f"{count} other{'' if count == 1 else 's'}, each below {LEAST_SHOWN:g} in probability"


def _beginnings(cause: Record) -> str:
    """The events that a cause may begin with, likeliest first, each with its probability."""
    onset = cause.get("onset")
    if onset is None:
        return MISSING
    likely = sorted(onset["probabilities"].items(), key=lambda item: -item[1])
    shown = [item for item in likely if item[1] > LEAST_BEGINNING][:MOST_NAMED]
    return ", ".join(f"{event} ({probability_words(share)})" for event, share in shown)


def _cause_table(causes: Sequence[Record], record: Record) -> Table:
    widths = record["sensitivity"]
    return _table(
        (
            "cause",
            "probability",
            "log Bayes factor (nats)",
            "what it says",
            "acts from",
            "cannot be told from",
            "probability at half / double prior width",
        ),
        [
            (
                cause["name"],
                Cell(probability_words(cause["probability"]), "n"),
                Cell(_signed(cause["log_bayes_factor"], ",.1f"), "n"),
                cause.get("says") or MISSING,
                _beginnings(cause),
                _names(cause["confounded_with"]),
                Cell(" / ".join(_share(widths[w], cause["name"]) for w in widths), "n"),
            )
            for cause in causes
        ],
        "causes",
    )


def _share(shares: Mapping[str, float], name: str) -> str:
    return f"{shares.get(name, 0.0):.3f}"


def _names(names: Sequence[str]) -> str:
    if len(names) <= MOST_NAMED:
        return ", ".join(names) or MISSING
    return f"{', '.join(names[:MOST_NAMED])} and {len(names) - MOST_NAMED} others"


def _symptom_table(record: Record) -> Table | None:
    if not record["symptoms"]:
        return None
    rows = [(s["event"], s["what"], Cell(_signed(s["z"], ".1f"), "n")) for s in record["symptoms"]]
    return _table(("event", "what", "z (σ)"), rows, "symptoms")


def _comparison_table(record: Record) -> Table:
    before, after = record["baseline"], record["extended"]
    labels = {
        "log_evidence": "log evidence (nats)",
        **{key: f"RMS residual ({unit})" for key, unit in UNITS.items()},
        "elpd": "held-out log score (nats)",
        "elpd_se": "its standard error (nats)",
        **{f"heldout_{key}": f"held-out RMS residual ({unit})" for key, unit in UNITS.items()},
        "heldout_coverage_90": "coverage of held-out 90 % central intervals (1)",
    }
    name = ", ".join(after["causes"]) or "none"
    rows = [
        (text, _number(before.get(key), ".6g"), _number(after.get(key), ".6g"))
        for key, text in labels.items()
        if before.get(key) is not None or after.get(key) is not None
    ]
    return _table(("quantity", "baseline", f"extended ({name})"), rows, "before and after")


def _fit_table(record: Record) -> Table | None:
    """The fit of every channel, an event a row."""
    fits = record.get("fit_percent") or []
    if not fits:
        return None
    channels = list(dict.fromkeys(fit["channel"] for fit in fits))
    by_place = {(fit["event"], fit["channel"]): fit for fit in fits}
    rows = []
    for event in dict.fromkeys(fit["event"] for fit in fits):
        cells = []
        for channel in channels:
            fit = by_place.get((event, channel))
            if fit is None:
                cells.append(MISSING)
            elif fit["extended_percent"] is None:
                cells.append(_number(fit["baseline_percent"], ".2f"))
            else:
                before, after = fit["baseline_percent"], fit["extended_percent"]
                cells.append(f"{_number(before, '.2f')} → {_number(after, '.2f')}")
        rows.append((event, *cells))
    return _table(("event", *channels), rows, "fit in per cent")


def _closure_table(record: Record, curves: Sequence[Curve]) -> Table | None:
    """End-point closure before and after, and the inferred unexplained momentum at the end."""
    if not record["closure"]:
        return None
    missing = {
        (curve.event, axis): (curve.mean[-1, c], curve.low[-1, c], curve.high[-1, c])
        for curve in curves
        for c, axis in enumerate("xyz")
    }
    rows = []
    for row in record["closure"]:
        cells = [row["event"], row["axis"].upper()]
        for model in ("baseline", "extended"):
            value, sd = row[f"{model}_n_m_s"], row[f"{model}_sd_n_m_s"]
            cells.append(f"{value:+.4f} ± {sd:.4f} ({value / sd:+.1f} σ)".replace("-", "−"))
        lacking = missing.get((row["event"], row["axis"]))
        cells.append(
            MISSING
            if lacking is None
            else f"{lacking[0]:+.4f} [{lacking[1]:+.4f}, {lacking[2]:+.4f}]".replace("-", "−")
        )
        rows.append(cells)
    columns = ("event", "axis", "baseline (N m s)", "extended (N m s)", "lacking (N m s)")
    return _table(columns, rows, "momentum at the end")


def _taken_up_table(record: Record) -> Table | None:
    bent = record.get("taken_up") or []
    if not bent:
        return None
    rows = [
        (item["quantity"], rounded(item["baseline"], 2), rounded(item["extended"], 2))
        for item in bent
    ]
    columns = ("free quantity", "baseline (prior σ)", "with the cause (prior σ)")
    return _table(columns, rows, "what the baseline bends")


def _visible_table(record: Record) -> Table | None:
    """From which size on causes would have been named."""
    rows = [
        (
            row["cause"],
            row["says"] or f"no size that its prior allows ({row['parameter']})",
            Cell(_number(row["sd"], ".2g"), "n"),
            Cell(_number(row["prior_width"], ".2g"), "n"),
            row["unit"],
        )
        for row in record.get("visible") or []
    ]
    columns = ("cause", "would have been named", "known to (1 σ)", "width of its prior", "unit")
    return _table(columns, rows, "what would have been seen") if rows else None


def _draft_table(record: Record) -> Table | None:
    drafts = record.get("drafts") or []
    if not drafts:
        return None
    rows = [
        (
            draft["form"],
            draft["says"],
            Cell(
                f"{_signed(draft['heldout_gain_nats'], ',.1f')} ± "
                f"{draft['heldout_gain_se_nats']:,.1f}",
                "n",
            ),
            "yes" if draft["is_gain"] else "no",
        )
        for draft in drafts
    ]
    columns = ("form", "what it says", "held-out gain (nats)", "predicts what was held out")
    return _table(columns, rows, "drafted effects")


def _driver_table(record: Record) -> Table | None:
    drivers = record.get("drivers") or []
    if not drivers:
        return None
    rows = [
        (
            item["driver"],
            item["event"],
            item["axis"].upper(),
            _signed(item["z"], ".1f"),
            f"±{item['band_z']:.1f}",
        )
        for item in drivers
    ]
    columns = ("driver", "event", "axis", "correlation (σ)", "95 % of all (σ)")
    return _table(columns, rows, "what the innovations go with")


def _provenance(record: Record) -> list[tuple[str, str]]:
    facts = [("program", f"cassini_bayes {__version__}")]
    if "seed" in record:
        facts.append(("seed", str(record["seed"])))
    if "command" in record:
        facts.append(("command", " ".join(record["command"])))
    facts.append(("events", ", ".join(record["events"])))
    facts += [(f"SHA-256 of {path}", digest) for path, digest in record.get("sha256", {}).items()]
    facts += [(f"effect {path}", digest) for path, digest in record.get("effects", {}).items()]
    versions = record.get("versions", {})
    if versions:
        facts.append(("libraries", ", ".join(f"{k} {v}" for k, v in versions.items())))
    return facts
