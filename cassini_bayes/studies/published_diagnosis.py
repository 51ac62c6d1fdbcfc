"""Diagnosis of published data: the flight wheel biases and printed thrusts, as a page with figures.

(a) the eight flight biases as totals rows; (b) five thrusts of paper 000 Table 2; (c) the test-bed
case of paper 000; (d) thrusts of the A branch, paper 003 Table 1; (e) on-times of the eight flight
biases against the ideal calculation of paper 001. Every case is weighed at half,
once and twice the default width of its effects' priors. Where there are three events or estimates,
each is left out in turn to measure what the best cause gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.case import NONE, UNKNOWN, Case, Size
from cassini_bayes.diagnosis.diagnosis import diagnose
from cassini_bayes.diagnosis.estimate_case import Candidate, EstimateCase, untrusted
from cassini_bayes.diagnosis.read import read_events
from cassini_bayes.diagnosis.score import LEAST_PIECES, HeldOut
from cassini_bayes.diagnosis.verdict import Verdict, ranked
from cassini_bayes.studies.published_cases import Branch, a_branch, flight_2004, fsds
from cassini_bayes.studies.published_on_times import on_time_section
from cassini_bayes.studies.published_sections import (
    WIDTHS,
    Section,
    by_width,
    gain_table,
    in_words,
)
from cassini_bayes.studies.study import Study

NAME: Final = "diagnosis-published"
UNSHOWN: Final = "thrust_common_n"  # the factor beside it says as much


def estimate_section(key: str, case: EstimateCase, seed: int, more: str = "") -> Section:
    """Causes of printed thrusts at every width, each with the same draws."""
    verdicts = {
        width: ranked(case.weighed(case.hypotheses(width), np.random.default_rng(seed)))
        for width in WIDTHS
    }
    verdict = verdicts[1.0]
    left = case.residual_n(verdict.best)
    share, rms = float(np.abs(left / case.estimate_n).max()), float(np.sqrt((left**2).mean()))
    details = [
        held_out_gain(case, verdict, seed, f"{len(case.estimate_n)} estimates", "N")[0],
        _draws([w for verdict in verdicts.values() for w in verdict.weighed]),
        *([more] if more else []),
    ]
    return Section(
        key,
        verdict,
        by_width(verdict, {width: w.probabilities for width, w in verdicts.items()}),
        {w.name: _sizes(case, w) for w in verdict.weighed},
        f"`{verdict.best.name}` leaves {_newtons(case, verdict.best)} N (estimate less posterior "
        f"mean prediction): {rms:.3f} N RMS, at most {100 * share:.1f} % of an estimate.",
        "\n\n".join(details),
    )


def _sizes(case: EstimateCase, weighed: Candidate) -> str:
    sizes = case.sizes(weighed, np.random.default_rng(0))
    return in_words({key: size for key, size in sizes.items() if key != UNSHOWN})


def _newtons(case: EstimateCase, weighed: Candidate) -> str:
    return ", ".join(f"{value:+.3f}" for value in case.residual_n(weighed))


def _draws(weighed: Sequence[Candidate]) -> str:
    """How well the draws cover the posteriors of all hypotheses."""
    fewest = min(w.effective_draws for w in weighed)
    worst = max(w.pareto_k for w in weighed)
    text = (
        f"Draws of every hypothesis: at least {fewest:.0f} effective, Pareto k̂ {worst:.2f} or less."
    )
    doubt = untrusted(weighed)
    return f"{text} **{doubt}**" if doubt else text


def held_out_gain(
    case: Case[Any], verdict: Verdict[Any], seed: int, pieces: str, unit: str
) -> tuple[str, HeldOut | None]:
    """What the best cause and ``unknown`` gain over ``none`` on pieces that were left out.

    Each with the same draws. In words, with the score of ``none``; none where there are too few.
    """
    assert verdict.best_cause is not None
    scores: dict[str, HeldOut] = {}
    for name in (NONE, verdict.best_cause.name, UNKNOWN):
        score = case.held_out(verdict.named(name), np.random.default_rng(seed))
        if score is None:
            kind = pieces.split()[-1]
            return f"Held-out gain: not measurable (fewer than {LEAST_PIECES} {kind}).", None
        scores[name] = score
    base = scores.pop(NONE)
    return gain_table(f"each of {pieces}", unit, base, scores), base


def pair_table(branch: Branch, case: EstimateCase, seed: int) -> str:
    """The best two causes together at every width, beside the best single hypothesis."""
    rows, weighed = [], []
    for width in WIDTHS:
        rng = np.random.default_rng(seed)
        pairs = case.weighed(branch.pairs(width), rng)
        none, unknown = case.weighed(branch.hypotheses(width)[:2], rng)
        weighed += pairs
        best = max(pairs, key=lambda pair: pair.score)
        rows.append(
            f"| {width:g} | `{best.name}` | {best.log_evidence - none.log_evidence:+.1f} | "
            f"{best.log_evidence - unknown.log_evidence:+.1f} | {best.score - unknown.score:+.1f} "
            f"| {_sizes(case, best)} | {_newtons(case, best)} |"
        )
    lines = "\n".join(rows)
    return f"""\
