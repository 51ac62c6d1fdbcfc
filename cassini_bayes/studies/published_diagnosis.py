"""Diagnosis of published data: the flight wheel biases and printed thrusts, as a page with figures.

(a) the eight flight biases as totals rows; (b) five thrusts of paper 000 Table 2; (c) the test-bed
case of paper 000; (d) thrusts of the A branch, paper 003 Table 1; (e) on-times of the eight flight
biases against the ideal calculation of paper 001. Every case is weighed at half,
once and twice the default width of its effects' priors. Where there are three events or estimates,
each is left out in turn to measure what the best cause gains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes.diagnosis.diagnosis import Diagnosis, catalogue_of, diagnose
from cassini_bayes.diagnosis.extended import Case
from cassini_bayes.diagnosis.on_time_report import OnTimeFindings, on_time_findings
from cassini_bayes.diagnosis.read import read_case
from cassini_bayes.diagnosis.score import gain_verdict, summed
from cassini_bayes.diagnosis.summaries import (
    SummaryCause,
    SummaryVerdict,
    leave_out,
    untrusted,
    weigh_summaries,
)
from cassini_bayes.diagnosis.totals_gain import held_out_totals
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.report.plots.criticism import width_figure
from cassini_bayes.report.plots.on_times import on_time_figure
from cassini_bayes.studies.published_cases import (
    UNKNOWN,
    BranchCase,
    PulseCase,
    a_branch,
    flight_2004,
    fsds,
)
from cassini_bayes.studies.study import Study

Array = NDArray[np.float64]
WIDTHS: Final = (0.5, 1.0, 2.0)
NAME: Final = "diagnosis-published"
TITLES: Final[Mapping[str, str]] = {
    "a": "Eight flight wheel biases (paper 001, Tables 3.a-3.h)",
    "b": "Five flight biases of 2004 (paper 000, Table 2)",
    "c": "Test-bed case (paper 000)",
    "d": "A-branch thrusts (paper 003, Table 1)",
    "e": "On-times of the eight flight biases, predicted by the ideal calculation of paper 001",
}
LEAST_EVENTS: Final = 3


@dataclass(frozen=True)
class Weighing:
    """One case: probabilities by width and cause, and the causes' sizes at default width.

    ``details`` are paragraphs and tables after the table of causes.
    """

    key: str
    probability: pd.DataFrame  # index cause, columns WIDTHS
    log_bayes_factor: Mapping[str, float]
    log_evidence_se: Mapping[str, float]
    sizes: Mapping[str, str]
    remains: str
    details: str = ""

    @property
    def first(self) -> str:
        """The most probable cause at default width."""
        return str(self.probability[1.0].idxmax())


def weigh_summary_case(key: str, case: PulseCase | BranchCase, seed: int) -> Weighing:
    """Causes of printed thrusts at every width."""
    found: dict[float, list[SummaryVerdict]] = {
        width: weigh_summaries(
            case.estimate_n, case.sd_n, case.causes(width), np.random.default_rng(seed)
        )
        for width in WIDTHS
    }
    table = pd.DataFrame({w: {v.name: v.probability for v in own} for w, own in found.items()})
    middle = found[1.0]
    none = _log_evidence(middle, "none")
    best = middle[0]
    share = float(np.abs(best.residual_n / case.estimate_n).max())
    rms = float(np.sqrt((best.residual_n**2).mean()))
    return Weighing(
        key,
        table.sort_values(1.0, ascending=False),
        {v.name: v.log_evidence - none for v in middle},
        {v.name: v.log_evidence_se for v in middle},
        {v.name: _sizes(v.parameters) for v in middle},
        f"After `{best.name}`: {_left(best)} N remain (estimate less posterior mean prediction; "
        f"RMS {rms:.3f} N, at most {100 * share:.1f} % of an estimate).",
        f"{summary_gain(case, middle, seed)}\n\n{_draws([*chain(*found.values())])}",
    )


def _log_evidence(verdicts: Sequence[SummaryVerdict], name: str) -> float:
    return next(v.log_evidence for v in verdicts if v.name == name)


def _left(verdict: SummaryVerdict) -> str:
    return ", ".join(f"{value:+.3f}" for value in verdict.residual_n)


def _draws(verdicts: Sequence[SummaryVerdict]) -> str:
    """How well the draws cover the posteriors of all hypotheses."""
    fewest = min(v.effective_draws for v in verdicts)
    worst = max(v.pareto_k for v in verdicts)
    text = (
        f"Draws of every hypothesis: at least {fewest:.0f} effective, Pareto k̂ {worst:.2f} or less."
    )
    doubt = untrusted(verdicts)
    return f"{text} **{doubt}**" if doubt else text


def summary_gain(
    case: PulseCase | BranchCase, verdicts: Sequence[SummaryVerdict], seed: int
) -> str:
    """What the most probable cause gains over ``none`` on estimates that were left out."""
    if len(case.estimate_n) < LEAST_EVENTS:
        return f"Held-out gain: not measurable (fewer than {LEAST_EVENTS} estimates)."
    causes: dict[str, SummaryCause] = {cause.name: cause for cause in case.causes()}
    named = next(v.name for v in verdicts if v.name not in ("none", "unknown"))
    scores = {
        name: leave_out(case.estimate_n, case.sd_n, causes[name], np.random.default_rng(seed))
        for name in ("none", named, "unknown")
    }
    base = scores.pop("none")
    texts = [
        gain_text(
            name,
            own.log_scores - base.log_scores,
            f"RMS residual {own.rmse_n:.3f} N against {base.rmse_n:.3f} N",
            own.rmse_n / base.rmse_n,
        )
        for name, own in scores.items()
    ]
    return f"Held out, each of {len(case.estimate_n)} estimates in turn: {'; '.join(texts)}."


def gain_text(name: str, differences: Array, residual: str, rmse_ratio: float) -> str:
    """Sum of log score differences with its standard error, in words."""
    total, error = summed(differences)
    verdict = gain_verdict(total, error, rmse_ratio)
    return (
        f"`{name}` {total:+.1f} ± {error:.1f} nats against `none` (sum of log scores, one standard "
        f"error), {residual}: {verdict}"
    )


def pair_table(case: BranchCase, seed: int) -> str:
    """The best two causes together at every width, beside the best single hypothesis."""
    rows, weighed = [], []
    for width in WIDTHS:
        rng = np.random.default_rng(seed)
        pairs = weigh_summaries(case.estimate_n, case.sd_n, case.pair_causes(width), rng)
        singles = weigh_summaries(case.estimate_n, case.sd_n, case.causes(width)[:2], rng)
        weighed += pairs
        best = pairs[0]
        prior = {cause.name: cause.prior_probability for cause in case.pair_causes(width)}
        gain = best.log_evidence - _log_evidence(singles, "none")
        beyond = best.log_evidence - _log_evidence(singles, "unknown")
        odds = beyond + float(np.log(prior[best.name] / UNKNOWN))
        rows.append(
            f"| {width:g} | `{best.name}` | {gain:+.1f} | {beyond:+.1f} | {odds:+.1f} | "
            f"{_sizes(best.parameters)} | {_left(best)} |"
        )
    lines = "\n".join(rows)
    return f"""Two causes together, the best of {len(weighed) // len(WIDTHS)} pairs at every width
(log Bayes factors and log posterior odds in nats; N are the estimates less the posterior mean
prediction):

| width | pair | against `none` | against `unknown` | odds against `unknown` | mean ± 1 sd | N |
| --- | --- | --- | --- | --- | --- | --- |
{lines}

{_draws(weighed)}"""


def _sizes(parameters: Mapping[str, tuple[float, float]]) -> str:
    """Posterior means and standard deviations of what is not fixed."""
    return "; ".join(
        f"{name} {mean:.4g} ± {sd:.2g}" for name, (mean, sd) in parameters.items() if sd > 0
    )


def weigh_flight(
    totals: Path, priors: Path, seed: int, say: Callable[[str], None] | None = None
) -> Weighing:
    """Causes of the flight biases at every width, by the machinery of ``diagnose``."""
    case = read_case([str(totals)], priors, "flight", say)
    catalogue = catalogue_of(case)
    found = diagnose(case, catalogue, np.random.default_rng(seed), say=say)
    record = found.record
    causes = record["causes"]
    table = pd.DataFrame(
        {
            0.5: {c["name"]: record["sensitivity"]["0.5"].get(c["name"], 0.0) for c in causes},
            1.0: {c["name"]: c["probability"] for c in causes},
            2.0: {c["name"]: record["sensitivity"]["2"].get(c["name"], 0.0) for c in causes},
        }
    )
    best = causes[0]
    remains = (
        "The baseline leaves nothing that a cause of the catalogue explains better."
        if best["name"] == "none"
        else f"`{best['name']}` gains {best['log_bayes_factor']:.1f} nats over the baseline."
    )
    return Weighing(
        "a",
        table.sort_values(1.0, ascending=False),
        {c["name"]: c["log_bayes_factor"] for c in causes},
        {c["name"]: float("nan") for c in causes},
        {c["name"]: _catalogue_sizes(c["parameters"]) for c in causes},
        remains,
        flight_gain(case, read_totals(str(totals), case.priors.spacecraft, "flight"), found, seed),
    )


def flight_gain(case: Case, rows: Sequence[TotalsEvent], found: Diagnosis, seed: int) -> str:
    """What the best cause and ``unknown`` gain over ``none`` on totals rows that were left out."""
    verdict = found.verdict
    if len(rows) < LEAST_EVENTS:
        return f"Held-out gain: not measurable (fewer than {LEAST_EVENTS} events)."
    unknown = next(weighed for weighed in verdict.weighed if weighed.name == "unknown")
    base, *scores = (
        held_out_totals(case, rows, verdict.catalogue, weighed, np.random.default_rng(seed))
        for weighed in (verdict.none, verdict.best_cause, unknown)
    )
    texts = [
        gain_text(
            name,
            own.log_scores - base.log_scores,
            f"RMS residual momentum {own.rmse_n_m_s:.3f} N m s against {base.rmse_n_m_s:.3f} N m s",
            own.rmse_n_m_s / base.rmse_n_m_s,
        )
        for name, own in zip((verdict.best_cause.name, "unknown"), scores, strict=True)
    ]
    return (
        f"Held out, each of {len(rows)} events in turn: {'; '.join(texts)}. Central 90 % intervals "
        f"of `none` hold {100 * base.coverage_90:.0f} % of the {3 * len(rows)} held-out components."
    )


def _catalogue_sizes(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    return "; ".join(f"{key} {p['mean']:.4g} ± {p['sd']:.2g}" for key, p in parameters.items())


def write_published_diagnosis(
    study: Study, totals: Path, priors: Path, say: Callable[[str], None] | None = None
) -> dict[str, str]:
    """Weigh all cases, write page, table and figures; returns the first cause of every case."""
    seed = study.seed
    weighings = [
        weigh_flight(totals, priors, seed, say),
        weigh_summary_case("b", flight_2004(), seed),
        weigh_summary_case("c", fsds(), seed),
    ]
    branch = weigh_summary_case("d", a_branch(), seed)
    pairs = pair_table(a_branch(), seed)
    weighings.append(replace(branch, details=f"{branch.details}\n\n{pairs}"))
    on_times = on_time_findings(totals, priors, seed, say)
    weighings.append(_on_time_weighing(on_times))
    figures = {
        f"-{weighing.key}": on_time_figure(
            on_times.probability, on_times.log_bayes_factor, on_times.points
        )
        if weighing.key == "e"
        else width_figure(weighing.probability)
        for weighing in weighings
    }
    table = pd.concat([_table(weighing) for weighing in weighings])
    title, body = "What published data say against their models", _body(weighings)
    study.publish(title, body, "studies.published_diagnosis", {"": table}, figures)
    return {weighing.key: weighing.first for weighing in weighings}


def _on_time_weighing(found: OnTimeFindings) -> Weighing:
    return Weighing(
        "e",
        found.probability,
        found.log_bayes_factor,
        found.log_evidence_se,
        found.sizes,
        found.remains,
        found.details,
    )


def _table(weighing: Weighing) -> pd.DataFrame:
    names = list(weighing.probability.index)
    return pd.DataFrame(
        {
            "case": weighing.key,
            "cause": names,
            **{
                f"probability_width_{width:g}": weighing.probability[width].to_numpy()
                for width in WIDTHS
            },
            "log_bayes_factor_nats": [weighing.log_bayes_factor[n] for n in names],
            "log_evidence_se_nats": [weighing.log_evidence_se[n] for n in names],
            "posterior_mean_and_sd": [weighing.sizes[n] for n in names],
        }
    )


def verdict_sentence(weighing: Weighing) -> str:
    """First cause, its probability, and whether it is the same at other widths."""
    table = weighing.probability
    firsts = {width: str(table[width].idxmax()) for width in WIDTHS}
    text = f"Most probable: `{weighing.first}` ({table[1.0].max():.2f})."
    others = {width: name for width, name in firsts.items() if name != weighing.first}
    if others:
        changed = " and ".join(f"`{name}` at width × {width:g}" for width, name in others.items())
        text += f" This depends on the prior width of the effects: {changed}."
    else:
        text += " The same at half and at double width."
    return text


def _section(weighing: Weighing) -> str:
    rows = "\n".join(
        f"| `{name}` | {row[0.5]:.3f} | {row[1.0]:.3f} | {row[2.0]:.3f} | "
        f"{weighing.log_bayes_factor[str(name)]:+.1f} | {weighing.sizes[str(name)]} |"
        for name, row in weighing.probability.head(7).iterrows()
    )
    return f"""## ({weighing.key}) {TITLES[weighing.key]}

{verdict_sentence(weighing)} {weighing.remains}

| cause | width × 0.5 | × 1 | × 2 | log Bayes factor (nats) | posterior mean ± 1 sd |
| --- | --- | --- | --- | --- | --- |
{rows}

{weighing.details}

![Causes of case ({weighing.key})]({NAME}-{weighing.key}.png)
"""


def _body(weighings: Sequence[Weighing]) -> str:
    sections = "\n".join(_section(weighing) for weighing in weighings)
    return f"""\
Posterior probability of every cause, `none` and `unknown` included, with the prior of each effect's
size half, once and twice as wide as the default. What the cases assume, and what their outcome
means, is in [What the simulation gets wrong](../criticism.md). Units stand in the names of the
parameters; `thrust_factor`, `scale` and `ratio` are fractions. All numbers:
[{NAME}.csv]({NAME}.csv).

{sections}"""
