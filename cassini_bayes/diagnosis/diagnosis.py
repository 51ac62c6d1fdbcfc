"""``diagnosis.json``: the whole of a diagnosis as plain data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics.columns import Rows
from cassini_bayes.computing.processes import in_processes
from cassini_bayes.diagnosis.correlations import Shown, show
from cassini_bayes.diagnosis.evidence import Weighed
from cassini_bayes.diagnosis.extended import Case
from cassini_bayes.diagnosis.gain import LEAST_EVENTS, HeldOut, held_out
from cassini_bayes.diagnosis.innovations import EventRows, Linear, event_rows, innovations
from cassini_bayes.diagnosis.naming import Verdict, name_causes
from cassini_bayes.diagnosis.oscillation import case_of
from cassini_bayes.diagnosis.p_value import p_value
from cassini_bayes.diagnosis.score import gain_verdict, summed
from cassini_bayes.diagnosis.separation import separating_measurement
from cassini_bayes.diagnosis.sizes import size_draws, weighted_interval
from cassini_bayes.diagnosis.symptoms import Symptom, find_symptoms
from cassini_bayes.diagnosis.totals_gain import held_out_totals
from cassini_bayes.diagnosis.widths import LEAST_PROBABILITY, width_sensitivity
from cassini_bayes.effects.catalogue import Catalogue, read_catalogue
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.spacecraft import couples

Array = NDArray[np.float64]
Say = Callable[[str], None]
DISCREPANT: Final = 0.5
PARTS: Final = 4  # in which the records of causes are made


@dataclass(frozen=True)
class Diagnosis:
    """A verdict with its symptoms, gain and the record that is written.

    ``shown`` are tests of the innovations before and after extension, None without telemetry.
    """

    verdict: Verdict
    extended: Weighed
    extended_rows: tuple[EventRows, ...]
    shown: tuple[Shown, Shown] | None
    record: dict[str, Any]


def diagnose(
    case: Case,
    catalogue: Catalogue,
    rng: np.random.Generator,
    *,
    measure_gain: bool = True,
    rows: Sequence[TotalsEvent] = (),
    say: Say | None = None,
    workers: int = 1,
) -> Diagnosis:
    """Show, name, extend and measure; returns everything for JSON and report.

    Parameters
    ----------
    case, catalogue
        What is diagnosed and what is weighed.
    rng
        For importance draws and bootstrap.
    measure_gain
        Whether to hold events out (takes as many more fits as there are events, twice).
    rows
        What the totals of a case without telemetry were built from: held out one by one.
    say
        Told how far it got.
    workers
        Processes among which causes and measures are shared out; the result does not depend on it.
    """
    verdict = name_causes(case, catalogue, rng, say=say, workers=workers)
    extended = verdict.pair if verdict.pair is not None else verdict.best
    linear, extended_rows = _extended_innovations(verdict, extended)
    # a generator for each: what is drawn does not depend on how the work is shared out
    of_baseline, of_extended, of_p, of_extended_p, of_shown = rng.spawn(5)
    of_causes = rng.spawn(len(verdict.weighed))
    parts: dict[str, Callable[[], Any]] = {
        f"causes {part}": partial(_cause_records, verdict, of_causes, part) for part in range(PARTS)
    }
    if measure_gain:
        score = partial(_held_out_score, verdict, rows, say=say)
        parts["baseline score"] = partial(score, verdict.none, of_baseline)
        if extended is not verdict.none:
            parts["score"] = partial(score, extended, of_extended)
    parts["sensitivity"] = partial(width_sensitivity, verdict)
    if linear is not verdict.linear:
        parts["extended p"] = partial(_p_value, linear, verdict.rows, of_extended_p)
    parts["p"] = partial(_p_value, verdict.linear, verdict.rows, of_p)
    parts["shown"] = partial(_shown, verdict, linear, extended_rows, of_shown)
    found = dict(
        zip(parts, in_processes(lambda part: part(), parts.values(), workers), strict=True)
    )
    base_score = found.get("baseline score")
    own_score = found.get("score", base_score)
    p, shown = found["p"], found["shown"]
    symptoms: tuple[Symptom, ...] = ()
    if shown is not None and _is_discrepant(verdict):
        symptoms = find_symptoms(verdict.rows, shown[0])
    record = {
        "format": 1,
        "events": _event_ids(case),
        "baseline": _fit_record(verdict.none, base_score, verdict.rows),
        "discrepant": _is_discrepant(verdict),
        "p_value": p,
        "symptoms": [asdict(symptom) for symptom in symptoms],
        "closure": [] if shown is None else _closure(*shown),
        "causes": [cause for part in range(PARTS) for cause in found[f"causes {part}"]],
        "extended": {
            "causes": _names(extended),
            **_fit_record(extended, own_score, extended_rows),
        },
        "gain": _gain(base_score, own_score, found.get("extended p", p)),
        "sensitivity": found["sensitivity"],
        "second_cause_nats": None
        if verdict.pair is None
        else float(verdict.pair.net_evidence - verdict.best_cause.net_evidence),
        "second_cause_like": list(verdict.pair_alike),
        "separation": _separation(verdict),
    }
    return Diagnosis(verdict, extended, extended_rows, shown, record)


def catalogue_of(case: Case, path: Any = None) -> Catalogue:
    """The default catalogue, or that of a file, for a case."""
    arguments = () if path is None else (path,)
    return read_catalogue(case.priors, case.wheels, case.inputs, *arguments)


def _held_out_score(
    verdict: Verdict,
    rows: Sequence[TotalsEvent],
    weighed: Weighed,
    rng: np.random.Generator,
    *,
    say: Say | None,
) -> HeldOut | None:
    """Score on telemetry events or on totals rows; None for few of them and for a mix of both."""
    case = verdict.case
    if not case.totals and len(case.sources) >= LEAST_EVENTS:
        return held_out(verdict, weighed, say)
    if not case.sources and len(rows) >= LEAST_EVENTS:
        return held_out_totals(case, rows, verdict.catalogue, weighed, rng, say)
    return None


def _is_discrepant(verdict: Verdict) -> bool:
    return verdict.probabilities["none"] < DISCREPANT


def _event_ids(case: Case) -> list[str]:
    rows = [row.id for row in case.totals]
    return [*rows, *(source.id for source in case.sources)]


def _names(weighed: Weighed) -> list[str]:
    if weighed.name == "none":
        return []
    return [effect.name for effect in weighed.hypothesis.effects] or [weighed.name]


def _extended_innovations(
    verdict: Verdict, extended: Weighed
) -> tuple[Linear | None, tuple[EventRows, ...]]:
    """Linear model and innovations of the extended model: the baseline's where it adds no cause."""
    if verdict.linear is None or not extended.hypothesis.effects:
        return verdict.linear, verdict.rows
    case = case_of(verdict.case, extended.hypothesis)
    linear, rows = innovations(case, extended.hypothesis, extended.mode.point)
    return linear, tuple(rows)


