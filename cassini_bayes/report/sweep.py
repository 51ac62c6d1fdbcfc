"""The section on priors that a sweep adds to a run's report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pandas as pd

from cassini_bayes.files.storage import write_text
from cassini_bayes.report.cells import Cell, Table, flagged, signed, tabulate
from cassini_bayes.report.plots.quantities import MISSING
from cassini_bayes.report.templating import rendered, svg_address
from cassini_bayes.sampling.warmstart import TRUSTED_K
from cassini_bayes.sweep.scaling import EVENT, SENSITIVE
from cassini_bayes.sweep.tables import SweepTables
from cassini_bayes.sweep.weights import FEWEST_DRAWS, trusted_rows

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure

BEGIN: Final = "<!-- sweep of priors -->"
END: Final = "<!-- end of the sweep of priors -->"
_OF: Final = "\n<!-- of the fit {} -->\n"
_BEFORE: Final = '<section>\n<h2 id="provenance">'
_ENTRY: Final = '<li><a href="#sweep">How much the answer leans on its priors</a></li>\n'
_ENTRY_BEFORE: Final = '<li><a href="#provenance">'
STRONGEST: Final = 12
CANNOT_SAY: Final = "the draws cannot say"


def write_sweep_section(
    page: Path,
    tables: SweepTables,
    names: Sequence[str],
    figures: Mapping[str, Figure],
    facts: str,
    fit: str,
) -> None:
    """Put the section into a report, in place of an earlier sweep's, atomically.

    ``fit`` is the digest of the ``fit.nc`` that was swept.
    """
    html = page.read_text(encoding="utf-8")
    own = render_section(tables, names, figures, facts)
    write_text(page, with_section(html, f"{BEGIN}{_OF.format(fit)}{own}\n{END}\n"))


def section_in(html: str, fit: str) -> str:
    """The section that a report has of a sweep of the fit with this digest; else nothing."""
    own, ended, _ = html.partition(BEGIN)[2].partition(END)
    return f"{BEGIN}{own}{END}\n" if ended and own.startswith(_OF.format(fit)) else ""


def with_section(html: str, section: str) -> str:
    """The page with the section before its provenance, and an entry in its contents."""
    if BEGIN in html and END in html:
        head, rest = html.split(BEGIN, 1)
        html = head + rest.split(END, 1)[1].removeprefix("\n")
    place = _BEFORE if _BEFORE in html else "</main>"
    html = html.replace(place, section + place, 1)
    if _ENTRY not in html:
        html = html.replace(_ENTRY_BEFORE, _ENTRY + _ENTRY_BEFORE, 1)
    return html


def render_section(
    tables: SweepTables, names: Sequence[str], figures: Mapping[str, Figure], facts: str
) -> str:
    """The section as HTML; every text is escaped."""
    pictures = {name: svg_address(figure) for name, figure in figures.items()}
    return rendered(
        "sweep.html.jinja",
        facts=facts,
        pictures=pictures,
        quantities=[(i, name) for i, name in enumerate(names, start=1)],
        strongest=strongest_sentence(tables.sweep),
        changes=changes_table(tables.sweep),
        sentences=list(tables.conflict["sentence"]),
        conflicts=int((tables.conflict["verdict"] == "conflict").sum()),
        scaling=scaling_table(tables.scaling, names),
        sensitive=SENSITIVE,
        trusted_k=TRUSTED_K,
        fewest_draws=FEWEST_DRAWS,
        refits=int((cells_of(tables.sweep)["estimate"] != "reweighted").sum()),
    )


def cells_of(sweep: pd.DataFrame) -> pd.DataFrame:
    """One reported row of every cell: how it was answered is the same in all."""
    return sweep[sweep["reported"]].drop_duplicates(["group", "change"])


def strongest_sentence(sweep: pd.DataFrame) -> str:
    """The change of a prior that moves any quantity most, and of how many the draws cannot say."""
    shown = _changes(sweep)
    if shown.empty:
        return "No prior was changed."
    trusted = trusted_rows(shown) & shown["shift_sd"].notna()
    if not trusted.any():
        return (
            "The draws cannot say what any of the changed priors does: fit them anew "
            '(refit = "auto").'
        )
    row = shown.loc[shown["shift_sd"].where(trusted).abs().idxmax()]
    return (
        f"The change that moves an answer most is {row['group']}, {row['change']}: "
        f"{row['quantity']} moves by {_shift(row)} of its posterior standard deviation, which is "
        f"then {_width(row)} times as large.{_left_out(cells_of(shown))}"
    )


def _left_out(cells: pd.DataFrame) -> str:
    """A sentence, after a blank, about the cells whose weights cannot be trusted."""
    count = int((~trusted_rows(cells)).sum())
    if not count:
        return ""
    return (
        f" The draws cannot say what {count} of the {len(cells)} changes do; they are not ranked: "
        'fit them anew (refit = "auto").'
    )


def changes_table(sweep: pd.DataFrame) -> Table:
    """The cells that move some quantity most, one row each, with what they do to it.

    After them, without numbers, all those whose weights cannot be trusted.
    """
    shown = _changes(sweep)
    trusted = trusted_rows(shown)
    ranked = shown[trusted & shown["shift_sd"].notna()]
    strongest = ranked.loc[
        ranked.assign(size=ranked["shift_sd"].abs()).groupby(["group", "change"])["size"].idxmax()
    ]
    order = strongest["shift_sd"].abs().sort_values(ascending=False).index[:STRONGEST]
    numbers = ["shift_sd", "shift_error", "width_ratio", "width_error"]
    left_out = cells_of(shown[~trusted]).assign(
        quantity=CANNOT_SAY, **dict.fromkeys(numbers, math.nan)
    )
    return tabulate(
        pd.concat([strongest.loc[order], left_out]) if len(left_out) else strongest.loc[order],
        {
            "changed prior": lambda row: f"{row['group']}: {row['change']}",
            "quantity it moves most": _quantity,
            "shift of the mean [posterior sd]": _shift,
            "ratio of sd": _width,
            "estimate": "estimate",
            "Pareto k̂": lambda row: flagged(
                signed(row["pareto_k"], "z.2f"), row["pareto_k"] > TRUSTED_K
            ),
            "effective draws": lambda row: flagged(
                f"{row['effective_draws']:.0f}", row["effective_draws"] < FEWEST_DRAWS
            ),
        },
    )


def _changes(sweep: pd.DataFrame) -> pd.DataFrame:
    """The reported rows of changed priors, without those of events left out."""
    return sweep[sweep["reported"] & (sweep["kind"] != "without")]


def _quantity(row: pd.Series) -> Cell:
    return flagged(row["quantity"], row["quantity"] == CANNOT_SAY)


def _shift(row: pd.Series) -> str:
    if math.isnan(row["shift_sd"]):
        return MISSING
    return f"{signed(row['shift_sd'], '+.2f')} ± {row['shift_error']:.2f}"


def _width(row: pd.Series) -> str:
    if math.isnan(row["width_ratio"]):
        return MISSING
    return f"{row['width_ratio']:.2f} ± {row['width_error']:.2f}"


def scaling_table(scaling: pd.DataFrame, names: Sequence[str]) -> Table:
    """Largest power-scaling sensitivity of every block, and what it is of; events left out."""
    selected = scaling[~scaling["component"].str.startswith(EVENT)]
    parts = selected.groupby("component", sort=False)["sensitivity"]
    above = selected.groupby("component", sort=False)["sensitive"].sum()
    return tabulate(
        selected.loc[parts.idxmax()],
        {
            "prior block or likelihood": "component",
            "largest sensitivity": lambda row: flagged(
                f"{row['sensitivity']:.3f}", row["sensitive"]
            ),
            "of": "quantity",
            "quantities above the threshold": lambda row: (
                f"{int(above[row['component']])} of {len(names)}"
            ),
            "Pareto k̂": lambda row: _plain(row["pareto_k"]),
        },
    )


def _plain(value: float) -> str:
    """Two decimals without a sign on nothing."""
    return f"{value:z.2f}".replace("-", "−")
