"""How far an effect moves the data: δ of σ = √(δᵀV⁻¹δ), on the flight that has it.

A flight without channel noise is looked at by the baseline at the true parameters. What its balance
leaves, whitened, is the effect's δ and the little that the model approximates (cut tails, counters
between readings). V = 1 + X P⁻¹ Xᵀ is the baseline's prior-predictive covariance, X its columns on
that same flight: V⁻¹ = 1 − X (XᵀX + P)⁻¹ Xᵀ. Columns are not smoothed here: there is no noise.

Where channels and counters are coarse (trials over conditions), the flight without noise has the
finest steps, and V is that of the flight with them: its noise, and a column for everything that its
counters leave open (:func:`in_noise_of`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cassini_bayes.balance.linearised import Linear, fitted_away, whitened, with_unknowns
from cassini_bayes.balance.part_columns import ColumnsByPart, PartColumns
from cassini_bayes.balance.statistics.rows import SAME_S
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import Hypothesis, extend, none_hypothesis
from cassini_bayes.diagnosis.innovations import effect_momentum, innovations, linearise
from cassini_bayes.diagnosis.rows_and_turns import BesideMode
from cassini_bayes.diagnosis.unresolved import unresolved
from cassini_bayes.effects.effect import Effect
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.simulation import Truth


@dataclass(frozen=True)
class View:
    """A flight without noise as the baseline sees it at the truth.

    ``left`` (m,) is the whitened balance that the true parameters leave; ``factors`` are the lower
    factors (3, 3) of every event's noise, ``times`` (n,) the times of its rows, s.
    """

    events: Events
    none: Hypothesis
    point: Array
    linear: Linear
    left: Array
    factors: tuple[Array, ...]
    times: tuple[Array, ...]


def squared_size(linear: Linear, shift: Array) -> float:
    """δᵀV⁻¹δ of a whitened shift (m,)."""
    return float(shift @ fitted_away(linear, shift))


def at_truth(events: Events, truth: Truth, *, noisy: bool = False) -> View:
    """Look at a flight without noise with the true parameters, thrusts and torques.

    ``noisy``: a flight with noise, where slopes see running means of the channels.
    """
    none = none_hypothesis(events)
    names = none.model.space.names
    # how often pulses are close is what the controller did, no parameter of the truth
    means = dict(zip(names, none.model.space.distributions, strict=True))
    point = none.model.space.to_standard(
        {name: truth.parameters.get(name, means[name].mean()) for name in names}
    )
    linear, factors = linearise(none, point, smooth_channels=noisy)
    left = linear.target - linear.columns @ _known(none, events, truth, linear.columns.width)
    times = tuple(event.usable_rows.time_s for event in events.telemetry)
    return View(events, none, point, linear, left, tuple(factors), times)


def in_noise_of(quiet: View, flown: Events, truth: Truth) -> View:
    """What a flight without noise leaves, in the noise of the same flight as it was recorded.

    V then has the noise of rounded channels, and a column for everything that records leave open.
    """
    seen = at_truth(flown, truth, noisy=True)
    opened = [unresolved(seen.none, seen.point, place) for place in range(len(seen.times))]
    linear = with_unknowns(seen.linear, opened, seen.factors)
    ours, theirs, times = _common_rows(quiet.times, seen.times)
    momentum = _in_momentum(quiet.left, quiet.linear, quiet.factors)
    return replace(
        quiet,
        linear=_rows_of(linear, theirs, times),
        left=_whitened(momentum, seen.factors)[ours],
        factors=seen.factors,
        times=times,
    )


def _known(none: Hypothesis, events: Events, truth: Truth, width: int) -> Array:
    """Coefficients of the linear columns that the truth gives; initial momentum and tails are 0.

    Thrusts are split into shared and own departures: any split gives the same thrusts, but the
    shared ones are common to all events, so everything goes to the own ones where they suffice.
    """
    model = none.model
    shared = len(none.model.space.names)
    shared += model.thrust_prior.shared.shape[1] if model.thrust_prior.shared.size else 0
    known, place = np.zeros(width), shared
    for event, term in zip(events.telemetry, model.telemetry, strict=True):
        individual = (
            model.thrust_prior.departures if term.balance.pattern.thrusters else np.zeros((0, 0))
        )
        if individual.size:
            thrusts = truth.thrust_n(event.id, event.thrusters)
            departure = np.array([thrusts[k] for k in event.thrusters])
            departure = departure - model.thrust_prior.common_mean_n
            known[place : place + individual.shape[1]] = np.linalg.solve(individual, departure)
        place += individual.shape[1]
        values = truth.of(event.id)
        torque = np.array([values[f"external_torque_{axis}_n_m"] for axis in "xyz"])
        known[place + 3 : place + 6] = torque - model.torque_mean_n_m
        place += 6 + term.balance.pattern.hidden
    return known


def held(none: Hypothesis, effect: Effect, values: Mapping[str, float]) -> Hypothesis:
    """The baseline with an effect at fixed values (departures or values, by key)."""
    extended, old = extend(none, [effect]), none.model.space
    fixed = {p.name: float(values[p.key]) for p in effect.parameters}
    space = ParameterSpace(old.names, {**old.fixed, **fixed}, old.distributions, old.blocks)
    return replace(extended, model=replace(extended.model, space=space))


def modelled_size(view: View, effect: Effect, values: Mapping[str, float]) -> float:
    """σ by the change that the model of the effect makes on the flight that has it."""
    changed = held(view.none, effect, values)
    other, factors = linearise(changed, view.point, smooth_channels=False)
    before = _in_momentum(view.linear.target, view.linear, view.factors)
    after = _in_momentum(other.target, other, tuple(factors))
    change = [b - a for a, b in zip(before, after, strict=True)]
    return float(np.sqrt(squared_size(view.linear, _whitened(change, view.factors))))


def added_size(none: Hypothesis, with_it: Hypothesis, z: Array) -> float:
    """σ by what an effect at fixed values adds to rows and turns at a point z (d,) of both.

    ``with_it`` is :func:`held`. V has a column for everything that records leave open, and the
    baseline's prior about z.
    """
    added = effect_momentum(none, z, [(with_it, np.zeros((1, 0)))])
    told = BesideMode.of(none, z, innovations(none, z)).information(added)
    return float(np.sqrt(told.matrix[0, 0]))


def _in_momentum(white: Array, linear: Linear, factors: tuple[Array, ...]) -> list[Array]:
    """Whitened values (m,) of a linear model's rows as momentum (n, 3) of every event."""
    parts = zip(linear.parts, factors, strict=True)
    return [white[part].reshape(-1, 3) @ factor.T for part, factor in parts]


