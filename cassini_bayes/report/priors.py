"""Had the priors been wider or narrower: intervals that follow a slider, worked out beforehand."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report.page import Chapter, Paragraph, Section, Slider, SliderPrior, SliderRow
from cassini_bayes.report.plots.quantities import display_scale, plus_minus
from cassini_bayes.report.plots.tables import (
    Column,
    both_draws,
    common_column,
    flat_draws,
    level_columns,
    thrusters_of,
)
from cassini_bayes.report.verdict import IMPULSE, MOMENTS
from cassini_bayes.results.review import Review
from cassini_bayes.sampling.warmstart import TRUSTED_K
from cassini_bayes.spacecraft.parameters import EFFECT_BLOCK, THRUST_COMMON
from cassini_bayes.sweep.variations import Group
from cassini_bayes.sweep.weights import FEWEST_DRAWS
from cassini_bayes.sweep.widths import WIDTHS, WidthEffect, width_effects

LEAST_EFFECT: Final = 0.03  # posterior standard deviations: a prior that moves less is not offered
COMMON_GROUP: Final = "common thrust"
NOT_OFFERED: Final = ("noise", EFFECT_BLOCK)
FRACTIONS: Final[Mapping[float, str]] = {0.25: "¼", 0.5: "½", 1.0: "1", 2.0: "2", 4.0: "4"}


def prior_slider(review: Review) -> Iterator[Section]:
    """Intervals of thrusts (and moments of inertia) under wider and narrower priors."""
    columns = asked_for(review)
    if not (columns and len(review.z)):
        return
    values = np.stack([column.posterior for column in columns], axis=-1)
    result = width_effects(
        review.priors, groups_of(review), parameter_draws(review), values, LEAST_EFFECT
    )
    # of few draws no weights are trusted, not even those of the prior as it was
    told = [effect for effect in result if effect.trusted.any()]
    effects = sorted(told, key=lambda effect: -effect.size)
    if not effects:
        return
    yield Section(
        Chapter.PRIORS,
        (
            Paragraph(
                "Choose a prior and make it narrower or wider: the intervals are those of the fit "
                "with that prior instead, from weighting its draws. One prior at a time; the rest "
                "stays as it was. A prior that matters to none of these numbers is not listed. "
                "“Impulse” is that per commanded second, all thrusters and events taken together. "
                "Intervals are central 90 % ones."
            ),
            slider_of(review, columns, effects),
        ),
        name="prior_widths",
        frame=width_table(columns, effects),
    )


def asked_for(review: Review) -> list[Column]:
    """What the slider moves: thrust levels, impulse, moments of inertia, as far as there are."""
    common = common_column(review)
    columns = [common, *level_columns(review)] if common and thrusters_of(review) else []
    posterior = review.fit.posterior
    if IMPULSE in posterior:
        after, before = (np.nanmean(draws, axis=(1, 2)) for draws in both_draws(review, IMPULSE))
        columns.append(Column("impulse per second, mean", "N", after, before))
    for name in (f"inertia_{moment}_kg_m2" for moment in MOMENTS):
        if review.model.telemetry and name in posterior:
            label = name.removesuffix("_kg_m2")
            columns.append(Column(label, "kg m²", *both_draws(review, name)))
    return [column for column in columns if np.ptp(column.posterior) > 0]


def groups_of(review: Review) -> tuple[Group, ...]:
    """The common thrust, if any, and every block of walked parameters with a prior of its own."""
    space, known, earlier = review.model.space, review.priors.parameters, review.priors.earlier
    of_a_fit = () if earlier is None else earlier.names
    common = known.get(THRUST_COMMON)
    groups = []
    drawn = THRUST_COMMON in review.fit.posterior  # not where nothing fires
    if drawn and common is not None and common.distribution is not None and earlier is None:
        groups.append(Group(COMMON_GROUP, (THRUST_COMMON,)))
    members: dict[str, list[str]] = {}
    for name, block in zip(space.names, space.blocks, strict=True):
        own = name in known and name not in of_a_fit and name != THRUST_COMMON
        if own and block not in NOT_OFFERED:
            members.setdefault(block, []).append(name)
    return (*groups, *(Group(block, tuple(names)) for block, names in members.items()))


def parameter_draws(review: Review) -> dict[str, Array]:
    """Draws (n,) of every walked parameter and of the common thrust."""
    walked = review.model.space.to_parameters(review.z)
    draws = {name: np.asarray(walked[name]) for name in review.model.space.names}
    if THRUST_COMMON in review.fit.posterior:
        draws[THRUST_COMMON] = flat_draws(review.fit.posterior, THRUST_COMMON)
    return draws


def slider_of(review: Review, columns: Sequence[Column], effects: Sequence[WidthEffect]) -> Slider:
    """Everything that the slider can show, as text and as places on each row's axis."""
    axes = _axes(columns, effects)
    return Slider(
        quantities=tuple(column.label for column in columns),
        units=tuple(column.unit for column in columns),
        widths=tuple(width_label(width) for width in WIDTHS),
        start=WIDTHS.index(1.0),
        priors=tuple(
            SliderPrior(
                name=effect.group.name,
                notes=tuple(_note(review, effect, i) for i in range(len(WIDTHS))),
                trusted=tuple(bool(line) for line in effect.trusted),
                rows=tuple(
                    tuple(
                        _row(effect, i, j, axes[j]) if effect.trusted[i] else None
                        for j in range(len(columns))
                    )
                    for i in range(len(WIDTHS))
                ),
            )
            for effect in effects
        ),
    )