Two causes together: the best of {len(weighed) // len(WIDTHS)} pairs at every width. Log Bayes
factors and log posterior odds are in nats.

| width | pair | against `none` | against `unknown` | odds against `unknown` | mean ± 1 sd \
| estimates less prediction (N) |
| --- | --- | --- | --- | --- | --- | --- |
{lines}

{_draws(weighed)}"""


def flight_section(totals: Path, priors: Path, seed: int, log: Log = silent) -> Section:
    """Causes of the flight biases at every width, by the machinery of ``diagnose``."""
    case = BalanceCase(read_events([str(totals)], priors, "flight", log))
    diagnosis = diagnose(case, np.random.default_rng(seed), measure_gain=False, log=log)
    verdict = diagnosis.verdict
    best = verdict.best
    remains = (
        "The baseline leaves nothing that a cause of the catalogue explains better."
        if best is verdict.none
        else f"`{best.name}` gains {verdict.log_bayes_factor(best):.1f} nats over the baseline."
    )
    sizes = {
        cause["name"]: in_words(
            {key: Size(p["mean"], p["sd"], p["hdi_90"]) for key, p in cause["parameters"].items()}
        )
        for cause in diagnosis.record["causes"]
    }
    table, gain = by_width(verdict, diagnosis.widths), flight_gain(case, verdict, seed)
    return Section("a", verdict, table, sizes, remains, gain)


def flight_gain(case: BalanceCase, verdict: Verdict[Any], seed: int) -> str:
    """What is gained on totals rows that were left out, and how often ``none`` holds them."""
    text, base = held_out_gain(case, verdict, seed, f"{len(case.event_ids)} events", "N m s")
    if base is None:
        return text
    assert base.coverage_90 is not None
    return (
        f"{text}\n\nCentral 90 % intervals of `none` hold {100 * base.coverage_90:.0f} % of the "
        f"{3 * len(case.event_ids)} held-out components."
    )


def write_published_diagnosis(
    study: Study, totals: Path, priors: Path, log: Log = silent
) -> dict[str, str]:
    """Weigh all cases, write page, table and figures; returns the first cause of every case."""
    seed = study.seed
    branch, thrusts = a_branch()
    sections = [
        flight_section(totals, priors, seed, log),
        estimate_section("b", flight_2004(), seed),
        estimate_section("c", fsds(), seed),
        estimate_section("d", thrusts, seed, pair_table(branch, thrusts, seed)),
        on_time_section(totals, priors, seed, log),
    ]
    table = pd.concat([section.table() for section in sections])
    figures = {f"-{section.key}": section.figure for section in sections}
    title, body = "What published data say against their models", _body(sections)
    study.publish(title, body, "studies.published_diagnosis", {"": table}, figures)
    return {section.key: section.first for section in sections}


def _body(sections: Sequence[Section]) -> str:
    text = "\n".join(section.text(f"{NAME}-{section.key}.png") for section in sections)
    return f"""\
What explains the figures that the papers print? Five cases. Each table has the posterior
probability of the causes, `none` and `unknown` among them, with the prior of each effect's size
half, once and twice as wide as the default. [Published cases](published-cases.md) says what the
cases assume and what their outcome means.

Units stand in the names of the parameters; `thrust_factor`, `scale` and `ratio` are fractions. All
numbers: [{NAME}.csv]({NAME}.csv).

{text}"""
