"""Diagnosis of published data: the flight wheel biases and printed thrusts, as a page with figures.

(a) the eight flight biases as totals rows; (b) five thrusts of paper 000 Table 2; (c) the test-bed
case of paper 000; (d) thrusts of the A branch, paper 003 Table 1. Every case is weighed at half,
once and twice the default width of its effects' priors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from cassini_bayes import __version__
from cassini_bayes.criticism.cases import BranchCase, PulseCase, a_branch, flight_2004, fsds
from cassini_bayes.criticism.diagnosis import catalogue_of, diagnose
from cassini_bayes.criticism.read import read_case
from cassini_bayes.criticism.summaries import SummaryVerdict, weigh_summaries
from cassini_bayes.plots import encode
from cassini_bayes.plots.criticism import width_figure
from cassini_bayes.storage import write_bytes, write_text

WIDTHS: Final = (0.5, 1.0, 2.0)
NAME: Final = "diagnosis-published"
TITLES: Final[Mapping[str, str]] = {
    "a": "Eight flight wheel biases (paper 001, Tables 3.a-3.h)",
    "b": "Five flight biases of 2004 (paper 000, Table 2)",
    "c": "Test-bed case (paper 000)",
    "d": "A-branch thrusts (paper 003, Table 1)",
}
UNSURE_NATS: Final = 0.3
NOT_MEASURABLE: Final = (
    "Held-out gain: not measurable (summary estimates, no telemetry to predict)."
)


@dataclass(frozen=True)
class Weighing:
    """One case: probabilities by width and cause, and the causes' sizes at default width."""

    key: str
    probability: pd.DataFrame  # index cause, columns WIDTHS
    log_bayes_factor: Mapping[str, float]
    log_evidence_se: Mapping[str, float]
    sizes: Mapping[str, str]
    remains: str

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
    none = next(v.log_evidence for v in middle if v.name == "none")
    best = middle[0]
    left = ", ".join(f"{value:+.3f}" for value in best.residual_n)
    rms = float(np.sqrt((best.residual_n**2).mean()))
    share = float(np.abs(best.residual_n / case.estimate_n).max())
    return Weighing(
        key,
        table.sort_values(1.0, ascending=False),
        {v.name: v.log_evidence - none for v in middle},
        {v.name: v.log_evidence_se for v in middle},
        {v.name: _sizes(v.parameters) for v in middle},
        f"After `{best.name}`: {left} N remain (estimate less posterior mean prediction; RMS "
        f"{rms:.3f} N, at most {100 * share:.1f} % of an estimate). {NOT_MEASURABLE}",
    )


def pair_sentence(case: BranchCase, single: Weighing, seed: int, draws: int = 200_000) -> str:
    """What the best two causes together gain over the first alone, prior probability included."""
    rng = np.random.default_rng(seed)
    pairs = weigh_summaries(case.estimate_n, case.sd_n, case.pair_causes(), rng, draws)
    best = pairs[0]
    none = case.causes()[:1]
    base = weigh_summaries(case.estimate_n, case.sd_n, none, rng, draws)[0].log_evidence
    gain = best.log_evidence - base
    left = ", ".join(f"{value:+.3f}" for value in best.residual_n)
    return (
        f"Two causes together: the best is `{best.name}`, {gain:+.1f} ± "
        f"{best.log_evidence_se:.1f} nats against `none` "
        f"({gain - single.log_bayes_factor[single.first]:+.1f} against `{single.first}`): "
        f"{_sizes(best.parameters)}. It leaves {left} N."
    )


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
    record = diagnose(case, catalogue_of(case), np.random.default_rng(seed), say=say).record
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
        f"{remains} Held-out gain: not measurable (leaving out is built for telemetry events).",
    )


def _catalogue_sizes(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    return "; ".join(f"{key} {p['mean']:.4g} ± {p['sd']:.2g}" for key, p in parameters.items())


def write_published_diagnosis(
    folder: Path,
    totals: Path,
    priors: Path,
    seed: int,
    command: Sequence[str],
    say: Callable[[str], None] | None = None,
) -> dict[str, str]:
    """Weigh all cases, write page, table and figures; returns the first cause of every case."""
    weighings = [
        weigh_flight(totals, priors, seed, say),
        weigh_summary_case("b", flight_2004(), seed),
        weigh_summary_case("c", fsds(), seed),
    ]
    branch = weigh_summary_case("d", a_branch(), seed)
    pairs = pair_sentence(a_branch(), branch, seed)
    weighings.append(replace(branch, remains=f"{branch.remains} {pairs}"))
    frame = pd.concat([_table(weighing) for weighing in weighings])
    write_text(folder / f"{NAME}.csv", frame.to_csv(index=False))
    for weighing in weighings:
        picture = width_figure(weighing.probability)
        write_bytes(folder / f"{NAME}-{weighing.key}.png", encode(picture, "png"))
    write_text(folder / f"{NAME}.md", _page(weighings, seed, command))
    return {weighing.key: weighing.first for weighing in weighings}


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
    """First cause, its probability, whether it is the same at other widths, and how sure."""
    table = weighing.probability
    firsts = {width: str(table[width].idxmax()) for width in WIDTHS}
    text = f"Most probable: `{weighing.first}` ({table[1.0].max():.2f})."
    others = {width: name for width, name in firsts.items() if name != weighing.first}
    if others:
        changed = " and ".join(f"`{name}` at width × {width:g}" for width, name in others.items())
        text += f" This depends on the prior width of the effects: {changed}."
    else:
        text += " The same at half and at double width."
    near = [n for n in table.index[:6] if weighing.log_evidence_se[n] > UNSURE_NATS]
    if near:
        named = ", ".join(f"`{n}`" for n in near)
        text += f" The evidence of {named} is uncertain by more than {UNSURE_NATS:g} nats."
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

![Probability of causes at three prior widths]({NAME}-{weighing.key}.png)
"""


def _page(weighings: Sequence[Weighing], seed: int, command: Sequence[str]) -> str:
    sections = "\n".join(_section(weighing) for weighing in weighings)
    return f"""# What published data say against their models

Posterior probability of every cause, `none` and `unknown` included, with the prior of each effect's
size half, once and twice as wide as the default. What the cases assume, and what their outcome
means, is in [What the simulation gets wrong](../criticism.md). Units stand in the names of the
parameters; `thrust_factor`, `scale` and `ratio` are fractions. Made by
`{" ".join(command)}` (seed {seed}) with cassini_bayes {__version__}; all numbers:
[{NAME}.csv]({NAME}.csv).

{sections}"""
