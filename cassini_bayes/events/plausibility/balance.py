"""Does the momentum balance of telemetry close at nominal values? If not: which mistake closes it?

Units and orders of columns can be wrong in ways that no single cell shows. They show in the balance
of momentum, which holds in the inertial frame for any event (C the inertial-to-body matrix):

    Cᵀ(I ω + T I_w ρ) = constant + Σ_k ∫ Cᵀ q_k F ds_k + ∫ Cᵀ τ dt,
    s = on-time + pulses (τ_f − τ_r)

Nominal values are not the truth, so the balance may lean on departures with wide priors: every
thrust, every inertia, the centre of mass, a steady torque. The misfit is what is left, in units of
a tolerance, plus the departures squared in units of their priors. A mistake of units or order is
named if the nominal misfit is bad and undoing the mistake makes it good. The test is generous on
purpose: it must never refuse an honest event with a real fault of the spacecraft in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility.rates import check_rates
from cassini_bayes.events.plausibility.rows import MomentumRows, Rows, conventions
from cassini_bayes.events.telemetry import Chunk, TelemetryEvent
from cassini_bayes.spacecraft import (
    Spacecraft,
    inertia_tensor,
    lever_arms,
    thruster_directions,
    wheel_axes,
    wheel_inertias,
)

RPM_RAD_S: Final = 2.0 * np.pi / 60.0
TOLERANCE: Final = 0.05
"""Of the momentum that is exchanged: what may stay unexplained, 1 σ."""
LEAST_EXCHANGE: Final = 0.03
"""Of the wheels' momentum: the least exchange that the tolerance is taken of."""
WIDTHS: Final[Mapping[str, float]] = {
    "thrust": 0.2,  # of the nominal thrust, each thruster
    "inertia": 0.1,  # of the mean moment of inertia, each element
    "wheel": 0.03,  # of the spin inertia, each wheel
    "torque": 0.006,  # N m, each axis: a leak of a few mN
    "centre": 0.15,  # m, each axis
    "start": 1e6,  # N m s, each axis: not known beforehand
}
BAD: Final = 40.0
SUSPECT: Final = 10.0
EXPLAINED: Final = 0.25
"""Of the nominal misfit: an alternative that leaves less explains it."""


@dataclass(frozen=True)
class Balance:
    """How well the balance closes: rows used, misfit (good below some 10), departures by name.

    With fewer rows than ``LEAST_ROWS`` that sample every channel, nothing was checked and the
    misfit is NaN. ``unexplained`` is the share of the exchanged momentum that nothing explains.
    """

    rows: int
    misfit: float
    unexplained: float


def check_momentum(
    event: TelemetryEvent,
    chunks: Iterable[Chunk] | MomentumRows,
    spacecraft: Spacecraft,
    parameters: Mapping[str, float],
) -> Balance:
    """Check an event's momentum balance and its rates against its attitudes at nominal values.

    Parameters
    ----------
    event, chunks, spacecraft
        From :func:`read_event` and :func:`read_chunks`; or the rows collected from the chunks.
    parameters
        Nominal values by name: inertia, wheels, and for events with on-times geometry, centre of
        mass, ``thrust_common_n``, ``tau_rise_s`` and ``tau_fall_s``; prior means will do.

    Raises
    ------
    InputError
        The balance does not close within what faults of a spacecraft explain. It names the mistake
        that would close it (wheel rates in rad/s, the wheels' order, the quaternion's convention)
        or says how much stays open.
    """
    if isinstance(chunks, MomentumRows):
        collected = chunks
    else:
        collected = MomentumRows(_tau_difference_s(parameters))
        for chunk in chunks:
            collected.add(chunk)
    rows = collected.rows()
    if rows is None:
        return Balance(0, np.nan, np.nan)
    check_rates(event, rows)
    balance = _balance(event, rows, spacecraft, parameters)
    if balance.misfit > SUSPECT:
        _explain(event, rows, spacecraft, parameters, balance)
    return balance


