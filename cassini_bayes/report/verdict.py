"""The answer of a fit in a few sentences: each number beside what was believed before the data."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.diagnosis.sizes import sizes_of
from cassini_bayes.effects.wording import Stated, by_keys
from cassini_bayes.report.cells import percent
from cassini_bayes.report.plots.quantities import number, plus_minus
from cassini_bayes.report.plots.tables import events_of, level_row, thrusters_of
from cassini_bayes.results.review import Review
from cassini_bayes.results.tables import hdi

NOT_CONVERGED: Final = "NOT CONVERGED: what follows is no result yet"
MOMENTS: Final = ("xx", "yy", "zz")
LEAST_NARROWING: Final = 0.005
STRAY: Final = 2.0  # times the median width: said apart
IMPULSE: Final = "impulse_per_on_time_n"


def verdict(review: Review) -> list[str]:
    """What was asked for with its uncertainty and its prior, and what is known well."""
    return [*_thrust(review), *_effects(review), *_moments(review), *_impulse(review)]


def counted(n: int, one: str, many: str = "") -> str:
    """``1 event``, ``8 events``."""
    return f"{n} {one if n == 1 else many or one + 's'}"


def kinds_of_events(review: Review) -> tuple[str, str]:
    """One event with thrusts, and several: totals rows are biases, telemetry may be a burn."""
    if not review.model.telemetry:
        return "wheel bias", "wheel biases"
    return "event with firings", "events with firings"


def narrowed(sd: float, prior_sd: float) -> str:
    """A posterior's width against its prior's, in words."""
    change = 1.0 - sd / prior_sd if prior_sd > 0 else 0.0
    if abs(change) < LEAST_NARROWING:
        return "as wide as the prior"
    return f"{percent(abs(change))} {'narrower' if change > 0 else 'wider'} than the prior"


def _thrust(review: Review) -> list[str]:
    if not events_of(review):
        return []
    row = review.summary[review.summary["quantity"] == "thrust_common_n"].iloc[0]
    mean, sd, prior_sd = float(row["mean"]), float(row["sd"]), float(row["prior_sd"])
    who = (
        f"level shared by {counted(len(thrusters_of(review)), 'thruster')} in "
        f"{counted(len(events_of(review)), *kinds_of_events(review))}"
    )
    if prior_sd == 0.0:
        return [f"Thrust {number(mean, float(level_row(review, 'sd').mean()))} N ({who}), fixed."]
    before = plus_minus(float(row["prior_mean"]), prior_sd)
    return [f"Thrust {plus_minus(mean, sd)} N ({who}), {narrowed(sd, prior_sd)}, {before} N."]


def _effects(review: Review) -> list[str]:
    """What the effects that were fitted by name came out as, in engineering units."""
    said = []
    for effect in review.model.effects:
        sizes = {}
        for key, draws in sizes_of(review.model, effect, review.z).items():
            low, high = (float(end) for end in hdi(draws))
            unit = next((p.unit for p in effect.parameters if p.key == key), "")
            sizes[key] = Stated(float(draws.mean()), float(draws.std(ddof=1)), low, high, unit)
        words = effect.kind.says
        text = by_keys(effect.name, sizes) if words is None else words(sizes, effect.target)
        said.append(f"With the effect {effect.name} in the model: {text}.")
    return said


def _moments(review: Review) -> list[str]:
    if not review.model.telemetry:
        return []
    rows = review.inertia.set_index("element").loc[list(MOMENTS)]
    after, before = (
        ", ".join(plus_minus(float(m), float(s)) for m, s in zip(rows[mean], rows[sd], strict=True))
        for mean, sd in (("mean_kg_m2", "sd_kg_m2"), ("prior_mean_kg_m2", "prior_sd_kg_m2"))
    )
    return [
        f"Moments of inertia about X, Y, Z: {after} kg m² (about the centre of mass, wheels "
        f"included as if not spinning); the priors were {before} kg m²."
    ]


def impulse_rows(review: Review) -> pd.DataFrame:
    """Impulse per commanded second of every thruster in every event that used it.

    The summary's rows with ``on_time`` [s] and ``relative`` and ``prior_relative`` widths.
    """
    rows = review.summary[review.summary["quantity"] == IMPULSE]
    if rows.empty:
        return rows.assign(on_time=[], relative=[], prior_relative=[])
    on_time = review.fit.groups["observed_data"]["on_time_s"].to_series().rename("on_time")
    rows = rows.merge(on_time, left_on=["event", "item"], right_index=True, how="left")
    rows = rows[(rows["on_time"] > 0) & (rows["sd"] > 0)]
    return rows.assign(
        relative=rows["sd"] / rows["mean"], prior_relative=rows["prior_sd"] / rows["prior_mean"]
    )


def _impulse(review: Review) -> list[str]:
    rows = impulse_rows(review)
    if rows.empty:
        return []
    stray = rows["relative"] > STRAY * rows["relative"].median()
    known, few = rows[~stray], rows[stray]
    rest = ""
    if len(few):
        rest = (
            f" but for {len(few)} of {len(rows)} ({_relative(few['relative'])}, on-time up to "
            f"{few['on_time'].max():.2g} s)"
        )
    return [
        "Known well is what a thruster delivers per second of commanded on-time, tail-off "
        f"included: {number(known['mean'].min(), known['sd'].min())} to "
        f"{number(known['mean'].max(), known['sd'].min())} N, to {_relative(known['relative'])} "
        f"in each {kinds_of_events(review)[0]}{rest}. The priors knew it to "
        f"{_relative(known['prior_relative'])}."
    ]


def _relative(shares: pd.Series) -> str:
    """The range of relative widths in percent."""
    low, high = (f"{100 * float(v):.2g}" for v in (np.nanmin(shares), np.nanmax(shares)))
    return f"{low}\N{NO-BREAK SPACE}%" if low == high else f"{low}–{high}\N{NO-BREAK SPACE}%"
