"""What thrusters do that no cause of the catalogue has: two more forms of ``unknown``.

``unknown`` is torque that wanders, whatever fires. Two forms go with the thrusters:

* *drift*: the thrust of all of them changes with time, event by event, F (1 + δ(t)),

      δ(t) = a Σ_m g_m √2 cos(mπt/T)/(m c),   c² = Σ_m 1/m²,   g_m ~ N(0, 1),   m = 1 … 6;

* *lever*: a thruster turns the body by more than its arm, by F l, l ~ N(0, b²) in every axis, the
  same in all events.

Both are columns of momentum in rows and in turns of quiet pieces, linear in g and l. Beside a
hypothesis that is linear about its mode they change its log evidence by

    Δ(a) = ½ hᵀ (M + a⁻²)⁻¹ h − ½ log |1 + a² M|,

M and h those of :func:`cassini_bayes.balance.linearised.information`, summed over a or b that are
log-uniform between bounds (:class:`cassini_bayes.effects.registry.Unknown`). They are weighed
beside the most probable of ``none`` and the causes: what goes with thrusters is mostly bent into
the cause that is nearest to it (docs/topics/criticism.md §1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.balance.linearised import Information, mean_change_of_evidence
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import NONE, UNKNOWN, H, Weighed
from cassini_bayes.diagnosis.hypotheses import Hypothesis, expected_thrusts_n
from cassini_bayes.diagnosis.innovations import examined, left_by, thrust_columns
from cassini_bayes.diagnosis.rows_and_turns import BesideMode, side_by_side
from cassini_bayes.diagnosis.second_reckoning import named_in_columns
from cassini_bayes.effects.effect import Remainder
from cassini_bayes.effects.registry import Unknown
from cassini_bayes.spacecraft.attitude import direction_cosines

TORQUE: Final = "torque"
DRIFT: Final = "drift"
LEVER: Final = "lever"
COSINES: Final = 6
"""Of an event's drift: judgement, a surge of minutes in half an hour; the faster a change is, the
less momentum it brings."""
LEAST_ARM_M: Final = 1e-6  # of a thruster through the c.m., which turns nothing
NODES: Final = 25  # of a scale between its bounds: a factor of 1.18 apart


def thruster_forms(weighed: Weighed[Hypothesis], unknown: Unknown) -> dict[str, float]:
    """Change of a hypothesis's log evidence by every form, nats; none where nothing fires.

    Parameters
    ----------
    weighed
        ``none`` or a cause with its mode, of telemetry.
    unknown
        Bounds of the scales.
    """
    hypothesis, point = weighed.hypothesis, weighed.mode.point
    if not _fires(hypothesis):
        return {}
    left = left_by(weighed)
    drift, lever = form_columns(hypothesis, point, left)
    told = BesideMode.of(hypothesis, point, left).information(side_by_side(drift, lever))
    count = sum(own.shape[2] for own in drift)
    return {
        DRIFT: _summed(told, slice(0, count), unknown.thrust_drift),
        LEVER: _summed(told, slice(count, None), unknown.lever_m),
    }


def form_columns(
    hypothesis: Hypothesis, point: Array, left: Remainder
) -> tuple[list[Array], list[Array]]:
    """Momentum of every event, N m s: of a drift of one, (n, 3, M), and of a metre, (n, 3, 3 K).

    They are of the thrusts that the hypothesis has at its mode (d,): with half of its thrust a
    thruster drifts, and turns the body, by half as much.
    """
    model = hypothesis.model
    located = model.points(point[None])
    names = tuple(dict.fromkeys(name for event in left.rows for name in event.thrusters))
    drift, lever = [], []
    for place, (event, term) in enumerate(zip(left.rows, model.telemetry, strict=True)):
        turn = direction_cosines(event.attitude)
        # momentum in inertial axes, by what was fired from row to row
        per_newton = np.einsum("nai,nak->nik", turn, thrust_columns(hypothesis, point, place))
        own = expected_thrusts_n(term, located)[0]
        fired = own * np.diff(per_newton, axis=0, prepend=per_newton[:1])
        drift.append(_drift(event.time_s, turn, fired))
        if fired.shape[2] > 0:
            arms = np.broadcast_to(term.physics(located).arms_m, (1, *fired.shape[1:]))[0]
            length_m = np.maximum(np.linalg.norm(arms, axis=0), LEAST_ARM_M)
            impulse = np.linalg.norm(fired, axis=1) / length_m
            own = _lever(turn, impulse)
        else:
            own = np.zeros((len(event.time_s), 3, 0))
        lever.append(_of_all(own, event.thrusters, names))
    return drift, lever


def _fires(hypothesis: Hypothesis) -> bool:
    return any(term.balance.fires for term in hypothesis.model.telemetry)


def _drift(time_s: Array, turn: Array, fired: Array) -> Array:
    """Columns (n, 3, M) of a drift of one: what was fired (n, 3, K), N m s, times each cosine."""
    since = (time_s - time_s[0]) / max(time_s[-1] - time_s[0], 1.0)
    order = np.arange(1, COSINES + 1) if fired.shape[2] > 0 else np.arange(0)
    shares = np.sqrt(2.0) * np.cos(np.pi * np.outer(since, order)) / np.maximum(order, 1)
    shares /= np.sqrt((1.0 / np.arange(1, COSINES + 1) ** 2).sum())
    inertial = np.cumsum(fired.sum(axis=2)[:, :, None] * shares[:, None], axis=0)
    return np.asarray(np.einsum("nai,nim->nam", turn, inertial))


def _lever(turn: Array, impulse: Array) -> Array:
    """Columns (n, 3, 3 K), N s, of impulses (n, K) about each body axis of every thruster."""
    # what a thruster gave about a body axis stays in inertial space as it was given
    given = np.cumsum(np.einsum("nci,nk->nikc", turn, impulse), axis=0)
    about = np.einsum("nai,nikc->nakc", turn, given)
    return np.asarray(about.reshape(len(turn), 3, -1))


def _of_all(own: Array, thrusters: Sequence[str], names: Sequence[str]) -> Array:
    """An event's columns (n, 3, 3 K) among those of all thrusters of all events."""
    result = np.zeros((len(own), 3, len(names), 3))
    places = [names.index(name) for name in thrusters]
    result[:, :, places] = own.reshape(len(own), 3, -1, 3)
    return result.reshape(len(own), 3, -1)