def momentum_rows(parameters: Mapping[str, float]) -> MomentumRows:
    """An empty collection, to be fed chunks and given to :func:`check_momentum`."""
    return MomentumRows(_tau_difference_s(parameters))


def _tau_difference_s(parameters: Mapping[str, float]) -> float:
    return parameters.get("tau_fall_s", 0.0) - parameters.get("tau_rise_s", 0.0)


def _body_to_inertial(attitude: Array) -> Array:
    """Cᵀ (n, 3, 3) of C = (q4² − q·q) 1 + 2 q qᵀ − 2 q4 [q×]."""
    q, q4 = attitude[:, :3], attitude[:, 3]
    matrix = 2.0 * q[:, :, None] * q[:, None, :]
    matrix += (q4 * q4 - np.einsum("ij,ij->i", q, q))[:, None, None] * np.eye(3)
    zero = np.zeros(len(q))
    cross = np.array(
        [[zero, -q[:, 2], q[:, 1]], [q[:, 2], zero, -q[:, 0]], [-q[:, 1], q[:, 0], zero]]
    ).transpose(2, 0, 1)
    return np.asarray(matrix + 2.0 * q4[:, None, None] * cross)


def _accumulated(turn: Array, steps: Array) -> Array:
    """∫ Cᵀ dx of body vectors: turn (n, 3, 3), steps (n − 1, 3, J) to (n, 3, J), from 0."""
    middle = 0.5 * (turn[1:] + turn[:-1])
    sums = np.cumsum(middle @ steps, axis=0)
    return np.concatenate([np.zeros((1, *sums.shape[1:])), sums])


