"""Two wheels that hold two body axes: what they do to the third (paper 004 §VII, §VIII, App. C, D).

Two wheels give any torque about two axes, and with it an unwanted one about the third.
Where the third axis is free (the spin of §VIII), the body takes up that momentum: its spin rate
swings once per turn, and with it the wheels' rates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.errors import InputError

HELD_AXES: Final[Mapping[str, tuple[int, int]]] = MappingProxyType({"ors": (0, 2), "dfpw": (0, 1)})
"""Body axes that two wheels hold: X and Z in remote sensing (§VII), X and Y in downlink and fields
(§VIII). The thrusters have the third."""

LEAST_SINGULAR_VALUE: Final = 0.003
"""Of the two wheels' directions on the held axes. Below it (about a degree of articulation from a
singular angle) a torque about the worst axis takes more than three hundred times that of wheels."""


def free_axis(controller: str) -> int:
    """The body axis that the wheels of a hybrid controller leave to the thrusters."""
    return next(axis for axis in range(3) if axis not in HELD_AXES[controller])


def wheel_torques(axes: Array, controller: str, where: str) -> Array:
    """Torque of each wheel per torque about the held axes (2, 2), the inverse of 004's A or B.

    Parameters
    ----------
    axes
        Spin axes (3, 2) of the two wheels in body axes, as columns.
    controller
        Key of :data:`HELD_AXES`.
    where
        What messages call the place that the angle comes from.

    Raises
    ------
    InputError
        Not two wheels, or two whose axes lie in one plane with the free axis: their momentum has
        one direction only on the held axes (paper 004: at 60° and 120° for ``ors``, at −60° and
        120° for ``dfpw``).
    """
    held = HELD_AXES[controller]
    names = " and ".join("XYZ"[axis] for axis in held)
    if axes.shape[-1] != 2:
        raise InputError(
            where,
            f"two wheels to hold {names}",
            f"{axes.shape[-1]} wheel{'s' if axes.shape[-1] != 1 else ''}",
            "name two prime wheels, e.g. wheels = [2, 4]",
        )
    on_held = axes[list(held)]
    if float(np.linalg.svd(on_held, compute_uv=False)[-1]) < LEAST_SINGULAR_VALUE:
        raise InputError(
            where,
            f"wheels whose momentum has two directions on {names}",
            f"axes that lie in one plane with {'XYZ'[free_axis(controller)]}",
            "turn the platform away from this singular angle, or choose other wheels",
        )
    return np.asarray(np.linalg.inv(on_held), dtype=np.float64)


def torque_coupling(axes: Array, controller: str, where: str = "wheels") -> Array:
    """Unwanted torque about the free axis per torque about each held one (2,), eqs. (3, 4, 9, 10).

    For ``dfpw`` these are p_X and p_Y of eq. (14).

    Raises
    ------
    InputError
        As :func:`wheel_torques`.
    """
    inverse = wheel_torques(axes, controller, where)
    return np.asarray(axes[free_axis(controller)] @ inverse)


@dataclass(frozen=True)
class SpinModulation:
    """A body that spins about its free Z axis while two wheels hold X and Y (eqs. 13-19, App. C).

    The wheels' momentum on X and Y keeps its direction in inertial axes, so on the body it turns
    backwards, H(α) with α the body's angle; what they have on Z goes with it, p·H, and the body
    takes up the difference:

        Ω = Ω0 + [K1 (1 − cos α) + K2 sin α]/I_zz = G1 + G2 cos(α + ε),
        K1 = p_X H_X + p_Y H_Y,  K2 = p_Y H_X − p_X H_Y,  ε = atan2(K2, K1),
        G1 = Ω0 + K1/I_zz,  G2 = −(K1² + K2²)^½/I_zz.

    Assumed: X and Y do not turn, no external torque, products of inertia without effect on Z.

    Parameters
    ----------
    inertia_kg_m2
        I_zz.
    rate_rad_s
        Ω0, the rate at α = 0.
    coupling
        p (2,), of :func:`torque_coupling`.
    momentum_n_m_s
        The wheels' H_X and H_Y (2,) at α = 0.
    where
        What an error names.

    Raises
    ------
    InputError
        |G2| ≥ G1: the spin stops before it has come round.
    """

    inertia_kg_m2: float
    rate_rad_s: float
    coupling: tuple[float, float]
    momentum_n_m_s: tuple[float, float]
    where: str = "momentum of the wheels"

    def __post_init__(self) -> None:
        if abs(self.g2) >= self.g1:
            raise InputError(
                self.where,
                "a momentum small enough for the spin to come round: |G2| < G1",
                f"G1 = {self.g1:.3g} and |G2| = {abs(self.g2):.3g} rad/s, so that the rate falls to"
                " zero before a turn is complete",
                "spin faster, or start with less momentum or one along the other sense of K1",
            )

    @property
    def k1(self) -> float:
        """K1 of eq. (C2), N m s."""
        (p_x, p_y), (h_x, h_y) = self.coupling, self.momentum_n_m_s
        return p_x * h_x + p_y * h_y

    @property
    def k2(self) -> float:
        """K2 of eq. (C2), N m s."""
        (p_x, p_y), (h_x, h_y) = self.coupling, self.momentum_n_m_s
        return p_y * h_x - p_x * h_y

    @property
    def g1(self) -> float:
        """G1 of eq. (C6), rad/s: half way between the greatest and the least rate."""
        return self.rate_rad_s + self.k1 / self.inertia_kg_m2

    @property
    def g2(self) -> float:
        """G2 of eq. (C6), rad/s: minus half of what the rate swings."""
        return -float(np.hypot(self.k1, self.k2)) / self.inertia_kg_m2

    @property
    def phase_rad(self) -> float:
        """ε of eq. (C3), in the quadrant that the signs of K1 and K2 give."""
        return float(np.arctan2(self.k2, self.k1))

    @property
    def greatest_change_rad_s(self) -> float:
        """ΔΩ_Z[max] of eq. (15)."""
        return self.k1 / self.inertia_kg_m2 - self.g2

    @property
    def least_change_rad_s(self) -> float:
        """ΔΩ_Z[min] of eq. (15)."""
        return self.k1 / self.inertia_kg_m2 + self.g2

    @cached_property
    def mean_rate_rad_s(self) -> float:
        """Ω_Avg of eq. (19): a turn over its time, (G1² − G2²)^½."""
        return float(np.sqrt(self.g1**2 - self.g2**2))

    @property
    def period_s(self) -> float:
        """Time of a turn, eq. (18)."""
        return 2.0 * np.pi / self.mean_rate_rad_s

    def angle_rad(self, time_s: ArrayLike) -> Array:
        """α (…) at times (…): eq. (17), counted on from turn to turn, with α(0) = 0.

        As printed, eq. (17) has α(0) = −ε: its time counts from where α + ε = 0.
        """
        ratio = self.mean_rate_rad_s / (self.g1 - self.g2)
        start = np.arctan(np.tan(0.5 * self.phase_rad) / ratio)
        half_turns = 0.5 * self.mean_rate_rad_s * np.asarray(time_s, dtype=np.float64) + start
        turns = np.round(half_turns / np.pi)
        within = np.arctan(ratio * np.tan(half_turns - turns * np.pi))
        return np.asarray(2.0 * (within + turns * np.pi) - self.phase_rad)

    def rate_at_rad_s(self, angle_rad: ArrayLike) -> Array:
        """Ω_Z (…) at angles α (…), eq. (14)."""
        angle = np.asarray(angle_rad, dtype=np.float64)
        change = self.k1 * (1.0 - np.cos(angle)) + self.k2 * np.sin(angle)
        return np.asarray(self.rate_rad_s + change / self.inertia_kg_m2)

    def held_momentum_n_m_s(self, angle_rad: ArrayLike) -> Array:
        """The wheels' momentum on X and Y (…, 2) at angles α (…), eq. (13)."""
        angle = np.asarray(angle_rad, dtype=np.float64)
        h_x, h_y = self.momentum_n_m_s
        return np.stack(
            [
                h_x * np.cos(angle) + h_y * np.sin(angle),
                h_y * np.cos(angle) - h_x * np.sin(angle),
            ],
            axis=-1,
        )


def peak_wheel_momentum(axes: Array, momentum_n_m_s: ArrayLike, where: str = "wheels") -> Array:
    """Greatest momentum (2,) of each wheel about its axis over a turn, eqs. (16, C7-C9), N m s.

    A wheel's momentum is a fixed row of the inverse times a vector of fixed length that turns, so
    its peak depends on the size of that vector alone.

    Raises
    ------
    InputError
        As :func:`wheel_torques`.
    """
    rows = np.linalg.norm(wheel_torques(axes, "dfpw", where), axis=1)
    return np.asarray(rows * np.linalg.norm(np.asarray(momentum_n_m_s, dtype=np.float64)))


def spin_propellant_kg(
    inertia_kg_m2: float, rate_rad_s: float, lever_m: float, exhaust_velocity_m_s: float
) -> float:
    """Propellant to spin up by a couple and down again, 2 I Ω/(L v) (paper 004 Table 3 note c)."""
    return 2.0 * inertia_kg_m2 * rate_rad_s / (lever_m * exhaust_velocity_m_s)