def _whitened(momentum: Sequence[Array], factors: Sequence[Array]) -> Array:
    """Values (m,) of momentum (n, 3) of every event, in units of its noise."""
    parts = zip(momentum, factors, strict=True)
    return np.concatenate([(part @ np.linalg.inv(factor).T).reshape(-1) for part, factor in parts])


@dataclass(frozen=True)
class Shift:
    """How the data of a flight with an effect differ from those without: δ and its V.

    ``left`` (m,) is δ, whitened, ``linear`` the model whose V it is measured by; ``background`` is
    what of the square is there without the effect, ``places`` those of the values among the view's.
    """

    linear: Linear
    left: Array
    background: float
    places: Places


def shift_between(shown: View, plain: View) -> Shift:
    """The actual change of the data from the flight without to the flight with an effect.

    Where the motion and the rows are the same (a misreading), rows are compared one by one. Where
    the controllers answered, pulses fall elsewhere, and late records let rows pass that hide a
    pulse: what the model approximates, seen in the flight without the effect, is taken off the
    square.
    """
    events = zip(shown.events.telemetry, plain.events.telemetry, strict=True)
    same = all(
        np.array_equal(a.samples.attitude, b.samples.attitude, equal_nan=True)
        and np.array_equal(a.usable_places, b.usable_places)
        for a, b in events
    )
    if not same:
        everything = np.arange(len(shown.left))
        return Shift(shown.linear, shown.left, squared_size(plain.linear, plain.left), everything)
    mine, others, times = _common_rows(shown.times, plain.times)
    linear = _rows_of(plain.linear, others, times)
    return Shift(linear, shown.left[mine] - plain.left[others], 0.0, mine)


def changed_size(shown: View, plain: View) -> float:
    """σ by the actual change of the data (:func:`shift_between`)."""
    shift = shift_between(shown, plain)
    square = squared_size(shift.linear, shift.left) - shift.background
    return float(np.sqrt(max(square, 0.0)))


def as_seen(view: View, momentum: Sequence[Array]) -> Array:
    """Columns (n, 3, S), N m s, of every event's rows as the view has them: (m, S), whitened."""
    rows = [event.usable_rows.time_s for event in view.events.telemetry]
    ours, _, _ = _common_rows(rows, view.times)
    parts = zip(momentum, view.factors, strict=True)
    return np.concatenate([whitened(part, factor) for part, factor in parts])[ours]


def _common_rows(
    one: Sequence[Array], other: Sequence[Array]
) -> tuple[Places, Places, tuple[Array, ...]]:
    """Places of the values of rows that two flights have in common, in each, and their times."""
    ours, theirs, times = [], [], []
    first, second = 0, 0
    for a, b in zip(one, other, strict=True):
        _, i, j = np.intersect1d(np.round(a / SAME_S), np.round(b / SAME_S), return_indices=True)
        ours.append((first + 3 * i[:, None] + np.arange(3)).reshape(-1))
        theirs.append((second + 3 * j[:, None] + np.arange(3)).reshape(-1))
        first, second = first + 3 * len(a), second + 3 * len(b)
        times.append(a[i])
    return np.concatenate(ours), np.concatenate(theirs), tuple(times)


def _rows_of(linear: Linear, places: Places, times: Sequence[Array]) -> Linear:
    """The linear model of some of its rows."""
    ends = np.cumsum([3 * len(time) for time in times])[:-1]
    parts = tuple(
        PartColumns(known.places, known.values[own - whole.start])
        for known, whole, own in zip(
            linear.columns.parts, linear.parts, np.split(places, ends), strict=True
        )
    )
    columns = ColumnsByPart(parts, linear.columns.width)
    return Linear(linear.target[places], columns, linear.precision)
