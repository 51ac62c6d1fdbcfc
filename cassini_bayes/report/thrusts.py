"""Thrusts in words, tables and figures: the main result, and the methods it replaces beside it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.report.cells import (
    MN,
    Cell,
    Column,
    Table,
    between,
    formatted,
    mean_sd,
    percent,
    tabulate,
)
from cassini_bayes.report.page import Card, Cards, Chapter, Drawing, Paragraph, Section, TableBlock
from cassini_bayes.report.plots.corners import joint_corner, thrust_corner
from cassini_bayes.report.plots.quantities import (
    INTERVAL,
    INTERVAL_SHORT,
    MISSING,
    interval,
    number,
    observed_name,
    plus_minus,
)
from cassini_bayes.report.plots.tables import (
    NOISE_ONLY,
    NOT_BLOCKS,
    SHARE,
    budget_blocks,
    events_of,
    level_row,
    thrust_grid,
    thrusters_of,
)
from cassini_bayes.report.plots.thrusts import thrust_figure
from cassini_bayes.report.verdict import impulse_rows
from cassini_bayes.results.baselines import MEAN, PER_EVENT, POOLED
from cassini_bayes.results.review import Review

MOST_HELPED: Final = 3
LEAST_WORTH: Final = 0.001


def thrusts(review: Review) -> Iterator[Section]:
    """Every thruster in every event, beside the methods it replaces, whose table this keeps."""
    if not events_of(review):
        return
    methods = (
        " Black symbols: the least-squares methods this replaces, with the root sum square of "
        "their hand-picked perturbations; hollow where the thruster fired for less than 5 s. "
        "Estimates beyond the axes stand at the edge with their value. Totals give the "
        "pseudo-inverse three equations per event for more thrusters than that: its answer is then "
        "the one of least norm."
    )
    caption = (
        f"Coloured bars: {INTERVAL} of the posterior, white symbol: its mean. Grey band: "
        f"{INTERVAL} of the prior. Dashed line: thrust printed with the event."
        f"{'' if review.baseline.empty else methods} Last column: the thruster's level over all "
        "events, beside the pseudo-inverse of all events together."
    )
    alt = (
        "Posterior thrust of every thruster in every bias with prior, least-squares estimates and "
        "printed thrust"
    )
    drawing = Drawing("thrusts", alt, caption, partial(thrust_figure, review))
    yield Section(Chapter.THRUSTS, (drawing,), name="baseline", frame=review.baseline)


def thrust_numbers(review: Review) -> Iterator[Section]:
    """Thrusts as numbers, all together and event by event."""
    if not events_of(review):
        return
    bars = (
        " Bars of the replaced methods: root sum square of the shifts from hand-picked "
        "perturbations; in brackets the sum of their absolute values. † on-time below 5 s: not "
        "valid by the papers' own rule."
    )
    if review.baseline.empty:
        bars = " No estimates by the replaced methods are part of this run."
    yield Section(
        Chapter.NUMBERS,
        (
            Paragraph(
                "Each card: thrust of every thruster, and its impulse per second of commanded "
                "on-time. “Prior” is the share of the posterior's precision that the prior brought "
                "along, (posterior sd / prior sd)²: at 100 % the data said nothing. What an event "
                "is worth is how much wider an interval would be without it, linearised at the "
                f"prior means.{bars}"
            ),
            Cards(thrust_cards(review)),
            TableBlock(
                thrust_matrix(review),
                style="total dense",
                fold="All thrusts in one table (mean ± sd in newton; last row the thruster's level "
                "over all events)",
            ),
        ),
        name="worth",
        frame=review.worth,
    )


def joint(review: Review) -> Iterator[Section]:
    """The quantities most tied to one another, and all thrust levels, in corner plots."""
    corners = (
        "Filled: posterior, contours hold 39 % and 86 % of the draws (1 and 2 standard "
        "deviations of a two-dimensional normal). Dashed: prior, same contours; where the prior "
        "is far wider than the posterior they run outside the view. Above each column: mean ± "
        "standard deviation; r: correlation where it is 0.2 or more."
    )
    drawings = [
        Drawing(
            "corner_joint",
            "Corner plot of the quantities that are most correlated, with priors",
            corners,
            partial(joint_corner, review),
            portrait=True,
        )
    ]
    text = "The quantities that the data tie to one another most."
    if events_of(review):
        text += (
            " Thrust and tail-off time enter the momentum balance almost as one product: a longer "
            "tail-off with less thrust explains the same data. A tilted ellipse shows how much of "
            "an uncertainty is such a trade."
        )
        drawings.append(
            Drawing(
                "corner_thrusts",
                "Corner plot of the thrust levels and the tail-off time with priors",
                "As above, for all thrust levels.",
                partial(thrust_corner, review),
                portrait=True,
                fold="Corner plot of all thrust levels",
            )
        )
    yield Section(Chapter.JOINT, (Paragraph(text), *drawings))


def _common(review: Review) -> pd.Series:
    rows = review.summary[review.summary["quantity"] == "thrust_common_n"]
    return rows.iloc[0]


def summary_sentences(review: Review) -> list[str]:
    """Beside the verdict: interval, spread, what limits it, and the printed thrust.

    Nothing without thrusts.
    """
    if not events_of(review):
        return []
    common, thrusters = _common(review), thrusters_of(review)
    level, sd = level_row(review, "mean"), thrust_grid(review, "sd") * MN
    lowest, highest = int(np.nanargmin(level)), int(np.nanargmax(level))
    sentences = [
        f"The {INTERVAL} of the thrusters' common level is "
        f"{interval(common['hdi_90_low'], common['hdi_90_high'])} N (± in this page is a standard "
        "deviation)."
    ]
    if len(thrusters) > 1:
        sentences.append(
            f"The thrusters' own levels run from {number(level[lowest], common['sd'])} N "
            f"({thrusters[lowest]}) to {number(level[highest], common['sd'])} N "
            f"({thrusters[highest]})."
        )
    sentences.append(
        "The thrust of one thruster in one bias is known to "
        f"{_span(sd, ' mN')} (standard deviation)."
    )
    return [*sentences, *_limit_sentence(review), *_printed_sentence(review, common)]


def _span(values: np.ndarray, unit: str, to: str = " to ") -> str:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    first, last = number(low, low), number(high, high)
    return f"{first}{unit}" if first == last else f"{first}{to}{last}{unit}"


def _limit_sentence(review: Review) -> list[str]:
    """Which block carries most of the variance."""
    blocks = [b for b in budget_blocks(review.budget) if b not in NOT_BLOCKS]
    shares = {b: float(np.nanmean(review.budget[b + SHARE])) for b in blocks}
    noise = float(np.nanmean(review.budget[NOISE_ONLY + SHARE]))
    if not shares:
        return []
    worst = max(shares, key=lambda b: shares[b])
    return [
        f"Of the nuisances, {worst} limits the accuracy most: {percent(shares[worst])} of the "
        f"variance of a thrust, on average; {percent(noise)} would be left if all nuisances were "
        "known."
    ]


def _printed_sentence(review: Review, common: pd.Series) -> list[str]:
    constants = review.fit.groups["constant_data"]
    if "thrust_predicted_n" not in constants:
        return []
    printed = np.asarray(constants["thrust_predicted_n"].values, dtype=float)
    printed = printed[np.isfinite(printed)]
    if printed.size == 0 or common["sd"] == 0.0:  # a fixed level lies nowhere by itself
        return []
    shift = (float(common["mean"]) - float(printed.mean())) / float(common["sd"])
    low, high = f"{printed.min():.2f}", f"{printed.max():.2f}"
    span = low if low == high else f"{low} to {high}"
    return [
        f"The thrust printed with the events is {span} N; the "
        f"common level lies {abs(shift):.1f} of its standard deviations "
        f"{'above' if shift > 0 else 'below'} its mean."
    ]


def key_numbers(review: Review) -> list[tuple[str, str]]:
    """The few numbers that everyone asks for, with their names."""
    varying = review.summary[review.summary["sd"] > 0]
    smallest = np.nanmin(varying[["ess_bulk", "ess_tail"]].to_numpy(dtype=float))
    return [
        *_thrust_numbers(review),
        ("largest R-hat", f"{np.nanmax(varying['rhat'].to_numpy(dtype=float)):.4f}"),
        ("smallest effective sample", f"{smallest:.0f}"),
    ]


def _thrust_numbers(review: Review) -> list[tuple[str, str]]:
    if not events_of(review):
        return []
    common = _common(review)
    return [
        ("common thrust level", f"{plus_minus(common['mean'], common['sd'])} N"),
        (f"its {INTERVAL_SHORT}", f"{interval(common['hdi_90_low'], common['hdi_90_high'])} N"),
        ("one thruster, one bias: sd", _span(thrust_grid(review, "sd") * MN, " mN")),
    ]


def thrust_matrix(review: Review) -> Table:
    """Events × thrusters, mean ± sd; last row the level over all events."""
    mean, sd = (
        np.vstack([thrust_grid(review, column), level_row(review, column)])
        for column in ("mean", "sd")
    )
    rows = tuple(
        (Cell(name), *(Cell(plus_minus(m, s)) for m, s in zip(mean[i], sd[i], strict=True)))
        for i, name in enumerate([*events_of(review), "all events"])
    )
    return Table(("event", *(f"{t} [N]" for t in thrusters_of(review))), rows)


def thrust_cards(review: Review) -> tuple[Card, ...]:
    """A card of every event, posterior beside baseline; last the level over all events."""
    table = review.summary
    baseline = {
        (row["method"], row["event"], row["thruster"]): row for _, row in review.baseline.iterrows()
    }

    def beside(method: str, event: str) -> Column:
        return lambda row: _baseline_cell(baseline.get((method, event, row["item"])))

    known: dict[str, Column] = {f"{INTERVAL_SHORT} [N]": between(), "prior": _prior_share()}
    bars = "± rss (worst case) [N]"
    observed = review.fit.groups["observed_data"]
    thrusts = table[table["quantity"] == "thrust_n"]
    levels = table[table["quantity"] == "thrust_level_n"]
    impulses = impulse_rows(review)
    delivered: dict[str, Column] = {}
    if len(impulses):
        delivered = {
            "impulse per commanded second, mean ± sd [N]": mean_sd("mean_impulse", "sd_impulse"),
            f"its {INTERVAL_SHORT} [N]": between("hdi_90_low_impulse", "hdi_90_high_impulse"),
            "its prior": _prior_share("sd_impulse", "prior_sd_impulse"),
        }
    cards = []
    for event in events_of(review):
        impulse = impulses[impulses["event"] == event]
        selected = thrusts[thrusts["event"] == event]
        rows = selected.assign(
            on_time=observed["on_time_s"].sel(event=event).values,
            pulses=observed["pulses"].sel(event=event).values,
        )
        if len(impulses):
            rows = rows.merge(impulse, on="item", how="left", suffixes=("", "_impulse"))
        columns: dict[str, Column] = {
            "thruster": "item",
            "on-time [s]": formatted("on_time", ".2f"),
            "pulses": formatted("pulses", ".0f"),
            "thrust, mean ± sd [N]": mean_sd(),
            **known,
            **delivered,
            f"pseudo-inverse {bars}": beside(PER_EVENT, event),
            f"mean of all thrusters {bars}": beside(MEAN, event),
        }
        shown = tabulate(rows, columns, title=event)
        cards.append(
            Card(event, _card_line(selected, impulse), shown, _worth_sentence(review, event))
        )
    columns = {
        "thruster": "item",
        "level, mean ± sd [N]": mean_sd(),
        **known,
        f"pseudo-inverse of all events {bars}": beside(POOLED, ""),
    }
    over_all = tabulate(levels, columns, title="all events")
    return (*cards, Card("all events", _card_line(levels, impulses.iloc[:0]), over_all))


def _prior_share(sd: str = "sd", prior_sd: str = "prior_sd") -> Column:
    """Share of the posterior's precision that the prior brought along, exact for normal ones."""

    def share(row: pd.Series) -> str:
        before = float(row[prior_sd])
        return percent(min(1.0, (float(row[sd]) / before) ** 2)) if before > 0 else MISSING

    return share


