"""Whether something that no catalogue has can be told from what the catalogue has.

δ is how the effect moves the data (:mod:`.shift`). A cause j of the catalogue moves them by M_j s,
with s ~ N(0, 1) in prior scales. With b_j = M_jᵀ V⁻¹ δ and G_j = M_jᵀ V⁻¹ M_j, what no size of it
explains is the least over s of

    δ_j² = δᵀ V⁻¹ δ − 2 b_jᵀ s + sᵀ (1 + G_j) s,

V the baseline's prior-predictive covariance. The square root of the least δ_j² is in σ, as sizes
are: where it is small, some cause says the same of the data, and ``unknown`` cannot win. It owes
nothing to a diagnosis. Causes may begin with any event. An oscillation is not among them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from cassini_bayes.balance.linearised import fitted_away, information
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.hypotheses import extend
from cassini_bayes.diagnosis.innovations import effect_momentum
from cassini_bayes.effects.effect import Effect
from cassini_bayes.studies.blind.oracle import KINKED, about_null, side_of
from cassini_bayes.studies.blind.shift import View, as_seen, shift_between

STEP: Final = 0.3  # prior scales: so far are effects taken to be linear in their sizes
CONSTANTS: Final = (-1.0, 0.0, 1.0)  # standard normals of a time constant


class Alias(NamedTuple):
    """The cause that explains most of a shift, and what it leaves, in σ."""

    name: str
    left_sigma: float


class _Cause(NamedTuple):
    """One cause on one side of none: its columns (m, q), bounds of its size where it has one."""

    name: str
    columns: Array
    low: float
    high: float


def nearest_cause(shown: View, plain: View) -> Alias:
    """The cause that explains most of what an effect does; ``none`` where there are no causes."""
    shift = shift_between(shown, plain)
    whole = float(shift.left @ fitted_away(shift.linear, shift.left)) - shift.background
    causes = list(_causes(shown))
    nothing = np.zeros((len(shift.left), 0))
    seen = [cause.columns[shift.places] for cause in causes]
    every = np.concatenate([nothing, *seen], axis=1)
    told = information(shift.linear, shift.left, every)
    nearest, first = Alias("none", float(np.sqrt(max(whole, 0.0)))), 0
    for cause in causes:
        own = slice(first, first + cause.columns.shape[1])
        first = own.stop
        pull = told.vector[own]
        precision = np.eye(len(pull)) + told.matrix[own, own]
        size = np.linalg.solve(precision, pull)
        if len(size) == 1:
            size = np.clip(size, cause.low, cause.high)
        left = whole - 2.0 * float(pull @ size) + float(size @ precision @ size)
        sigma = float(np.sqrt(max(left, 0.0)))
        if sigma < nearest.left_sigma:
            nearest = Alias(cause.name, sigma)
    return nearest


def _causes(view: View) -> Iterator[_Cause]:
    """Every cause that needs no search, on either side of none, from every event on."""
    ends = 3 * np.cumsum([len(time) for time in view.times])
    for effect in view.events.catalogue.effects:
        if effect.needs_search:
            continue
        for sign in (1.0, -1.0) if effect.kind.name in KINKED else (0.0,):
            side = side_of(effect, sign, 0)
            low, high = (0.0, max(-side.low, side.high)) if sign else (side.low, side.high)
            for columns in _columns(view, effect, sign):
                yield _Cause(effect.name, columns, low, high)
                for end in ends[:-1] if not effect.kind.throughout else ():
                    later = columns * (np.arange(len(columns)) >= end)[:, None]
                    yield _Cause(effect.name, later, low, high)


def _columns(view: View, effect: Effect, sign: float) -> list[Array]:
    """Columns (m, q) of an effect's sizes, for every value of its time constant."""
    plain, rest = about_null(effect, 0.0, {})
    sized = [i for i, p in enumerate(effect.parameters) if p.distribution.name != "lognorm"]
    timed = len(sized) < len(rest)
    step = STEP * (sign or 1.0)
    values = []
    for constant in CONSTANTS if timed else (0.0,):
        at = np.full(len(rest), constant)
        at[sized] = 0.0
        values += [at + step * np.eye(len(rest))[i] for i in sized]
    added = effect_momentum(view.none, view.point, [(extend(view.none, [plain]), np.array(values))])
    columns = as_seen(view, added) / STEP
    return np.split(columns, columns.shape[1] // len(sized), axis=1)
