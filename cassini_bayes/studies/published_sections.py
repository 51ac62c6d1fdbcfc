"""One published case as a section of the page: its table of causes, and sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import pandas as pd

from cassini_bayes.diagnosis.case import Size
from cassini_bayes.diagnosis.score import HeldOut
from cassini_bayes.diagnosis.verdict import Verdict
from cassini_bayes.report.plots import Figure
from cassini_bayes.report.plots.criticism import width_figure

WIDTHS: Final = (0.5, 1.0, 2.0)
TITLES: Final[Mapping[str, str]] = {
    "a": "Eight flight wheel biases (paper 001, Tables 3.a-3.h)",
    "b": "Five flight biases of 2005 (paper 000, Table 2)",
    "c": "Test-bed case (paper 000)",
    "d": "A-branch thrusts (paper 003, Table 1)",
    "e": "On-times of the eight flight biases, predicted by the ideal calculation of paper 001",
}


@dataclass(frozen=True)
class Section:
    """One case: its verdict, probabilities by width and cause, and the causes' sizes in words.

    ``remains`` are sentences about what is left, ``details`` paragraphs and tables after the table
    of causes.
    """

    key: str
    verdict: Verdict[Any]
    probability: pd.DataFrame  # index cause, columns WIDTHS
    sizes: Mapping[str, str]
    remains: str
    details: str = ""
    picture: Figure | None = None

    @property
    def first(self) -> str:
        """The most probable cause at default width."""
        return self.verdict.best.name

    @property
    def figure(self) -> Figure:
        """The case's own picture, or probabilities by width."""
        return self.picture or width_figure(self.probability)

    @property
    def log_bayes_factor(self) -> dict[str, float]:
        """Of every hypothesis against ``none``, nats."""
        return {w.name: self.verdict.log_bayes_factor(w) for w in self.verdict.weighed}

    def table(self) -> pd.DataFrame:
        """All numbers of the case."""
        names, factors = [str(name) for name in self.probability.index], self.log_bayes_factor
        return pd.DataFrame(
            {
                "case": self.key,
                "cause": names,
                **{f"probability_width_{w:g}": self.probability[w].to_numpy() for w in WIDTHS},
                "log_bayes_factor_nats": [factors[name] for name in names],
                "log_evidence_se_nats": [
                    self.verdict.named(name).log_evidence_se for name in names
                ],
                "posterior_mean_and_sd": [self.sizes[name] for name in names],
            }
        )

    def text(self, picture: str, most: int = 7) -> str:
        """The section in Markdown, its picture at an address; the most probable causes."""
        factors = self.log_bayes_factor
        rows = "\n".join(
            f"| `{name}` | {row[0.5]:.3f} | {row[1.0]:.3f} | {row[2.0]:.3f} | "
            f"{factors[str(name)]:+.1f} | {self.sizes[str(name)]} |"
            for name, row in self.probability.head(most).iterrows()
        )
        return f"""## ({self.key}) {TITLES[self.key]}

{self.verdict_sentence()} {self.remains}

| cause | width × 0.5 | × 1 | × 2 | log Bayes factor (nats) | posterior mean ± 1 sd |
| --- | --- | --- | --- | --- | --- |
{rows}

{self.details}

![Causes of case ({self.key})]({picture})
"""

    def verdict_sentence(self) -> str:
        """First cause, its probability, and whether it is the same at other widths."""
        firsts = {width: str(self.probability[width].idxmax()) for width in WIDTHS}
        text = f"Most probable: `{self.first}` ({self.probability[1.0].max():.2f})."
        others = {width: name for width, name in firsts.items() if name != self.first}
        if not others:
            return text + " The same at half and at double width."
        changed = " and ".join(f"`{name}` at width × {width:g}" for width, name in others.items())
        return text + f" This depends on the prior width of the effects: {changed}."


def by_width(verdict: Verdict[Any], widths: Mapping[float, Mapping[str, float]]) -> pd.DataFrame:
    """Probabilities by cause (rows, most probable first) and width of the effects' priors."""
    shares = {**widths, 1.0: verdict.probabilities}
    table = pd.DataFrame({width: dict(shares[width]) for width in WIDTHS})
    evidence = {w.name: w.log_evidence for w in verdict.weighed}
    order = sorted(table.index, key=lambda name: (-table.loc[name, 1.0], -evidence[str(name)]))
    return table.loc[order]


def in_words(sizes: Mapping[str, Size], form: str = ".4g") -> str:
    """Posterior means and standard deviations."""
    return "; ".join(f"{key} {s.mean:{form}} ± {s.sd:.2g}" for key, s in sizes.items())


def gain_table(what: str, unit: str, none: HeldOut, scores: Mapping[str, HeldOut]) -> str:
    """What causes gain over ``none`` on data left out: sums of log scores, residuals in a unit."""
    rows = [f"| `none` | – | {none.rmse:.3f} | – |"]
    for name, score in scores.items():
        gain = score.gain_over(none)
        nats = f"{gain.nats:+.1f} ± {gain.standard_error:.1f}"
        rows.append(f"| `{name}` | {nats} | {score.rmse:.3f} | {gain.verdict} |")
    lines = "\n".join(rows)
    return f"""Held out: {what} in turn. Log scores are summed, ± one standard error.

| model | log score against `none` (nats) | RMS residual ({unit}) | gain |
| --- | --- | --- | --- |
{lines}"""