def _card_line(thrusts: pd.DataFrame, impulses: pd.DataFrame) -> str:
    """A card in a line: how narrow thrust and impulse are."""
    line = f"thrust ± {_span(thrusts['sd'].to_numpy(dtype=float) * MN, ' mN', '–')}"
    if impulses.empty:
        return line
    relative = 100.0 * impulses["relative"].to_numpy(dtype=float)
    return f"{line}, impulse ± {_span(relative, ' %', '–')}"


def _worth_sentence(review: Review, event: str) -> str:
    """What intervals of shared quantities would lose without the event."""
    rows = review.worth[review.worth["event"] == event]
    levels = rows[rows["quantity"].str.startswith("thrust[")]
    best = rows.sort_values("narrowing", ascending=False).head(MOST_HELPED)
    best = best[best["narrowing"] >= LEAST_WORTH]
    if best.empty:
        return "Without it no interval of a shared quantity would be 0.1 % wider."
    said = ", ".join(
        f"{observed_name(str(row['quantity']))} {_wider(float(row['narrowing']))}"
        for _, row in best.iterrows()
    )
    mean = ""
    if len(levels):
        mean = f" Thrust levels, on average: {_wider(float(levels['narrowing'].mean()))}."
    return f"Without it these would be wider by: {said}.{mean}"


def _wider(narrowing: float) -> str:
    return f"{100.0 * narrowing / (1.0 - narrowing):.1f} %"


def _baseline_cell(row: pd.Series | None) -> Cell:
    """Estimate with its perturbation bars; greyed, with a dagger, where not valid."""
    if row is None or not math.isfinite(float(row["estimate_n"])):
        return Cell(MISSING, "muted")
    estimate, bar, worst = (float(row[c]) for c in ("estimate_n", "bar_rss_n", "bar_worst_n"))
    text = plus_minus(estimate, bar)
    if math.isfinite(bar) and math.isfinite(worst):
        text += f" ({number(worst, bar)})"
    return Cell(text) if row["valid"] else Cell(f"{text} †", "muted")