def width_label(width: float) -> str:
    """``¼``, ``0.35``, … ``4``."""
    return FRACTIONS.get(width, f"{width:.2g}")


def _axes(columns: Sequence[Column], effects: Sequence[WidthEffect]) -> list[tuple[float, float]]:
    """The ends of every quantity's axis: one for all in newton, each its own otherwise."""
    low = np.min([np.nanmin(e.low[e.trusted], axis=0) for e in effects], axis=0)
    high = np.max([np.nanmax(e.high[e.trusted], axis=0) for e in effects], axis=0)
    newton = np.array([column.unit == "N" for column in columns])
    low = np.where(newton, low[newton].min(initial=np.inf), low)
    high = np.where(newton, high[newton].max(initial=-np.inf), high)
    return [(float(a), float(b)) for a, b in zip(low, high, strict=True)]


def _row(effect: WidthEffect, i: int, j: int, axis: tuple[float, float]) -> SliderRow:
    mean, sd, low, high = (
        float(v[i, j]) for v in (effect.mean, effect.sd, effect.low, effect.high)
    )
    return SliderRow.of(mean, sd, (low, high), axis)


def _note(review: Review, effect: WidthEffect, i: int) -> str:
    """What the prior then is, and how far the weights can be trusted."""
    k = float(effect.pareto_k[i])
    if not effect.trusted[i]:
        if np.isinf(k):
            reason = "it leaves too few of them, or allows values that the fitted prior did not"
        elif k > TRUSTED_K:
            reason = f"Pareto k̂ is {k:.2f}, above {TRUSTED_K}"
        else:
            reason = f"they are worth {effect.effective[i]:.0f}, fewer than {FEWEST_DRAWS:.0f}"
        return f"The draws of this fit cannot say: {reason}. cassini-bayes sweep fits it anew"
    names = effect.group.parameters
    was = f"{len(names)} parameters"
    if len(names) == 1:
        distribution = review.priors.parameters[names[0]].distribution
        if distribution is not None:
            mean, sd = distribution.mean(), distribution.scaled(WIDTHS[i], 0.0).sd()
            scale = display_scale(review.model.specs[names[0]].unit, mean, sd)
            was = f"{plus_minus(mean * scale.factor, sd * scale.factor)} {scale.unit}"
    return f"{was}; Pareto k̂ {max(k, 0.0):.2f}, worth {effect.effective[i]:,.0f} draws"


def width_table(columns: Sequence[Column], effects: Sequence[WidthEffect]) -> pd.DataFrame:
    """The same numbers, a row per prior, width and quantity; NaN where no draw is left."""
    rows = [
        {
            "prior": effect.group.name,
            "parameters": " ".join(effect.group.parameters),
            "width": width,
            "pareto_k": effect.pareto_k[i],
            "effective_draws": effect.effective[i],
            "trusted": bool(effect.trusted[i]),
            "quantity": column.label,
            "unit": column.unit,
            "mean": effect.mean[i, j],
            "sd": effect.sd[i, j],
            "low_90": effect.low[i, j],
            "high_90": effect.high[i, j],
        }
        for effect in effects
        for i, width in enumerate(WIDTHS)
        for j, column in enumerate(columns)
    ]
    return pd.DataFrame(rows)
