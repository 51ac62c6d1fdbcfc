"""Blind trials over conditions, counted by level of every condition, and tested.

Where nothing is hidden: false alarms, p-values below 0.05, `unknown`. Where a clear cause is: how
often it, or one that the oracle cannot tell from it, is first, with and without the trials that the
package declined. A bound is tested on the side where it is missed, the share of p-values on both;
Holm's correction covers all tests of the levels, and, apart from them, those of all trials.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import binom, binomtest

from cassini_bayes.report.study_page import markdown_table
from cassini_bayes.results.ranks import holm
from cassini_bayes.studies.blind.rates import (
    Record,
    answered,
    declined,
    first,
    interval,
    named,
    named_by_oracle,
)
from cassini_bayes.studies.conditions import LEVELS

LEVEL: Final = 0.05
POOLED: Final = "all"
PARTS: Final = ("null", "clear")


@dataclass(frozen=True)
class Asked:
    """A rate of one part of a campaign: which trials count, what is a hit, what it has to be.

    ``side``: 1 where the rate may not be above its bound, -1 not below, 0 where it has to be it.
    """

    part: str
    counts: Callable[[Record], bool]
    hit: Callable[[Record], bool]
    bound: float
    side: int

    def p_value(self, hits: int, trials: int) -> float:
        """Probability of as many hits or more unlikely ones, if the rate is the bound."""
        if trials == 0:
            return 1.0
        if self.side == 0:
            return float(binomtest(hits, trials, self.bound).pvalue)
        above = float(binom.sf(hits - 1, trials, self.bound))
        return above if self.side > 0 else float(binom.cdf(hits, trials, self.bound))


def _asked(record: Record) -> bool:
    return not declined(record)


def _any(_: Record) -> bool:
    return True


RATES: Final[Mapping[str, Asked]] = {
    "null: false alarm": Asked("null", _asked, lambda r: not named(r), 0.05, 1),
    "null: unknown": Asked("null", answered, lambda r: first(r) == "unknown", 0.03, 1),
    "null: p < 0.05": Asked("null", answered, lambda r: float(r["p_value"]) < LEVEL, 0.05, 0),
    "clear: first": Asked("clear", _any, named_by_oracle, 0.95, -1),
    "clear: first, declined left out": Asked("clear", _asked, named_by_oracle, 0.95, -1),
}


def by_condition(records: Sequence[Record]) -> pd.DataFrame:
    """Every rate of all trials and of every level of every condition: counts, interval, tests.

    Columns: condition, level, rate, trials, declined, hits, value, low_95, high_95, goal, p,
    p_holm, rejected.
    """
    levels = [(POOLED, POOLED, list(records))] + [
        (name, level, [r for r in records if r["condition"].get(name, levels[0]) == level])
        for name, levels in LEVELS.items()  # records from before a condition have its first
        for level in levels
    ]
    rows = [
        {"condition": name, "level": level, "rate": rate, **_counted(asked, chosen)}
        for name, level, chosen in levels
        for rate, asked in RATES.items()
    ]
    table = pd.DataFrame(rows)
    pooled = table["condition"] == POOLED
    adjusted = np.ones(len(table))
    for family in (pooled, ~pooled):
        adjusted[family] = holm(table["p"][family].to_numpy())
    return table.assign(p_holm=adjusted, rejected=adjusted <= LEVEL)


def _counted(asked: Asked, records: Sequence[Record]) -> dict[str, float]:
    of_part = [r for r in records if r["stratum"] == asked.part]
    chosen = [r for r in of_part if asked.counts(r)]
    hits = sum(map(asked.hit, chosen))
    low, high = interval(hits, len(chosen))
    return {
        "trials": len(chosen),
        "declined": sum(map(declined, of_part)),
        "hits": hits,
        "value": hits / len(chosen) if chosen else float("nan"),
        "low_95": low,
        "high_95": high,
        "goal": asked.bound,
        "p": asked.p_value(hits, len(chosen)),
    }


def condition_lines(table: pd.DataFrame) -> str:
    """The same as a Markdown table, one line per level; what is rejected is bold."""
    of_null, of_clear = ([r for r, asked in RATES.items() if asked.part == p] for p in PARTS)
    head, lines = ("condition", "level", PARTS[0], *of_null, PARTS[1], *of_clear), []
    for (name, level), rows in table.groupby(["condition", "level"], sort=False):
        by_rate = rows.set_index("rate")
        cells = {rate: _cell(row) for rate, row in by_rate.iterrows()}
        null, clear = by_rate.loc[of_null[0]], by_rate.loc[of_clear[0]]
        lines.append(
            [
                name.replace("_", " "),
                level,
                f"{null['trials'] + null['declined']} ({null['declined']})",
                *(cells[rate] for rate in of_null),
                f"{clear['trials']} ({clear['declined']})",
                *(cells[rate] for rate in of_clear),
            ]
        )
    return markdown_table(head, lines)


def _cell(row: pd.Series) -> str:
    """Share with its interval, bold where it is rejected."""
    if row["trials"] == 0:
        return ""
    text = f"{row['value']:.2f} ({row['low_95']:.2f}…{row['high_95']:.2f})"
    return f"**{text}**" if row["rejected"] else text