def _p_value(
    linear: Linear | None, rows: Sequence[EventRows], rng: np.random.Generator
) -> float | None:
    return None if linear is None else p_value(linear, [own.time_s for own in rows], rng)


def _shown(
    verdict: Verdict,
    extended: Linear | None,
    rows: tuple[EventRows, ...],
    rng: np.random.Generator,
) -> tuple[Shown, Shown] | None:
    if verdict.linear is None or extended is None:
        return None
    before = show(verdict.linear, verdict.rows, rng)
    return before, before if extended is verdict.linear else show(extended, rows, rng)


def _closure(before: Shown, after: Shown) -> list[dict[str, Any]]:
    """Momentum at the end against the start, N m s, with 1 σ if the model is true."""
    return [
        {
            "event": old.event,
            "axis": old.axis,
            "baseline_n_m_s": old.value,
            "baseline_sd_n_m_s": old.sd,
            "extended_n_m_s": new.value,
            "extended_sd_n_m_s": new.sd,
        }
        for old, new in zip(before.closure, after.closure, strict=True)
    ]


def _rmse(rows: tuple[EventRows, ...]) -> float | None:
    if not rows:
        return None
    values = np.concatenate([own.residual_n_m_s.ravel() for own in rows])
    return float(np.sqrt((values**2).mean()))


