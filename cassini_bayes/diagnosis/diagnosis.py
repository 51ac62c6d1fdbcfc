"""A diagnosis: show, name, extend and measure, for any case; the whole of it as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from typing import Any, Final, Generic

import numpy as np

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.case import (
    UNKNOWN,
    Case,
    Discrepancies,
    Fits,
    H,
    Size,
    Weighed,
    Work,
)
from cassini_bayes.diagnosis.drafts import Draft
from cassini_bayes.diagnosis.score import HeldOut
from cassini_bayes.diagnosis.stages import SERIAL, StageRunner
from cassini_bayes.diagnosis.verdict import Verdict, normalised, weigh
from cassini_bayes.effects.wording import Stated

WIDTHS: Final = (0.5, 2.0)  # of the effects' priors, which are good to a factor of two
LEAST_PROBABILITY: Final = 1e-6
"""Of a cause, below which its size and its probability at other widths are not written: nobody
reads them, and sizes of fifty causes take as long as their searches."""
THROUGHOUT: Final = "throughout"
SURE: Final = 0.95  # probability that a cause acts in all events, above which it is not said
MOST_PRINTED: Final = 0.99  # probability of an onset: more digits are not worth reading
SIGNIFICANT: Final = 0.05  # p-value below which a model is called discrepant still
PARTS: Final = 4  # in which the records of causes are made: work for up to four processes
KEPT: Final[Mapping[str, Any]] = {
    "causes": list,
    "width": dict,
    "by width": list,
    "baseline score": HeldOut | None,
    "score": HeldOut | None,
    "p": float | None,
    "left": tuple[float | None, tuple[Draft, ...]],
    "drafts": tuple[Draft, ...],
    "runner-up": dict,
    "visible": list,
}
"""Types of the measures that are kept, by name without its number; what figures show is not."""


@dataclass(frozen=True)
class Diagnosis(Generic[H]):
    """A verdict, what tests show, and the record that is written.

    ``extended`` is the model to go on with, ``widths`` has the probabilities of all hypotheses with
    the effects' priors that much wider. ``curves`` are those of what nothing explains, ``drafts``
    the effects proposed where ``unknown`` is best, or where a cause leaves something.
    """

    case: Case[H]
    verdict: Verdict[H]
    extended: Weighed[H]
    widths: Mapping[float, Mapping[str, float]]
    shown: Discrepancies
    record: dict[str, Any]
    curves: tuple[Any, ...] = ()
    drafts: tuple[Any, ...] = ()


def diagnose(
    case: Case[H],
    rng: np.random.Generator,
    *,
    measure_gain: bool = True,
    pairs: bool = True,
    log: Log = silent,
    workers: StageRunner = SERIAL,
) -> Diagnosis[H]:
    """Show, name, extend and measure; returns everything for JSON and report.

    Parameters
    ----------
    case
        Data and the hypotheses on them.
    rng
        For importance draws and bootstrap. Other widths are weighed with the same draws.
    measure_gain
        Whether to hold events out (takes as many more fits as there are events, twice).
    pairs
        Whether to look for a second cause.
    log
        Told how far it got.
    workers
        Share out causes, fits without an event and measures, and keep what is finished, all but
        what figures show; the result does not depend on them.
    """
    at_start = deepcopy(rng)
    verdict = weigh(case, rng, pairs=pairs, log=log, workers=workers)
    none, extended = verdict.none, case.examined(verdict.extended)
    runner_up = verdict.best_cause if verdict.best.name == UNKNOWN else None
    # a generator for each: what is drawn does not depend on how the work is shared out
    of_baseline, of_extended, of_p, of_extended_p, of_shown = rng.spawn(5)
    of_causes = rng.spawn(len(verdict.weighed))
    of_runner_up, of_curves, of_widths = rng.spawn(3)
    # what takes longest begins
    work: dict[str, Work] = {}
    if verdict.best.name == UNKNOWN:
        work["drafts"] = partial(case.drafts, verdict.unknown)
    if extended.is_cause:
        drafts = verdict.best.name != UNKNOWN
        work["left"] = partial(_left_by, case, extended, of_extended_p, drafts=drafts)
    work["shown"] = partial(case.show, none, extended, of_shown)
    for part in range(PARTS):
        work[f"causes {part}"] = partial(_cause_records, case, verdict, of_causes, part)
    if measure_gain:
        # the baseline first: where a cause is named it bends, and its fits take longest
        scored = {"baseline score": (none, of_baseline)}
        if extended is not none:
            scored["score"] = (extended, of_extended)
        fits = _fits_to_hold_out(case, [w for w, _ in scored.values()], log, workers)
        for (name, (weighed, own)), given in zip(scored.items(), fits, strict=True):
            work[name] = partial(case.held_out, weighed, own, log, given)
    for width in WIDTHS:
        work[f"width {width:g}"] = partial(case.scores_at, width, verdict, deepcopy(at_start))
    work["by width"] = partial(case.by_width, verdict, of_widths)
    work["p"] = partial(case.p_value, none, of_p)
    work["curves"] = partial(case.curves, verdict.unknown, of_curves)
    if verdict.best is none:
        for part in range(PARTS):
            work[f"visible {part}"] = partial(_visible, case, verdict, part)
    if runner_up is not None:
        work["runner-up"] = partial(_runner_up, case, verdict, runner_up, of_runner_up)
    kinds = [KEPT.get(name.rstrip(" .0123456789")) for name in work]
    results = workers.results("measures", list(work.values()), kinds)
    measured = dict(zip(work, results, strict=True))
    if extended.is_cause:
        measured["extended p"], left = measured["left"]
        measured.setdefault("drafts", left)
    widths = {width: normalised(measured[f"width {width:g}"]) for width in WIDTHS}
    record = _record(case, verdict, extended, widths, measured)
    return Diagnosis(
        case,
        verdict,
        extended,
        widths,
        measured["shown"],
        record,
        tuple(measured["curves"]),
        tuple(measured.get("drafts", ())),
    )


def _left_by(
    case: Case[H], extended: Weighed[H], rng: np.random.Generator, *, drafts: bool
) -> tuple[float | None, tuple[Draft, ...]]:
    """The p-value of what a cause leaves, and drafts of it if wanted, where it is discrepant."""
    p = case.p_value(extended, rng)
    return p, tuple(case.drafts(extended)) if drafts and _is_discrepant(p) else ()


def _fits_to_hold_out(
    case: Case[H], scored: Sequence[Weighed[H]], log: Log, workers: StageRunner
) -> list[list[Fits]]:
    """What holding out takes, for each of some hypotheses: all of it in one stage."""
    pieces = [case.fits_to_hold_out(weighed, log) for weighed in scored]
    results = iter(workers.results("fits without an event", list(chain(*pieces)), Fits))
    return [list(islice(results, len(own))) for own in pieces]


def _record(
    case: Case[H],
    verdict: Verdict[H],
    extended: Weighed[H],
    widths: Mapping[float, Mapping[str, float]],
    measured: Mapping[str, Any],
) -> dict[str, Any]:
    """``diagnosis.json``."""
    base_score: HeldOut | None = measured.get("baseline score")
    own_score: HeldOut | None = measured.get("score", base_score)
    none, best, pair = verdict.none, verdict.best, verdict.pair
    shown: Discrepancies = measured["shown"]
    left_by = extended if extended.is_cause else none
    return {
        "format": 1,
        "events": list(case.event_ids),
        "findings": [*case.findings, *_at_edge(case, verdict)],
        "baseline": _fit_record(case.unit, none, base_score, case.rmse(none)),
        "discrepant": verdict.is_discrepant,
        "p_value": measured["p"],
        "symptoms": list(shown.symptoms) if verdict.is_discrepant else [],
        "closure": list(shown.closure),
        "causes": [cause for part in range(PARTS) for cause in measured[f"causes {part}"]],
        "runner_up": measured.get("runner-up"),
        "visible": sorted(
            (row for part in range(PARTS) for row in measured.get(f"visible {part}", [])),
            key=lambda row: (row["size"] or np.inf) / row["prior_width"],
        ),
        "drafts": [draft.record for draft in measured.get("drafts", ())],
        "extended": {
            "causes": list(extended.hypothesis.causes or [extended.name] * (extended is not none)),
            **_fit_record(case.unit, extended, own_score, case.rmse(left_by)),
        },
        "gain": _gain(base_score, own_score, measured.get("extended p", measured["p"])),
        "sensitivity": {f"{width:g}": _not_negligible(shares) for width, shares in widths.items()},
        "by_width": [
            {**row, "probabilities": _not_negligible(row["probabilities"])}
            for row in measured["by width"]
        ],
        "second_cause_nats": None
        if pair is None or verdict.best_cause is None
        else float(pair.net_evidence - verdict.best_cause.net_evidence),
        "second_cause_like": list(verdict.equal_seconds),
        "separation": [
            {"cause": other, "measurement": case.separation(best.name, other)}
            for other in verdict.confounded_with(best.name)
        ],
        **shown.more,
    }


def _at_edge(case: Case[H], verdict: Verdict[H]) -> list[str]:
    """Sizes that no interval is right of: of the best cause, and of the model to go on with."""
    shown = {id(w): w for w in (verdict.best_cause, verdict.extended) if w is not None}
    return list(dict.fromkeys(line for w in shown.values() for line in case.at_edge(w)))


def _not_negligible(shares: Mapping[str, float]) -> dict[str, float]:
    """Probabilities that somebody reads."""
    return {name: share for name, share in shares.items() if share > LEAST_PROBABILITY}


def _fit_record(
    unit: str, weighed: Weighed[H], score: HeldOut | None, rmse: float | None
) -> dict[str, Any]:
    residuals: dict[str, float | None] = {"rmse_nms": None, "heldout_rmse_nms": None}
    residuals[f"rmse_{unit}"] = rmse
    residuals[f"heldout_rmse_{unit}"] = None if score is None else score.rmse
    return {
        "elpd": None if score is None else score.elpd,
        "elpd_se": None if score is None else score.elpd_se,
        "rmse_nms": residuals.pop("rmse_nms"),
        "heldout_rmse_nms": residuals.pop("heldout_rmse_nms"),
        "heldout_coverage_90": None if score is None else score.coverage_90,
        "log_evidence": float(weighed.net_evidence),
        **residuals,
    }


def _is_discrepant(p: float | None) -> bool:
    return p is not None and p < SIGNIFICANT


def _gain(base: HeldOut | None, extended: HeldOut | None, p: float | None) -> dict[str, Any]:
    gain = None if base is None or extended is None else extended.gain_over(base)
    return {
        "elpd_diff": None if gain is None else gain.nats,
        "elpd_diff_se": None if gain is None else gain.standard_error,
        "heldout_rmse_ratio": None if gain is None else gain.rmse_ratio,
        "still_discrepant": None if p is None else _is_discrepant(p),
        "p_value": p,
        "verdict": "held-out gain: not measurable" if gain is None else gain.verdict,
    }


def _cause_records(
    case: Case[H], verdict: Verdict[H], generators: Sequence[np.random.Generator], part: int
) -> list[dict[str, Any]]:
    """One part of the records of all causes, each with a generator of its own."""

    def record(w: Weighed[H], log_probability: float, rng: np.random.Generator) -> dict[str, Any]:
        is_runner_up = w is verdict.best_cause and verdict.best is verdict.unknown
        is_shown = w.z is not None or log_probability > np.log(LEAST_PROBABILITY) or is_runner_up
        sizes = case.sizes(w, rng) if is_shown and w.is_cause else {}
        return {
            "name": w.name,
            "probability": float(np.exp(log_probability)),
            "log_bayes_factor": verdict.log_bayes_factor(w),
            "parameters": {
                key: _size_record(size, case.kinds.unit(w.name, key)) for key, size in sizes.items()
            },
            "says": _sentence(case, w, sizes),
            "settled": {key: v for own in case.settled(w) for key, v in own.record.items()},
            "onset": _onset_record(w),
            "forms": dict(w.forms),
            "confounded_with": list(verdict.confounded_with(w.name)) if is_shown else [],
            "log_evidence_se": w.log_evidence_se,
            "effective_draws": w.effective_draws,
            "pareto_k": w.pareto_k,
        }

    each = list(zip(verdict.weighed, verdict.log_probabilities.tolist(), generators, strict=True))
    edges = np.linspace(0, len(each), PARTS + 1).astype(int)
    return [record(*cause) for cause in each[edges[part] : edges[part + 1]]]


def _visible(case: Case[H], verdict: Verdict[H], part: int) -> list[dict[str, Any]]:
    """One part of the sizes from which causes would have been named."""
    rows = (case.visible(verdict.none, weighed) for weighed in verdict.weighed[part::PARTS])
    return [row for row in rows if row is not None]


def _size_record(size: Size, unit: str) -> dict[str, Any]:
    return {"mean": size.mean, "sd": size.sd, "hdi_90": list(size.interval), "unit": unit}


def _onset_record(weighed: Weighed[H]) -> dict[str, Any] | None:
    """The event that a cause most likely begins with, null throughout, and all probabilities."""
    begins = weighed.begins
    if begins is None:
        return None
    return {
        "event": begins.event or None,
        "probability": begins.probability,
        "probabilities": {
            beginning.event or THROUGHOUT: beginning.probability for beginning in weighed.beginnings
        },
    }


def _sentence(case: Case[H], weighed: Weighed[H], sizes: Mapping[str, Size]) -> str | None:
    """What the sizes of a cause mean and when it begins, in words; None without sizes."""
    if not sizes:
        return None
    stated = {
        key: Stated(size.mean, size.sd, *size.interval, case.kinds.unit(weighed.name, key))
        for key, size in sizes.items()
    }
    settled = [own.said for own in case.settled(weighed) if own.said]
    said, begins = ", ".join([case.kinds.says(weighed.name, stated), *settled]), weighed.begins
    if begins is None or (not begins.event and begins.probability > SURE):
        return said
    when = f"from {begins.event} on" if begins.event else THROUGHOUT
    sure = begins.probability > MOST_PRINTED
    probability = f"> {MOST_PRINTED}" if sure else f"{begins.probability:.2f}"
    return f"{said}, {when} (probability {probability})"


def _runner_up(
    case: Case[H], verdict: Verdict[H], best: Weighed[H], rng: np.random.Generator
) -> dict[str, Any]:
    """What the best cause leaves where ``unknown`` is more probable than any."""
    examined = case.examined(best)
    return {
        "name": best.name,
        "behind_unknown_nats": float(verdict.unknown.net_evidence - best.net_evidence),
        f"rmse_{case.unit}": case.rmse(examined),
        "p_value": case.p_value(examined, rng),
    }
