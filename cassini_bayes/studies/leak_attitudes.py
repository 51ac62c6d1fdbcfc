"""When a change of attitude separates a leak from a steady torque.

A leak turns with the body, a torque of the Sun or of gravity stays with inertial axes. At one
attitude both add momentum in one fixed direction, and no telemetry tells one from the other; nor
does a turn, where the torque turns with the body. Here a body stays at one attitude, turns by ψ
across the leak's torque in no time, and stays at the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.priors.reader import Priors
from cassini_bayes.studies.leak_monitors import HALF_ROWS, ROWS_EVERY_S

LEVER_M: Final = 1.6  # of Cassini's leaks, 1 to 3 m
LEAK_N: Final = 1e-4
STAY_S: Final = 1000.0
TURNS_DEG: Final = (0.0, 5.0, 30.0, 90.0, 180.0)
STAYS_S: Final = (500.0, 1000.0, 3600.0)
CLEAR_SIGMA: Final = 5.0


@dataclass(frozen=True)
class MomentumNoise:
    """Noise of momentum at a row, N m s, and of the torque that nothing explains, N m s^½."""

    row_n_m_s: float
    walk_n_m_s05: float


def momentum_noise(priors: Priors) -> MomentumNoise:
    """Of turns over the monitors' stretches at 1 Hz, about the axis of greatest inertia."""
    means = {name: prior.mean for name, prior in priors.parameters.items()}
    inertia = max(means[f"inertia_{axis}_kg_m2"] for axis in ("xx", "yy", "zz"))
    rate = np.sqrt(2.0) * means["attitude_noise_rad"] / (2 * HALF_ROWS)
    return MomentumNoise(float(inertia * rate), means["torque_noise_n_m_s05"])


def separation_sigma(
    torque_n_m: float, turn_rad: float, before_s: float, after_s: float, noise: MomentumNoise
) -> float:
    """By how many σ a leak differs from the likest torque fixed in inertial axes.

    With u and v the unit vectors of the leak's torque before and after the turn, its momentum is
    τ (u t + (v − u) max(t − t₁, 0)): an inertial torque and the unknown start are free to take up
    any line in t, and what is left of the hinge has the size |v − u| = 2 sin(ψ/2). So

        σ = 2 τ sin(ψ/2) (gᵀ C⁻¹ g)^½,

    g what a line leaves of the hinge at rows ten seconds apart, C row noise and random walk.
    """
    return 2.0 * torque_n_m * float(np.sin(0.5 * abs(turn_rad))) * _hinge(before_s, after_s, noise)


@cache
def _hinge(before_s: float, after_s: float, noise: MomentumNoise) -> float:
    """What a line leaves of a hinge after ``before_s``, in noise: (gᵀ C⁻¹ g)^½, 1/(N m)."""
    time = np.arange(0.0, before_s + after_s + 1e-9, ROWS_EVERY_S)
    covariance = noise.row_n_m_s**2 * np.eye(len(time))
    covariance += noise.walk_n_m_s05**2 * np.minimum(time[:, None], time)
    lower = np.linalg.cholesky(covariance)
    hinge = np.linalg.solve(lower, np.maximum(time - before_s, 0.0))
    line = np.linalg.solve(lower, np.stack([np.ones_like(time), time], axis=1))
    left = hinge - line @ np.linalg.lstsq(line, hinge)[0]
    return float(np.linalg.norm(left))


def least_leak_n(turn_rad: float, stay_s: float, noise: MomentumNoise) -> float:
    """The leak that stays of this length at either attitude tell from a torque, clearly."""
    return CLEAR_SIGMA / separation_sigma(LEVER_M, turn_rad, stay_s, stay_s, noise)


def after_turns(noise: MomentumNoise) -> pd.DataFrame:
    """σ of :data:`LEAK_N` against time after the turn, :data:`STAY_S` before it, per turn."""
    return pd.DataFrame(
        [
            {"turn_deg": turn, "after_s": after, "sigma": sigma}
            for turn in TURNS_DEG
            for after in np.arange(20.0, 2.0 * STAY_S + 1.0, 20.0)
            for sigma in [
                separation_sigma(LEVER_M * LEAK_N, np.radians(turn), STAY_S, after, noise)
            ]
        ]
    )


def least_leaks(noise: MomentumNoise) -> pd.DataFrame:
    """The least leak told apart, N, against the turn, per stay."""
    return pd.DataFrame(
        [
            {
                "stay_s": stay,
                "turn_deg": turn,
                "leak_n": least_leak_n(np.radians(turn), stay, noise),
            }
            for stay in STAYS_S
            for turn in np.geomspace(2.0, 180.0, 40)
        ]
    )


def clear_after_s(table: pd.DataFrame) -> dict[float, float]:
    """Per turn the first time of :func:`after_turns` at which the two are apart; NaN if never."""
    return {
        float(turn): float(rows.loc[rows["sigma"] >= CLEAR_SIGMA, "after_s"].min())
        for turn, rows in table.groupby("turn_deg")
    }


def turn_cells(table: pd.DataFrame) -> list[tuple[float, float, float]]:
    """Rows of turn, seconds after it until :data:`CLEAR_SIGMA`, σ after :data:`STAY_S`."""
    clear = clear_after_s(table)
    at_stay = table[np.isclose(table["after_s"], STAY_S)].set_index("turn_deg")["sigma"]
    return [(turn, clear[turn], float(at_stay[turn])) for turn in TURNS_DEG]
