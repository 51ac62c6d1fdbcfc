"""The verdict of a diagnosis in sentences, made of its record alone; the answer comes first.

Probability, p-value, symptoms and held-out gain each look at something else. Where they seem to
disagree a sentence says why (docs/how-to/read-a-diagnosis.md, "What each number means").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from cassini_bayes.diagnosis.case import UNKNOWN
from cassini_bayes.diagnosis.diagnosis import SIGNIFICANT
from cassini_bayes.diagnosis.score import STANDARD_ERRORS, SURE_NATS
from cassini_bayes.diagnosis.verdict import CONFOUNDED_NATS
from cassini_bayes.effects.wording import rounded

Record = Mapping[str, Any]
MOST_NAMED: Final = 4  # confounded causes in a sentence; more are counted
CERTAIN: Final = 0.999  # a probability above is not worth its digits
UNITS: Final[Mapping[str, str]] = {"rmse_nms": "N m s", "rmse_n": "N", "rmse_s": "s"}
FORMS: Final[Mapping[str, str]] = {
    "torque": "torque that wanders, whatever fires,",
    "drift": "thrust that changes with time, alike in all thrusters,",
    "lever": "torque that thrusters have beside their own",
}
_NUMBERS: Final = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
_TESTED: Final = (
    "The p-value and the symptoms look at what is left once everything free has been fitted"
)


def verdict_sentences(record: Record) -> list[str]:
    """Every sentence of the verdict, the answer first."""
    best = record["causes"][0]
    sentences = [_headline(record, best), *_reconciled(record, best)]
    if best["name"] == "none":
        sentences += _visible(record)
    if best["name"] == "unknown":
        sentences += [*_forms(best), *_runner_up(record), *_traces(record)]
    sentences += [*_confounded(best), *_second(record), *_cause_p_value(record, best)]
    sentences += _drafts(record, best)
    return [sentence for sentence in sentences if sentence]


def probability_words(value: float) -> str:
    """A probability with three decimals, near one or zero as a bound."""
    if value > CERTAIN:
        return f"> {CERTAIN:g}"
    return f"{value:.3f}" if value >= 0.001 else "< 0.001"


def counted(count: int, what: str) -> str:
    """Some things, up to nine in words."""
    number = _NUMBERS[count] if count < len(_NUMBERS) else f"{count}"
    return f"{number} {what}{'' if count == 1 else 's'}"


def gain_clause(record: Record) -> str:
    """Held-out log score with its standard error; empty where nothing was held out."""
    gain = record["gain"]
    if gain["elpd_diff"] is None:
        return ""
    count = counted(len(record["events"]), "event")
    text = f"held out {gain['elpd_diff']:+,.1f} ± {gain['elpd_diff_se']:,.1f} nats over {count}"
    return text.replace("-", "−")


def gain_sentence(record: Record) -> str:
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


def alike_nothing(record: Record) -> list[str]:
    """Causes whose evidence is within three nats of the baseline's, which they leave as it is."""
    return [
        cause["name"]
        for cause in record["causes"]
        if cause["name"] not in ("none", "unknown")
        and abs(cause["log_bayes_factor"]) < CONFOUNDED_NATS
    ]


def _headline(record: Record, best: Record) -> str:
    probability = f"probability {probability_words(best['probability'])}"
    if best["name"] == "none":
        events = counted(len(record["events"]), "event")
        parts = [f"Nothing is missing: the baseline explains {events}", probability]
    elif best["name"] == "unknown":
        nats = f"{best['log_bayes_factor']:+,.0f} nats over the baseline".replace("-", "−")
        parts = ["Something is missing that no cause of the catalogue mends", probability, nats]
    else:
        said = best.get("says") or f"{best['name']} is at work"
        parts = [said[0].upper() + said[1:], probability, gain_clause(record)]
    if record["p_value"] is not None:
        parts.append(f"p = {record['p_value']:.2g} for the baseline")
    return "; ".join(part for part in parts if part) + "."


def _reconciled(record: Record, best: Record) -> list[str]:
    """Why p-value, symptoms, gain and probability differ, where they seem to."""
    p, sentences = record["p_value"], []
    is_small = p is not None and p < SIGNIFICANT
    if best["name"] == "none" and is_small:
        sentences.append(
            f"p = {p:.2g} is small although nothing is named: in one flight of {1.0 / p:.0f} "
            "chance alone leaves as much. No cause, and no torque that wanders, explains it by "
            "more than it costs in prior probability; further events will tell."
        )
    if best["name"] == "unknown" and p is not None and not is_small:
        sentences.append(
            f"p = {p:.2g} does not see it. {_TESTED}, for slow drifts and lines. They miss what "
            "wanders otherwise, and what free quantities have taken up. The probability weighs all "
            "rows."
        )
    if best["name"] not in ("none", "unknown"):
        if p is not None and not is_small:
            nothing = " and no symptom is listed" if not record["symptoms"] else ""
            sentences.append(
                f"p = {p:.2g}{nothing} although the cause is probable, because "
                f"{_taken_up(record)}. {_TESTED}; the probability also counts how far free "
                "quantities had to be bent for that."
            )
        sentences += _no_gain(record)
    return sentences


def _taken_up(record: Record) -> str:
    """What the baseline bends in place of the cause."""
    bent = record.get("taken_up") or []
    if not bent:
        return "the baseline's free quantities take its effect up between them"
    parts = ", ".join(
        f"{item['quantity']} ({rounded(item['baseline'], 1)} prior σ, with the cause "
        f"{rounded(item['extended'], 1)})"
        for item in bent
    )
    return f"without it the baseline takes the effect up by {parts}"


