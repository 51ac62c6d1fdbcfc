"""What momentum is made of, what may depart from it and at what price, and what may be mistaken.

Each channel of the balance (:mod:`.momentum`) has columns of its own. A mistake is another set of
weights on them, and so is each departure: the catalogue of effects, and a torque that nothing
explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.events.plausibility.rows import Rows
from cassini_bayes.spacecraft import (
    Spacecraft,
    inertia_tensor,
    lever_arms,
    thruster_directions,
    wheel_axes,
    wheel_inertias,
)
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

WIDTHS: Final[Mapping[str, float]] = {
    "inertia": 0.05,  # of the mean moment of inertia, each element
    "wheel": 0.02,  # of the spin inertia, along and across each spin axis
    "common": 0.15,  # of the thrust, all thrusters alike
    "thrust": 0.2,  # of a thruster's torque
    "cant": 0.05,  # of a thruster's torque, each axis
    "centre": 0.1,  # m, each axis
    "tail": 0.1,  # s of thrust per pulse, all thrusters alike
    "own tail": 0.03,  # s of thrust per pulse, each thruster
    "warm-up": 0.25,  # of the thrust, while a thruster's bed is cold
    "lag": 1.0,  # s of the counters
    "torque": 0.003,  # N m, each axis: a leak of a few mN
    "bias": 2e-5,  # rad/s of every rate, and no more than turns of the attitude leave
    "drift": 0.002,  # N m s per √s, each axis: torque that nothing catalogued explains
    "cut": 0.02,  # s of thrust, cut off the tail of each pulse that another may follow at once
    "swing": 2e-5,  # rad/s of a boom's oscillation, where one is looked for
}
"""One standard deviation of what may depart from the nominal values: the catalogue of effects, five
to ten times the published uncertainties; drift: twice the median of `unknown`
there, as a mistake that explains more than a torque of nobody's catalogue has to win against it."""
DRIFT_MODES: Final = 24
"""Of a torque that wanders: with 12, what a strong one has left was no noise (by trial)."""
CUT_MODES: Final = 24  # of a walk with every pulse: as many as of the torque's
SWING_MODES: Final = 4  # cosine and sine, each of even and of growing amplitude


@dataclass(frozen=True, eq=False)
class Nominal:
    """What momentum is made of at nominal values, for one event's wheels and thrusters."""

    inertia: Array  # (3, 3) kg m²
    spins: Array  # (3, W) N m s per rad/s of each wheel
    torques: Array  # (3, K) N m of each thruster
    pushes: Array  # (3, K) N of each thruster
    tail_s: float  # of thrust that a pulse delivers beyond its width
    wheel_names: tuple[str, ...]  # (W,) prefixes of their columns, for messages

    @classmethod
    def of(
        cls,
        spacecraft: Spacecraft,
        branch: str,
        wheels: Sequence[int],
        parameters: Mapping[str, float],
        *,
        fires: bool,
    ) -> Nominal:
        """From parameters by name; events that do not fire need none of the thrusters'."""
        places = [spacecraft.wheel_numbers.index(number) for number in wheels]
        spins = wheel_axes(spacecraft, parameters) * wheel_inertias(spacecraft, parameters)
        torques = pushes = np.zeros((3, 0))
        if fires:
            force = parameters["thrust_common_n"]
            torques = force * lever_arms(spacecraft, branch, parameters)
            pushes = force * thruster_directions(spacecraft, branch)
        tail_s = parameters.get("tau_fall_s", 0.0) - parameters.get("tau_rise_s", 0.0)
        names = tuple(spacecraft.wheels[place].name for place in places)
        return cls(inertia_tensor(parameters), spins[:, places], torques, pushes, tail_s, names)

    def of_wheels(self, wheel_rpm: Array) -> Array:
        """Momentum (n, 3), N m s, of wheels at rates (n, W) in rev/min."""
        return np.asarray(RAD_S_PER_RPM * wheel_rpm @ self.spins.T)

    def thrust_s(self, rows: Rows) -> Array:
        """Seconds (n, K) of steady thrust that counters show: on-times and tails."""
        return np.asarray(rows.on_time_s + self.tail_s * rows.pulses)

    @cached_property
    def columns(self) -> Columns:
        """Places of the channels' columns."""
        return Columns(self.spins.shape[1], self.torques.shape[1])

    @cached_property
    def exchanges(self) -> Array:
        """Weights of what is to be explained, with thrusters as they are and exchanged."""
        return targets_of(self)

    @cached_property
    def departures(self) -> tuple[tuple[str, ...], Array]:
        """Names and weights of what may depart."""
        return nominal_departures(self)


