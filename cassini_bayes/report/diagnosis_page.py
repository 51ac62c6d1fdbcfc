"""The page of a diagnosis: its record as HTML, the verdict first, long tables folded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from cassini_bayes import __version__
from cassini_bayes.diagnosis.discrepancy import Curve
from cassini_bayes.diagnosis.drafts import Draft
from cassini_bayes.effects.wording import rounded
from cassini_bayes.report.cells import Cell, Column, Table, tabulate
from cassini_bayes.report.diagnosis_pictures import Drawn
from cassini_bayes.report.diagnosis_slider import width_slider
from cassini_bayes.report.diagnosis_verdict import (
    UNITS,
    alike_nothing,
    gain_sentence,
    probability_words,
    some_of,
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


def _listed(
    records: Sequence[Record] | None, columns: Mapping[str, Column], title: str
) -> Table | None:
    """A table of records; none without any."""
    return tabulate(records, columns, title=title) if records else None


def _numeric(text: Callable[[Record], str]) -> Column:
    """A column of numbers."""
    return lambda record: Cell(text(record), "n")


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
    columns: dict[str, Column] = {
        "cause": "name",
        "probability": _numeric(lambda cause: probability_words(cause["probability"])),
        "log Bayes factor (nats)": _numeric(lambda c: _signed(c["log_bayes_factor"], ",.1f")),
        "what it says": lambda cause: cause.get("says") or MISSING,
        "acts from": _beginnings,
        "cannot be told from": lambda cause: (
            some_of(cause["confounded_with"], MOST_NAMED) or MISSING
        ),
        "probability at half / double prior width": _numeric(
            lambda cause: " / ".join(_share(widths[w], cause["name"]) for w in widths)
        ),
    }
    return tabulate(causes, columns, title="causes")


def _share(shares: Mapping[str, float], name: str) -> str:
    return f"{shares.get(name, 0.0):.3f}"


def _symptom_table(record: Record) -> Table | None:
    columns: dict[str, Column] = {
        "event": "event",
        "what": "what",
        "z (σ)": _numeric(lambda symptom: _signed(symptom["z"], ".1f")),
    }
    return _listed(record["symptoms"], columns, "symptoms")


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
    shown = [k for k in labels if before.get(k) is not None or after.get(k) is not None]
    columns: dict[str, Column] = {
        "quantity": lambda row: labels[row["key"]],
        "baseline": lambda row: _number(before.get(row["key"]), ".6g"),
        f"extended ({name})": lambda row: _number(after.get(row["key"]), ".6g"),
    }
    return tabulate([{"key": key} for key in shown], columns, title="before and after")


def _fit_table(record: Record) -> Table | None:
    """The fit of every channel, an event a row."""
    fits: Sequence[Record] = record.get("fit_percent") or []
    by_place = {(fit["event"], fit["channel"]): fit for fit in fits}

    def of_channel(channel: str) -> Column:
        return lambda row: _fit_words(by_place.get((row["event"], channel)))

    events = [{"event": event} for event in dict.fromkeys(fit["event"] for fit in fits)]
    channels = dict.fromkeys(fit["channel"] for fit in fits)
    columns = {"event": "event", **{channel: of_channel(channel) for channel in channels}}
    return _listed(events, columns, "fit in per cent")


def _fit_words(fit: Record | None) -> str:
    """The fit of a channel before and, where there is a cause, after."""
    if fit is None:
        return MISSING
    before, after = (_number(fit[f"{model}_percent"], ".2f") for model in ("baseline", "extended"))
    return before if fit["extended_percent"] is None else f"{before} → {after}"


def _closure_table(record: Record, curves: Sequence[Curve]) -> Table | None:
    """End-point closure before and after, and the inferred unexplained momentum at the end."""
    missing = {
        (curve.event, axis): (curve.mean[-1, c], curve.low[-1, c], curve.high[-1, c])
        for curve in curves
        for c, axis in enumerate("xyz")
    }

    def closure(model: str) -> Column:
        def text(row: Record) -> str:
            value, sd = row[f"{model}_n_m_s"], row[f"{model}_sd_n_m_s"]
            return f"{value:+.4f} ± {sd:.4f} ({value / sd:+.1f} σ)".replace("-", "−")

        return text

    def lacking(row: Record) -> str:
        if (row["event"], row["axis"]) not in missing:
            return MISSING
        mean, low, high = missing[row["event"], row["axis"]]
        return f"{mean:+.4f} [{low:+.4f}, {high:+.4f}]".replace("-", "−")

    columns: dict[str, Column] = {
        "event": "event",
        "axis": _axis,
        "baseline (N m s)": closure("baseline"),
        "extended (N m s)": closure("extended"),
        "lacking (N m s)": lacking,
    }
    return _listed(record["closure"], columns, "momentum at the end")


def _axis(row: Record) -> str:
    return str(row["axis"]).upper()


def _taken_up_table(record: Record) -> Table | None:
    columns: dict[str, Column] = {
        "free quantity": "quantity",
        "baseline (prior σ)": lambda item: rounded(item["baseline"], 2),
        "with the cause (prior σ)": lambda item: rounded(item["extended"], 2),
    }
    return _listed(record.get("taken_up"), columns, "what the baseline bends")


def _visible_table(record: Record) -> Table | None:
    """From which size on causes would have been named."""
    columns: dict[str, Column] = {
        "cause": "cause",
        "would have been named": lambda row: (
            row["says"] or f"no size that its prior allows ({row['parameter']})"
        ),
        "known to (1 σ)": _numeric(lambda row: _number(row["sd"], ".2g")),
        "width of its prior": _numeric(lambda row: _number(row["prior_width"], ".2g")),
        "unit": "unit",
    }
    return _listed(record.get("visible"), columns, "what would have been seen")


def _draft_table(record: Record) -> Table | None:
    def gain(draft: Record) -> str:
        score, error = draft["heldout_gain_nats"], draft["heldout_gain_se_nats"]
        return f"{_signed(score, ',.1f')} ± {error:,.1f}"

    columns: dict[str, Column] = {
        "form": "form",
        "what it says": "says",
        "held-out gain (nats)": _numeric(gain),
        "predicts what was held out": lambda draft: "yes" if draft["is_gain"] else "no",
    }
    return _listed(record.get("drafts"), columns, "drafted effects")


def _driver_table(record: Record) -> Table | None:
    columns: dict[str, Column] = {
        "driver": "driver",
        "event": "event",
        "axis": _axis,
        "correlation (σ)": lambda item: _signed(item["z"], ".1f"),
        "95 % of all (σ)": lambda item: f"±{item['band_z']:.1f}",
    }
    return _listed(record.get("drivers"), columns, "what the innovations go with")


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
