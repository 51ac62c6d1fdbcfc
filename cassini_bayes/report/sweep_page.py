"""A results page of a sweep for the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import pandas as pd

from cassini_bayes.report.cells import Table
from cassini_bayes.report.plots import Figure
from cassini_bayes.report.study_page import Made, markdown_table, write_page
from cassini_bayes.report.sweep import cells_of, changes_table, scaling_table, strongest_sentence
from cassini_bayes.sweep.tables import SweepTables

MODULE: Final = "sweep.plan"  # whose code works cells out
_SHOWN: Final = ("worth", "tornado_1", "overlay_1")


def write_sweep_page(
    page: Path,
    title: str,
    tables: SweepTables,
    names: Sequence[str],
    figures: Mapping[str, Figure],
    command: Sequence[str],
    seed: int,
) -> None:
    """Write a markdown page with the first quantity's figures beside it."""
    shown = {f"-{name}": figures[name] for name in _SHOWN if name in figures}
    body = _body(page.stem, tables, names, figures)
    write_page(page, title, body, Made(command, seed, MODULE), {"": tables.sweep}, shown)


def _body(
    stem: str, tables: SweepTables, names: Sequence[str], figures: Mapping[str, Figure]
) -> str:
    pictures = {
        name: f"![{name.replace('_', ' ')}]({stem}-{name}.png)" if name in figures else ""
        for name in _SHOWN
    }
    return f"""{strongest_sentence(tables.sweep)}

Shifts are in posterior standard deviations of the run, ± is one Monte Carlo standard error;
{_counts(tables.sweep)}. How it is done: [prior
sensitivity](../topics/prior-sensitivity.md). Every cell and quantity: [{stem}.csv]({stem}.csv).

{_markdown(changes_table(tables.sweep))}

{pictures["tornado_1"]}

{names[0]}: shift of the mean and ratio of standard deviations; filled symbols are weighted draws,
open ones new fits, grey crosses weighted draws that cannot say.

{pictures["overlay_1"]}

{names[0]}: density of the posterior (grey) and of those with changed priors; peaks above
four times the grey one are cut.

## Which knowledge to buy

{_knowledge_sentences(tables.knowledge)}

{pictures["worth"]}

{_evidence(tables, names)}"""


def _evidence(tables: SweepTables, names: Sequence[str]) -> str:
    """The caption of the worth of knowledge, and the sections on conflict and power scaling."""
    sentences = "\n".join(f"* {sentence}" for sentence in tables.conflict["sentence"])
    return f"""Above: expected change of each standard deviation if the parameters of a block were
known perfectly. Below: its change without an event, empty where the draws
cannot say.

## Do prior and data disagree?

Before fitting: from draws of the prior and what it predicts; after fitting: from the posterior (for
events the data have then been used twice, which makes it lenient).

{sentences}

## Power-scaling sensitivity

{_markdown(scaling_table(tables.scaling, names))}
"""


def _counts(sweep: pd.DataFrame) -> str:
    """How many cells were answered in which way."""
    per_cell = cells_of(sweep)
    counts = ", ".join(f"{n} {kind}" for kind, n in per_cell["estimate"].value_counts().items())
    return f"{len(per_cell)} cells: {counts}"


def _knowledge_sentences(knowledge: pd.DataFrame) -> str:
    """The block worth most for each quantity, those alike said together."""
    blocks = knowledge[(knowledge["level"] == "block") & (knowledge["width_ratio"] > 0.02)]
    best = blocks.loc[blocks.groupby("quantity", sort=False)["width_ratio"].idxmin()]
    lines = []
    for block, rows in best.groupby("block", sort=False):
        shrink = 100.0 * (1.0 - rows["width_ratio"])
        span = f"{shrink.min():.0f} %"
        if shrink.max() - shrink.min() >= 1.0:
            span = f"{shrink.min():.0f} to {shrink.max():.0f} %"
        quantities = ", ".join(f"`{name}`" for name in rows["quantity"])
        lines.append(f"* {block}: known perfectly, it would narrow {quantities} by {span}.")
    return "\n".join(lines)


def _markdown(table: Table) -> str:
    return markdown_table(table.columns, ((cell.text for cell in row) for row in table.rows))