@dataclass(frozen=True, eq=False)
class Correction:
    """What recorded channels have to be multiplied by to be true, and what is free besides.

    ``offset`` (3, J): body axes along which a constant momentum is free, as of a wheel's rate with
    a constant error; ``wheel_factor``: wheels whose column has a free factor;
    ``wheel_jump``: wheels with a constant error from their largest jump on; ``wheel_lag``: whether
    all wheels come late by some time, to first order;
    ``on_time``: factor of on-times, not of pulses.
    """

    rate: Array  # (3, 3)
    wheel: Array  # (W, W)
    thruster: Array  # (K, K)
    offset: Array = field(default_factory=lambda: np.zeros((3, 0)))
    wheel_factor: tuple[int, ...] = ()
    wheel_jump: tuple[int, ...] = ()
    wheel_lag: bool = False
    on_time: float = 1.0

    @classmethod
    def nothing(cls, nominal: Nominal) -> Correction:
        """Everything as recorded, of these wheels and thrusters."""
        wheels, thrusters = nominal.spins.shape[1], nominal.torques.shape[1]
        return cls(np.eye(3), np.eye(wheels), np.eye(thrusters))

    @property
    def is_free(self) -> bool:
        """Whether a size is free."""
        return bool(self.offset.shape[1] or self.wheel_factor or self.wheel_jump or self.wheel_lag)


def exchanged(order: Array, pairs: Sequence[tuple[int, int]]) -> Array:
    """A matrix of channels with pairs of its rows exchanged."""
    rows = list(range(len(order)))
    for a, b in pairs:
        rows[a], rows[b] = rows[b], rows[a]
    return np.asarray(order[rows])


FREE: Final = 30.0
"""Standard deviation of a free factor, and of a free offset in N m s: as good as none."""


class Columns:
    """Which columns of the Gram matrix belong to which channel, three axes each."""

    def __init__(self, wheels: int, thrusters: int) -> None:
        sizes = {
            "rate": 3,
            "wheel": wheels,
            "rate around": 3,
            "wheel around": wheels,
            "fire beside": thrusters,
            "fire": thrusters,
            "pulse": thrusters,
            "warm up": thrusters,
            "flow": thrusters,
            "torque": 1,
            "fixed": 1,
            "bias": 1,
            "jump": wheels,
            "wheel flow": wheels,
            "drift": DRIFT_MODES,
            "cut": CUT_MODES,
            "swing": SWING_MODES,
        }
        ends = 3 * np.cumsum(list(sizes.values()))
        starts = [0, *ends[:-1].tolist()]
        self.of = {
            name: slice(start, int(end))
            for name, start, end in zip(sizes, starts, ends, strict=True)
        }
        self.size = int(ends[-1])

    def weights(self, **blocks: Array) -> Array:
        """A weight vector: ``blocks`` by channel, (3, number) each, blanks as underscores."""
        vector = np.zeros(self.size)
        for name, block in blocks.items():
            vector[self.of[name.replace("_", " ")]] = block.ravel()
        return vector


def corrected(columns: Columns, weights: Array, correction: Correction) -> Array:
    """Weights (p, J) on true channels as weights on what was recorded: true = matrix · recorded."""
    result = weights.copy()
    for name, matrix in (
        ("rate", correction.rate),
        ("rate around", correction.rate),
        ("wheel", correction.wheel),
        ("wheel around", correction.wheel),
        ("fire beside", correction.on_time * correction.thruster),
        ("fire", correction.on_time * correction.thruster),
        ("pulse", correction.thruster),
        ("warm up", correction.on_time * correction.thruster),
        ("flow", correction.on_time * correction.thruster),
    ):
        block = weights[columns.of[name]].reshape(3, len(matrix), weights.shape[1])
        moved = np.einsum("anj,nm->amj", block, matrix)
        result[columns.of[name]] = moved.reshape(3 * len(matrix), weights.shape[1])
    return result


def exchanges_of(nominal: Nominal) -> list[tuple[tuple[int, int], ...]]:
    """Pairs of thrusters that may be exchanged, and two pairs at once of those that push alike."""
    pairs = list(combinations(range(nominal.torques.shape[1]), 2))
    pushes = nominal.pushes.T
    same, against = (np.isclose(pushes[:, None], each) for each in (pushes, -pushes))
    alike = np.asarray(same.all(axis=-1) | against.all(axis=-1))
    both = [
        (a, b)
        for a, b in combinations(pairs, 2)
        if not set(a) & set(b) and all(alike[a[0], k] for k in (*a, *b))
    ]
    return [*((pair,) for pair in pairs), *both]


def targets_of(nominal: Nominal) -> Array:
    """Weights (p, 1 + exchanges) of the total momentum less what nominal thrusters brought.

    First as it is, then with thrusters exchanged.
    """
    orders = [np.eye(nominal.torques.shape[1])]
    orders += [exchanged(orders[0], pairs) for pairs in exchanges_of(nominal)]
    brought = [-nominal.torques @ order for order in orders]
    whole = nominal.columns.weights(rate=nominal.inertia, wheel=nominal.spins)
    return np.stack([whole + impulse_of(nominal, each) for each in brought], axis=1)


