"""How far an effect moves the data: δ of σ = √(δᵀV⁻¹δ), on the flight that has it.

A flight without channel noise is looked at by the baseline at the true parameters. What its balance
leaves, whitened, is the effect's δ and the little that the model approximates (cut tails, counters
between readings). V = 1 + X P⁻¹ Xᵀ is the baseline's prior-predictive covariance, X its columns on
that same flight: V⁻¹ = 1 − X (XᵀX + P)⁻¹ Xᵀ. Columns are not smoothed here: there is no noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.diagnosis.extended import Case, Hypothesis, extend, none_hypothesis
from cassini_bayes.diagnosis.innovations import Linear, fitted_away, linearise
from cassini_bayes.effects.catalogue import Catalogue, Effect
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.simulation import Truth

Array = NDArray[np.float64]
_SAME_S = 1e-6


@dataclass(frozen=True)
class Seen:
    """A flight without noise by the baseline at the truth.

    ``left`` (m,) is the whitened balance that the true parameters leave; ``times`` those of the
    rows of every event; ``factors`` the noise's lower factors (3, 3).
    """

    case: Case
    none: Hypothesis
    point: Array
    linear: Linear
    left: Array
    times: tuple[Array, ...]
    factors: tuple[Array, ...]


def squared_size(linear: Linear, shift: Array) -> float:
    """δᵀV⁻¹δ of a whitened shift (m,)."""
    return float(shift @ fitted_away(linear, shift))


def seen_at_truth(case: Case, catalogue: Catalogue, truth: Truth) -> Seen:
    """Look at a flight without noise with the true parameters, thrusts and torques."""
    none = none_hypothesis(case, catalogue)
    names = none.model.space.names
    point = none.model.space.to_standard({name: truth.parameters[name] for name in names})
    linear, rows, factors = linearise(case, none, point, smooth_channels=False)
    left = linear.target - linear.columns @ _known(none, case, truth, linear.columns.shape[1])
    times = tuple(own.time_s for own in rows)
    return Seen(case, none, point, linear, left, times, tuple(factors))


def _known(none: Hypothesis, case: Case, truth: Truth, width: int) -> Array:
    """Coefficients of the linear columns that the truth gives; initial momentum and tails are 0.

    Thrusts are split into shared and own departures: any split gives the same thrusts, but the
    shared ones are common to all events, so everything goes to the own ones where they suffice.
    """
    model = none.model
    shared = len(none.model.space.names)
    shared += model.thrust_prior.shared.shape[1] if model.thrust_prior.shared.size else 0
    known, place = np.zeros(width), shared
    for source, term in zip(case.sources, model.telemetry, strict=True):
        own = model.thrust_prior.own if term.event.fires else np.zeros((0, 0))
        if own.size:
            thrusts = truth.thrust_n(source.id, source.thrusters)
            departure = np.array([thrusts[k] for k in source.thrusters])
            departure = departure - model.thrust_prior.common_mean_n
            known[place : place + own.shape[1]] = np.linalg.solve(own, departure)
        place += own.shape[1]
        values = truth.of(source.id)
        torque = np.array([values[f"external_torque_{axis}_n_m"] for axis in "xyz"])
        known[place + 3 : place + 6] = torque - model.torque_mean_n_m
        place += 6 + len(term.balance.pattern.cuts)
    return known


def held(none: Hypothesis, effect: Effect, values: Mapping[str, float], case: Case) -> Hypothesis:
    """The baseline with an effect at fixed values (departures or values, by key)."""
    extended, old = extend(none, [effect], case), none.model.space
    fixed = {p.name: float(values[p.key]) for p in effect.parameters}
    space = ParameterSpace(old.names, {**old.fixed, **fixed}, old.distributions, old.blocks)
    return replace(extended, model=replace(extended.model, space=space))


def modelled_size(seen: Seen, effect: Effect, values: Mapping[str, float]) -> float:
    """σ by the change that the model of the effect makes on the flight that has it."""
    changed = held(seen.none, effect, values, seen.case)
    other, _, factors = linearise(seen.case, changed, seen.point, smooth_channels=False)
    before, after = _in_momentum(seen.linear, seen.factors), _in_momentum(other, tuple(factors))
    shift = np.concatenate(
        [
            ((b - a) @ np.linalg.inv(factor).T).reshape(-1)
            for a, b, factor in zip(before, after, seen.factors, strict=True)
        ]
    )
    return float(np.sqrt(squared_size(seen.linear, shift)))


def _in_momentum(linear: Linear, factors: tuple[Array, ...]) -> list[Array]:
    ends = np.cumsum([3 * n for n in linear.rows])[:-1]
    parts = np.split(linear.target, ends)
    return [part.reshape(-1, 3) @ f.T for part, f in zip(parts, factors, strict=True)]


def changed_size(shown: Seen, plain: Seen) -> float:
    """σ by the actual change of the data from the flight without to the flight with an effect.

    Where the motion is the same (a misreading), rows are compared one by one. Where the controllers
    answered, pulses fall elsewhere: what the model approximates, seen in the flight without the
    effect, is taken off the square.
    """
    same = all(
        np.array_equal(a.samples.attitude, b.samples.attitude, equal_nan=True)
        for a, b in zip(shown.case.sources, plain.case.sources, strict=True)
    )
    if same:
        return _paired(shown, plain)
    excess = squared_size(shown.linear, shown.left) - squared_size(plain.linear, plain.left)
    return float(np.sqrt(max(excess, 0.0)))


def _paired(shown: Seen, plain: Seen) -> float:
    ours, theirs = [], []
    first, second = 0, 0
    counts = []
    for a, b in zip(shown.times, plain.times, strict=True):
        _, i, j = np.intersect1d(np.round(a / _SAME_S), np.round(b / _SAME_S), return_indices=True)
        ours.append((first + 3 * i[:, None] + np.arange(3)).reshape(-1))
        theirs.append((second + 3 * j[:, None] + np.arange(3)).reshape(-1))
        first, second = first + 3 * len(a), second + 3 * len(b)
        counts.append(len(i))
    mine, others = np.concatenate(ours), np.concatenate(theirs)
    linear = Linear(
        plain.linear.target[others],
        plain.linear.columns[others],
        plain.linear.precision,
        tuple(counts),
    )
    return float(np.sqrt(squared_size(linear, shown.left[mine] - plain.left[others])))