def _fit_record(
    weighed: Weighed, score: HeldOut | None, rows: tuple[EventRows, ...]
) -> dict[str, Any]:
    return {
        "elpd": None if score is None else score.elpd,
        "elpd_se": None if score is None else score.elpd_se,
        "rmse_nms": _rmse(rows),
        "heldout_rmse_nms": None if score is None else score.rmse_n_m_s,
        "heldout_coverage_90": None if score is None else score.coverage_90,
        "log_evidence": float(weighed.net_evidence),
    }


def _gain(base: HeldOut | None, own: HeldOut | None, p: float | None) -> dict[str, Any]:
    if base is None or own is None:
        return {
            "elpd_diff": None,
            "elpd_diff_se": None,
            "heldout_rmse_ratio": None,
            "still_discrepant": None if p is None else p < 0.05,
            "p_value": p,
            "verdict": "held-out gain: not measurable",
        }
    total, error = summed(own.log_scores - base.log_scores)
    ratio = own.rmse_n_m_s / base.rmse_n_m_s
    return {
        "elpd_diff": total,
        "elpd_diff_se": error,
        "heldout_rmse_ratio": ratio,
        "still_discrepant": None if p is None else p < 0.05,
        "p_value": p,
        "verdict": gain_verdict(total, error, ratio),
    }


def _cause_records(
    verdict: Verdict, generators: Sequence[np.random.Generator], part: int
) -> list[dict[str, Any]]:
    """One part of the records of all causes, each with a generator of its own."""
    rows = [event_rows(verdict.case, place) for place in range(len(verdict.case.sources))]

    def record(
        weighed: Weighed, log_probability: float, rng: np.random.Generator
    ) -> dict[str, Any]:
        shown = weighed.z is not None or log_probability > np.log(LEAST_PROBABILITY)
        return {
            "name": weighed.name,
            "probability": float(np.exp(log_probability)),
            "log_bayes_factor": float(weighed.net_evidence - verdict.none.log_evidence),
            "parameters": _parameters(verdict.case, weighed, rng, rows)
            if shown and weighed.hypothesis.effects
            else {},
            "confounded_with": list(verdict.confounded_with(weighed.name)) if shown else [],
        }

    each = list(zip(verdict.weighed, verdict.log_probabilities.tolist(), generators, strict=True))
    edges = np.linspace(0, len(each), PARTS + 1).astype(int)
    return [record(*own) for own in each[edges[part] : edges[part + 1]]]


def _parameters(
    case: Case, weighed: Weighed, rng: np.random.Generator, rows: list[Rows]
) -> dict[str, Any]:
    values, weights = size_draws(case, weighed, rng, rows)
    return {key: _summary(value, weights) for key, value in values.items()}


def _summary(values: Array, weights: Array) -> dict[str, Any]:
    mean = float(weights @ values / weights.sum())
    sd = float(np.sqrt(weights @ (values - mean) ** 2 / weights.sum()))
    return {"mean": mean, "sd": sd, "hdi_90": list(weighted_interval(values, weights))}


def _separation(verdict: Verdict) -> list[dict[str, str]]:
    best = verdict.best
    if not best.hypothesis.effects:
        return []
    priors = verdict.case.priors
    groups = tuple(couples(priors.spacecraft, priors.branch))
    return [
        {
            "cause": other,
            "measurement": separating_measurement(best.name, other, groups),
        }
        for other in verdict.confounded_with(best.name)
    ]