def impulse_of(nominal: Nominal, torques: Array) -> Array:
    """Weights (p,) of what thrusters of these torques (3, K) bring: on-times and tails."""
    return nominal.columns.weights(fire=torques, pulse=nominal.tail_s * torques)


def departures_of(nominal: Nominal, correction: Correction) -> tuple[tuple[str, ...], Array]:
    """Names and weights (p, J) of everything that may depart, each at one standard deviation."""
    names, design = nominal.departures
    free = free_columns(nominal, correction)
    if free:
        names += tuple(name for name, _ in free)
        sizes = np.stack([FREE * weights for _, weights in free], axis=1)
        design = np.concatenate([design, sizes], axis=1)
    return names, corrected(nominal.columns, design, correction)


def free_columns(nominal: Nominal, correction: Correction) -> list[tuple[str, Array]]:
    """Names and weights (p,) of what a correction leaves free, at a size of 1."""
    columns, wheels = nominal.columns, np.eye(len(correction.wheel))
    free = [("offset", columns.weights(fixed=axis)) for axis in correction.offset.T]
    for w in correction.wheel_factor:
        own = np.outer(nominal.spins[:, w], wheels[w])
        free.append(("factor", columns.weights(wheel_around=own)))
    for w in correction.wheel_jump:
        spin = nominal.spins[:, w] / np.linalg.norm(nominal.spins[:, w])
        free.append(("jump", columns.weights(jump=np.outer(spin, wheels[w]))))
    if correction.wheel_lag:
        free.append(("lag", columns.weights(wheel_flow=nominal.spins)))
    return free


def nominal_departures(nominal: Nominal) -> tuple[tuple[str, ...], Array]:
    """Names and weights (p, J) of the departures of true channels."""
    columns, each = nominal.columns, []
    size = float(np.trace(nominal.inertia)) / 3.0
    for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        unit = np.zeros((3, 3))
        unit[a, b] = unit[b, a] = WIDTHS["inertia"] * size
        turned = unit @ np.linalg.solve(nominal.inertia, nominal.torques)
        each.append(("inertia", columns.weights(rate_around=unit, fire_beside=turned)))
    for spin, one in zip(nominal.spins.T, np.eye(nominal.spins.shape[1]), strict=True):
        for axis in np.eye(3):
            moved = WIDTHS["wheel"] * np.linalg.norm(spin) * axis
            each.append(("wheel", columns.weights(wheel_around=np.outer(moved, one))))
    if nominal.torques.shape[1]:
        each += _thruster_departures(nominal)
    for axis in np.eye(3):
        each.append(("torque", columns.weights(torque=WIDTHS["torque"] * axis)))
        each.append(("bias", columns.weights(bias=size * axis)))
        for mode in np.eye(DRIFT_MODES):
            wandered = WIDTHS["drift"] * np.outer(axis, mode)
            each.append(("drift", columns.weights(drift=wandered)))
        for mode in np.eye(CUT_MODES):
            cut = columns.weights(cut=WIDTHS["cut"] * np.outer(axis, mode))
            each.append(("cut", cut))
        for mode in np.eye(SWING_MODES):
            swing = columns.weights(swing=WIDTHS["swing"] * size * np.outer(axis, mode))
            each.append(("swing", swing))
    names, vectors = zip(*each, strict=True)
    return names, np.stack(vectors, axis=1)


def _thruster_departures(nominal: Nominal) -> list[tuple[str, Array]]:
    columns = nominal.columns
    each = [
        ("common", impulse_of(nominal, WIDTHS["common"] * nominal.torques)),
        ("tail", columns.weights(pulse=WIDTHS["tail"] * nominal.torques)),
        ("lag", columns.weights(flow=WIDTHS["lag"] * nominal.torques)),
    ]
    for axis in np.eye(3):
        moved = WIDTHS["centre"] * np.cross(axis, nominal.pushes, axisb=0, axisc=0)
        each.append(("centre", impulse_of(nominal, moved)))
    for one, torque in zip(np.eye(nominal.torques.shape[1]), nominal.torques.T, strict=True):
        own = np.outer(torque, one)
        each.append(("own tail", columns.weights(pulse=WIDTHS["own tail"] * own)))
        each.append(("warm-up", columns.weights(warm_up=WIDTHS["warm-up"] * own)))
        each.append(("thrust", impulse_of(nominal, WIDTHS["thrust"] * own)))
        for axis in np.eye(3):
            moved = WIDTHS["cant"] * np.linalg.norm(torque) * axis
            each.append(("cant", impulse_of(nominal, np.outer(moved, one))))
    return each
