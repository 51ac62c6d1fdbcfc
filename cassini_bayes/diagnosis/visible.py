"""What these data would have shown: the size from which a cause would have been named.

Along the size x of a cause the log likelihood, with everything else at its best, falls by about
(x − x̂)²/2σ²; two points of it tell σ, what these data know the size to. A cause of true size x has
an estimate of N(x, σ²) and, with a normal prior of width w about no effect, a log Bayes factor
(Savage and Dickey) of

    ½ log(σ²/(σ² + w²)) + ½ (x̂/σ)² w²/(σ² + w²)

over nothing, log 2 more where the prior has one side only. Solved for x̂ at the evidence that turns
its prior odds into :data:`ODDS`; 1.28 σ more, and nine of ten such flights come that far.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.modes import LOG_2_PI, LogDensity, Mode, maximise
from cassini_bayes.effects.effect import Effect, EffectParameter
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.effects.wording import AtLeast

ODDS: Final = 9.0
"""Of the cause over nothing, from which it counts as seen: nine to one, a probability of 0.9."""
DETECTED: Final = 1.2816  # standard normal below which nine of ten lie
STEPS: Final = 7
SHRINK: Final = 3.0
"""Sizes looked at: from the width of the prior over 3⁷, which telemetry hardly tells from nothing,
up to it; each falls nine times as far as the one before."""
FEW_STEPS: Final = 10  # of L-BFGS where Newton steps of the nuisances do not do (judgement)
NATS_AT: Final = 8.0
"""Fall of the log likelihood near which σ is taken: what a cause needs to be named (judgement)."""
LEAST_FALL: Final = 1e-3  # nats: below, rounding of the density is a share of it
FARTHEST: Final = 3.0
"""Prior widths beyond which no size is stated: the prior holds 0.3 % there."""


@dataclass(frozen=True)
class Visible:
    """A cause's size from which it would have been seen, and what the data know it to.

    ``size`` and ``sd`` are departures from no effect in ``unit``; ``size`` is None where even what
    the prior hardly allows would have stayed hidden, ``sd`` where the data do not know it at all.
    """

    cause: str
    parameter: str
    unit: str
    size: float | None
    sd: float | None
    prior_width: float


def visible_record(
    none: Weighed[Hypothesis], cause: Weighed[Hypothesis], kinds: Kinds
) -> dict[str, Any] | None:
    """A row of the record, what it says in words with it; None of what has no one size.

    That are pairs, causes of several sizes at once, those that a search comes before, and those
    whose prior is neither normal nor half-normal.
    """
    effects = cause.hypothesis.effects
    if len(effects) != 1 or len(effects[0].parameters) != 1 or effects[0].kind.search is not None:
        return None
    (effect,) = effects
    nats = np.log(ODDS * none.hypothesis.prior_probability / effect.prior_probability)
    seen = visible_size(cause.hypothesis.log_density, none.mode, effect, float(nats))
    if seen is None:
        return None
    size = said(effect, seen)
    words = None if size is None else kinds.says(effect.name, {seen.parameter: size})
    thruster = effect.target if effect.target in cause.hypothesis.model.thrusters else None
    return {**vars(seen), "thruster": thruster, "says": words}


def prior_width(parameter: EffectParameter) -> float | None:
    """Width w of a normal or half-normal prior about no effect; None of any other."""
    prior = parameter.distribution
    return prior.scale if prior.name in ("norm", "halfnorm") else None


def no_effect(parameter: EffectParameter) -> float:
    """The value without an effect, in which such a prior has its peak."""
    return parameter.distribution.loc


def sides(parameter: EffectParameter) -> tuple[float, ...]:
    """Signs of the departures that the prior allows, that of the farther ones first."""
    low, high = parameter.distribution.support
    reach = {1.0: high - no_effect(parameter), -1.0: no_effect(parameter) - low}
    return tuple(sorted((sign for sign in reach if reach[sign] > 0.0), key=lambda s: -reach[s]))


def visible_size(
    density: LogDensity, base: Mode, effect: Effect, needed_nats: float
) -> Visible | None:
    """Of one effect of one size; None where its prior is neither normal nor half-normal.

    Parameters
    ----------
    density
        Log posterior density of the baseline with the effect, whose coordinate is the last.
    base
        The baseline's mode.
    effect
        With its prior.
    needed_nats
        Log Bayes factor from which it counts as seen.
    """
    (parameter,) = effect.parameters
    width = prior_width(parameter)
    if width is None:
        return None
    signs = sides(parameter)
    sizes = signs[0] * width / SHRINK ** np.arange(STEPS, -1, -1)
    z = parameter.distribution.standard_of(no_effect(parameter) + sizes)
    sizes, z = sizes[np.isfinite(z)], z[np.isfinite(z)]
    sd = size_sd(*_falls(density, base, np.abs(sizes), z))
    size = (
        None if sd is None else detectable_size(sd, width, needed_nats, one_sided=len(signs) == 1)
    )
    if size is not None and size > FARTHEST * width:
        size = None
    return Visible(effect.name, parameter.key, parameter.unit, size, sd, width)


def detectable_size(sd: float, width: float, needed_nats: float, *, one_sided: bool) -> float:
    """True size from which nine of ten flights give the evidence needed (module's text)."""
    share = width**2 / (sd**2 + width**2)
    nats = needed_nats - 0.5 * np.log1p(-share) - (np.log(2.0) if one_sided else 0.0)
    return float(sd * (np.sqrt(2.0 * max(nats, 0.0) / share) + DETECTED))


def size_sd(sizes: Array, fall: Array) -> float | None:
    """σ from the fall (n,) of the log likelihood at sizes (n,) that grow from next to nothing.

    The parabola x²/2σ² − b x through the size nearest :data:`NATS_AT` and the one before it: b is
    the chance by which the estimate is not at no effect.
    """
    at = 1 + int(np.argmin(np.abs(_too_far(np.abs(fall[1:])))))
    (near, far), (least, most) = sizes[at - 1 : at + 1], fall[at - 1 : at + 1]
    curvature = (most / far - least / near) / (far - near)
    is_known = curvature > 0.0 and abs(most) > LEAST_FALL
    return float(1.0 / np.sqrt(2.0 * curvature)) if is_known else None


def _falls(density: LogDensity, base: Mode, sizes: Array, z: Array) -> tuple[Array, Array]:
    """Some of the sizes (n,), and what the log likelihood falls there (m,) from that at the least.

    ``z`` (n,) are their coordinates. What one falls tells which other is nearest to
    :data:`NATS_AT`; that and the one before it are among them. The first is the one that is nearest
    while the nuisances stay. They are at their best for each, looked for from where the last ones
    say, as they move in proportion to the size.
    """
    best: dict[int, float] = {}
    point, reached = base.point, 1.0

    def likelihood(nuisances: Array, at: Array) -> Array:
        whole = np.column_stack([nuisances, at])
        return np.asarray(density(whole) + 0.5 * at**2 + 0.5 * LOG_2_PI)

    def fall(place: int) -> float:
        nonlocal point, reached

        def beside(nuisances: Array) -> Array:
            return likelihood(nuisances, np.full(len(nuisances), z[place]))

        start = base.point + sizes[place] / reached * (point - base.point)
        point = maximise(beside, start, base.factor, FEW_STEPS)
        reached = float(sizes[place])
        best[place] = float(beside(point[None])[0])
        return best[0] - best[place]

    fall(0)
    point = base.point  # next to nothing tells no direction
    stayed = likelihood(np.tile(base.point, (len(z), 1)), z)
    place = 1 + int(np.argmin(np.abs(_too_far(stayed[0] - stayed[1:]))))
    while place not in best:
        steps = np.rint(_too_far(fall(place)))
        place = int(np.clip(place - steps, 1, len(z) - 1))
    if place - 1 not in best:
        fall(place - 1)
    places = sorted(best)
    return sizes[places], best[0] - np.array([best[place] for place in places])


def _too_far(fall: Array | float) -> Array:
    """Sizes between one that falls that far and the one that falls by :data:`NATS_AT`."""
    return np.asarray(np.log(np.maximum(fall, LEAST_FALL) / NATS_AT) / (2.0 * np.log(SHRINK)))


def said(effect: Effect, visible: Visible) -> AtLeast | None:
    """The size as it is said; None where none would have been seen."""
    if visible.size is None:
        return None
    (parameter,) = effect.parameters
    return AtLeast(
        no_effect(parameter), visible.size, sides(parameter), visible.unit, parameter.is_departure
    )