def _no_gain(record: Record) -> list[str]:
    gain = record["gain"]
    if gain["elpd_diff"] is None or gain["verdict"] == "gain":
        return []
    what = (
        "less than two standard errors over events that differ"
        if gain["elpd_diff"] <= STANDARD_ERRORS * gain["elpd_diff_se"]
        else "with residuals that do not get smaller"
    )
    why = (
        ": the others already tell the baseline how to bend, so that it predicts nearly as well"
        if gain["elpd_diff"] <= SURE_NATS
        else ""
    )
    return [
        f"Events held out show no sure gain ({what}){why}. The cause is named by the probability "
        "of all events together."
    ]


def _cause_p_value(record: Record, best: Record) -> list[str]:
    p = record["gain"].get("p_value")
    if p is None or best["name"] in ("none", "unknown"):
        return []
    if record["gain"]["still_discrepant"]:
        return [f"With the cause p = {p:.2g}: something more is missing."]
    return [f"With the cause p = {p:.2g}: nothing more is seen to be missing."]


def _visible(record: Record) -> list[str]:
    """From which size on causes would have been named: of each kind the target least seen.

    Faults of thrusters come first, then what is seen best.
    """
    seen = [row for row in record.get("visible", []) if row["says"] is not None]
    hardest: dict[str, str] = {}
    for row in sorted(seen, key=lambda row: row["thruster"] is None):
        hardest[row["cause"].partition(":")[0]] = row["says"]
    if not hardest:
        return []
    named = "; ".join(list(hardest.values())[:MOST_NAMED])
    return [f"Nine of ten such flights would have shown, at odds of nine to one: {named}."]


def _forms(best: Record) -> list[str]:
    """Which form of ``unknown`` it is, where that is more likely than not."""
    forms = best.get("forms") or {}
    if not forms:
        return []
    form, share = max(forms.items(), key=lambda pair: pair[1])
    if share < 0.5:
        return []
    return [f"Of its forms {FORMS[form]} has {probability_words(share)} of the probability."]


def _runner_up(record: Record) -> list[str]:
    """The best cause that there is, its size, and what it leaves."""
    left = record["runner_up"]
    if left is None:
        return []
    cause = next(item for item in record["causes"] if item["name"] == left["name"])
    said = cause.get("says")
    remains = [
        f"RMS {value:.3g} {unit} where the baseline leaves {record['baseline'][key]:.3g} {unit}"
        for key, unit in UNITS.items()
        if (value := left.get(key)) is not None
    ]
    if left["p_value"] is not None:
        remains.append(f"p = {left['p_value']:.2g}")
    text = (
        f"The best cause, {left['name']}, gains {cause['log_bayes_factor']:+,.1f} nats over the "
        f"baseline and is {left['behind_unknown_nats']:,.1f} nats behind unknown"
    )
    text += f": {said}." if said else "."
    if remains:
        text += f" It leaves {', '.join(remains)}: not to be believed as it stands."
    return [text.replace("+-", "−")]


def _traces(record: Record) -> list[str]:
    """Where the power is and what it goes with."""
    sentences = []
    lines = [item for item in record.get("spectrum", []) if item["chance"] < SIGNIFICANT]
    if lines:
        peak = max(lines, key=lambda item: item["power"])
        period = 1.0 / peak["peak_hz"]
        sentences.append(
            f"The innovations' spectrum peaks at {peak['peak_hz']:.3g} Hz (a period of "
            f"{period:.3g} s) about {peak['axis'].upper()} in {peak['event']}, with "
            f"{100.0 * peak['share']:.0f} % of the power there."
        )
    drivers = [item for item in record.get("drivers", []) if abs(item["z"]) > item["band_z"]]
    if drivers:
        named = ", ".join(f"{item['driver']} ({rounded(item['z'], 0)} σ)" for item in drivers[:3])
        sentences.append(f"What is left is correlated most with {named}.")
    return sentences


def _drafts(record: Record, first: Record) -> list[str]:
    """The effect drafted, and its held-out gain."""
    drafts = record.get("drafts", [])
    if not drafts:
        return []
    best = drafts[0]
    about = UNKNOWN if first["name"] == UNKNOWN else "what is named"
    score = (
        f"{best['heldout_gain_nats']:+,.0f} ± {best['heldout_gain_se_nats']:,.0f} nats, each "
        f"{best['held_out']} held out in turn, in the linear model about {about}"
    ).replace("-", "−")
    if not best["is_gain"]:
        return [
            f"No drafted effect predicts what was held out; the nearest: {best['says']} ({score})."
        ]
    return [
        f"Drafted from what is left: {best['says']} ({score}). Its file, drafts/{best['name']}.py, "
        "goes into --effects as it is."
    ]


def _confounded(best: Record) -> list[str]:
    names: Sequence[str] = best["confounded_with"]
    return [f"These data cannot tell it from {some_of(names, MOST_NAMED)}."] if names else []


def some_of(names: Sequence[str], most: int) -> str:
    """Names one after another; of many the first, and how many others there are."""
    others = f" and {len(names) - most} others" if len(names) > most else ""
    return f"{', '.join(names[:most])}{others}"


def _second(record: Record) -> list[str]:
    if len(record["extended"]["causes"]) < 2:
        return []
    second = record["extended"]["causes"][-1]
    return [f"A second cause, {second}, gains {record['second_cause_nats']:.1f} nats beside it."]