def _columns(
    event: TelemetryEvent, rows: Rows, spacecraft: Spacecraft, parameters: Mapping[str, float]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Momenta (n, 3) at nominal values, and columns (n, 3, J) of the departures in N m s."""
    turn = _body_to_inertial(rows.attitude)
    inertia = inertia_tensor(parameters)
    places = [[w.number for w in spacecraft.wheels].index(number) for number in event.wheels]
    spins = (wheel_axes(spacecraft, parameters) * wheel_inertias(spacecraft, parameters))[:, places]
    wheels = np.einsum("nij,jw,nw->niw", turn, spins, RPM_RAD_S * rows.wheel_rpm)
    size = float(np.trace(inertia)) / 3.0
    elements = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    units = np.zeros((3, 3, 6))
    for j, (a, b) in enumerate(elements):
        units[a, b, j] = units[b, a, j] = size
    step_s = np.diff(rows.time_s)
    momenta = {
        "body": np.einsum("nij,jk,nk->ni", turn, inertia, rows.rate_rad_s),
        "wheels": wheels.sum(axis=2),
    }
    departures = {
        "inertia": np.einsum("nij,jkl,nk->nil", turn, units, rows.rate_rad_s),
        "wheel": wheels,
        "torque": -_accumulated(turn, step_s[:, None, None] * np.eye(3)),
        "start": np.broadcast_to(np.eye(3), (len(step_s) + 1, 3, 3)),
    }
    if rows.effective_s.shape[1]:
        force = parameters["thrust_common_n"]
        steps = force * np.diff(rows.effective_s, axis=0)[:, None, :]
        arms = lever_arms(spacecraft, event.branch, parameters)
        impulses = _accumulated(turn, arms * steps)
        push = thruster_directions(spacecraft, event.branch) * steps
        moved = np.stack([np.cross(axis, push.sum(axis=2)) for axis in np.eye(3)], axis=2)
        momenta["thrusters"] = -impulses.sum(axis=2)
        departures["thrust"] = -impulses
        departures["centre"] = _accumulated(turn, moved)
    return momenta, departures


def _balance(
    event: TelemetryEvent, rows: Rows, spacecraft: Spacecraft, parameters: Mapping[str, float]
) -> Balance:
    """The least misfit over departures from the nominal values."""
    momenta, departures = _columns(event, rows, spacecraft, parameters)
    total = sum(momenta.values())
    assert isinstance(total, np.ndarray)
    count = len(total)
    exchanged = max(_spread(value) for value in momenta.values())
    scale = max(exchanged, LEAST_EXCHANGE * float(np.abs(momenta["wheels"]).max()), 1e-9)
    noise = np.sqrt(0.5 * np.mean(np.sum(np.diff(total, axis=0) ** 2, axis=1)))
    weight = 1.0 / (np.hypot(TOLERANCE * scale, noise) * np.sqrt(count))
    matrix = np.concatenate([WIDTHS[name] * own for name, own in departures.items()], axis=2)
    design = np.concatenate([weight * matrix.reshape(3 * count, -1), np.eye(matrix.shape[2])])
    target = np.concatenate([-weight * total.ravel(), np.zeros(matrix.shape[2])])
    solution = np.linalg.lstsq(design, target, rcond=None)[0]
    left = design @ solution - target
    open_share = float(np.sqrt(np.sum(left[: 3 * count] ** 2))) / weight / np.sqrt(count) / scale
    return Balance(count, float(left @ left), open_share)


def _spread(momentum: Array) -> float:
    """Root mean square of a momentum (n, 3) about its mean."""
    return float(np.sqrt(np.mean(np.sum((momentum - momentum.mean(axis=0)) ** 2, axis=1))))


def _alternatives(event: TelemetryEvent, rows: Rows) -> Iterator[tuple[str, str, Rows]]:
    """Mistakes with the fix and the rows as they would be without it."""
    for unit, factor in (("rad/s", 1.0 / RPM_RAD_S), ("deg/s", 1.0 / 6.0)):
        yield (
            f"wheel rates that look like {unit} (the balance closes once they are multiplied by"
            f" {factor:.4g})",
            "convert the rwa…_rpm columns to rev/min",
            replace(rows, wheel_rpm=factor * rows.wheel_rpm),
        )
    yield (
        "wheel rates that look like rev/min turned to rad/s twice (the balance closes once they are"
        f" multiplied by {RPM_RAD_S:.4g})",
        "convert the rwa…_rpm columns to rev/min",
        replace(rows, wheel_rpm=RPM_RAD_S * rows.wheel_rpm),
    )
    yield (
        "wheel rates of the opposite sign",
        "give wheel rates about the wheels' own axes as the spacecraft file has them",
        replace(rows, wheel_rpm=-rows.wheel_rpm),
    )
    own = tuple(range(len(event.wheels)))
    for order in permutations(own):
        if order != own:
            # column j of the file holds the wheel that stands at order[j]
            names = [event.wheels[i] for i in order]
            yield (
                f"columns of wheels {list(event.wheels)} that look like those of wheels {names}",
                "correct the names of the rwa…_rpm columns, or wheels in event.toml",
                replace(rows, wheel_rpm=rows.wheel_rpm[:, np.argsort(order)]),
            )
    for what, attitude in conventions(rows.attitude):
        yield what, "give J2000 → body, scalar last, in q1 to q4", replace(rows, attitude=attitude)


def _explain(
    event: TelemetryEvent,
    rows: Rows,
    spacecraft: Spacecraft,
    parameters: Mapping[str, float],
    found: Balance,
) -> None:
    """Name the mistake whose undoing closes the balance; or refuse a balance that is wide open."""
    others = [
        (_balance(event, other, spacecraft, parameters).misfit, what, fix)
        for what, fix, other in _alternatives(event, rows)
    ]
    misfit, what, fix = min(others)
    expected = "a momentum balance that closes at nominal values"
    if misfit < EXPLAINED * found.misfit and misfit < SUSPECT:
        raise InputError(
            str(event.telemetry),
            expected,
            f"{what} (misfit {misfit:.3g} instead of {found.misfit:.3g})",
            fix,
        )
    if found.misfit > BAD:
        raise InputError(
            str(event.telemetry),
            expected,
            f"{100.0 * found.unexplained:.3g} % of the exchanged momentum unexplained (misfit"
            f" {found.misfit:.3g}, good below {SUSPECT:g}); no exchange of columns or units helps",
            "check kind, branch and wheels in event.toml, the columns' order, signs and units, and"
            " that the nominal values are this spacecraft's",
        )