def _summed(told: Information, which: slice, bounds: tuple[float, float]) -> float:
    """Log of the mean over scales, log-uniform between bounds, of the change of the evidence."""
    own, scales = (told.matrix[which, which], told.vector[which]), np.geomspace(*bounds, NODES)
    return mean_change_of_evidence(*own, scales, np.zeros(NODES))


def with_thruster_forms(
    weighed: Sequence[Weighed[Hypothesis]], unknown: Unknown
) -> list[Weighed[Hypothesis]]:
    """Everything weighed, with all forms in the evidence of ``unknown``.

    Each form of three has a third of its prior probability. Those of the thrusters stand beside the
    most probable of ``none`` and the causes, and have its evidence and prior probability. Beside
    ``none`` what the linear model, in which they are weighed, says of a steady torque beyond its
    evidence is taken off: it has a name (:func:`.second_reckoning.named_in_columns`).
    """
    named = [w for w in weighed if w.name != UNKNOWN]
    best = max(named, key=lambda w: w.score)
    if not _fires(best.hypothesis):
        return list(weighed)
    looked_at = examined(best)
    forms = thruster_forms(looked_at, unknown)
    if best.name == NONE and max(forms.values()) > 0.0:
        by_name = named_in_columns([looked_at if w is best else w for w in weighed])
        forms = {name: nats - by_name for name, nats in forms.items()}
    return [
        with_forms(w, best.score, forms) if w.name == UNKNOWN else looked_at if w is best else w
        for w in weighed
    ]


def with_forms(unknown: Weighed[H], beside: float, forms: Mapping[str, float]) -> Weighed[H]:
    """``unknown`` with further forms that change a score, log of evidence times prior, by some."""
    alone = unknown.without_forms
    each = {TORQUE: alone.net_evidence, **{name: beside + nats for name, nats in forms.items()}}
    scores = np.array(list(each.values())) - np.log(len(each))
    total = float(logsumexp(scores))
    shares = tuple(zip(each, np.exp(scores - total).tolist(), strict=True))
    return replace(alone, summed=total - alone.net_evidence, forms=shares)
