"""Leave one event out: predict every event from the others and its own wheel rates and date."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.posterior import build_model
from cassini_bayes.prediction.beliefs import Beliefs
from cassini_bayes.prediction.learning import Learned, learn
from cassini_bayes.prediction.physics import importance_physics
from cassini_bayes.prediction.predict import Prediction, predict
from cassini_bayes.prediction.requests import request_of
from cassini_bayes.prediction.scores import covered, crps, interval_score
from cassini_bayes.priors.reader import Priors

PHYSICS_DRAWS: Final = 4_000
KINDS: Final[Mapping[str, str]] = {
    "on_time": "s",
    "pulses": "count",
    "delta_v_z": "mm/s",
    "hydrazine": "g",
}


@dataclass(frozen=True)
class HeldOut:
    """One fold: the event, what the others taught, its prediction and its draws' Pareto k̂."""

    event: TotalsEvent
    learned: Learned
    prediction: Prediction
    pareto_k: float


def fold(
    events: Sequence[TotalsEvent],
    held_out: int,
    priors: Priors,
    beliefs: Beliefs,
    seed: int,
    size: int = 4_000,
) -> HeldOut:
    """Predict one event. The others alone are passed on; of the event, rates, branch and date.

    Raises
    ------
    InputError
        Fewer than three events (two have to teach).
    """
    if len(events) < 3:
        raise InputError("events", "at least three", str(len(events)), "name more events")
    event = events[held_out]
    others = tuple(other for row, other in enumerate(events) if row != held_out)
    rng = np.random.default_rng(np.random.SeedSequence((seed, held_out)))
    model = build_model(others, priors)
    physics, k = importance_physics(model, rng, PHYSICS_DRAWS)
    learned = learn(model, others, physics, beliefs, rng, size)
    prediction = predict(learned, request_of(event), rng)
    return HeldOut(event, learned, prediction, k)


def leave_one_out(
    events: Sequence[TotalsEvent],
    priors: Priors,
    beliefs: Beliefs,
    seed: int,
    size: int = 4_000,
    told: Callable[[int, int], None] | None = None,
) -> tuple[HeldOut, ...]:
    """Every fold, in the order of the events."""
    result = []
    for row in range(len(events)):
        result.append(fold(events, row, priors, beliefs, seed, size))
        if told is not None:
            told(row + 1, len(events))
    return tuple(result)


def draws_by_kind(prediction: Prediction) -> dict[str, Array]:
    """Draws (n, items) of every kind that is there, in the units of :data:`KINDS`."""
    result = {"on_time": prediction.unit_on_time_s(), "pulses": prediction.unit_pulses()}
    if prediction.delta_v_computed_m_s is not None:
        result["delta_v_z"] = 1e3 * prediction.delta_v_computed_m_s[:, 2:]
    if prediction.hydrazine_g is not None:
        result["hydrazine"] = prediction.hydrazine_g[:, None]
    return result


def outcome_by_kind(event: TotalsEvent, units: tuple[tuple[int, ...], ...]) -> dict[str, Array]:
    """Printed figures of an event like :func:`draws_by_kind`; what is not printed is absent."""
    first = [unit[0] for unit in units]
    result = {"on_time": event.on_time_s[first]}
    if event.pulses is not None:
        result["pulses"] = event.pulses[first]
    if event.delta_v_m_s is not None:
        result["delta_v_z"] = 1e3 * event.delta_v_m_s[2:]
    if event.hydrazine_g is not None:
        result["hydrazine"] = np.array([event.hydrazine_g])
    return result


@dataclass(frozen=True)
class Skill:
    """Scores of one kind over all folds; differences, scores and CRPS in the kind's unit."""

    items: int
    mean_absolute_difference: float
    bias: float
    coverage: float
    interval_score: float
    crps: float


def skill(folds: Sequence[HeldOut]) -> dict[str, Skill]:
    """Skill by kind: the point prediction is the predictive median, intervals are central 90 %."""
    rows: dict[str, list[tuple[Array, Array]]] = {kind: [] for kind in KINDS}
    for held in folds:
        draws = draws_by_kind(held.prediction)
        outcome = outcome_by_kind(held.event, held.prediction.units)
        for kind in KINDS:
            if kind in draws and kind in outcome:
                rows[kind].append((draws[kind], outcome[kind]))
    return {kind: _skill(pairs) for kind, pairs in rows.items() if pairs}


def _skill(pairs: list[tuple[Array, Array]]) -> Skill:
    difference = np.concatenate([np.median(draws, axis=0) - y for draws, y in pairs])
    coverage, score, ranked = (
        float(np.concatenate([judge(draws, y) for draws, y in pairs]).mean())
        for judge in (covered, interval_score, crps)
    )
    distance = float(np.abs(difference).mean())
    return Skill(len(difference), distance, float(difference.mean()), coverage, score, ranked)


def column_difference(
    flight: Sequence[TotalsEvent],
    column: Sequence[TotalsEvent],
    units: tuple[tuple[int, ...], ...],
) -> dict[str, float]:
    """Mean absolute difference of another column to flight by kind, as paper 001 averages."""
    sums: dict[str, list[Array]] = {kind: [] for kind in KINDS}
    other = {event.id: event for event in column}
    for event in flight:
        outcome = outcome_by_kind(event, units)
        theirs = outcome_by_kind(other[event.id], units)
        for kind in KINDS:
            if kind in outcome and kind in theirs:
                sums[kind].append(np.abs(theirs[kind] - outcome[kind]))
    return {kind: float(np.concatenate(v).mean()) for kind, v in sums.items() if v}
