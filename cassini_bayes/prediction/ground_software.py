"""The ground-software method of paper 001, rebuilt: on-times of ideal thrusters, ΔV, hydrazine.

Once per sample the momentum that the wheels gained is given to thrusters: about the couple axis
(Z of Cassini) to the pair that pushes the right way, about the other two to the two single
thrusters that need least on-time (the paper's ten cases are the choices that this minimum makes).
Pulses are rectangular, so on-times add up. ΔV is eq. 22, hydrazine eqs. 19 and 21. The paper's
flight calibration (a gain array and a set of matrix equations) is not printed and not rebuilt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.prediction.demand import PairLayout, pair_layout
from cassini_bayes.prediction.requests import BiasRequest, request_of
from cassini_bayes.prediction.wheel_profile import WheelManager, duration_s, rates_rpm
from cassini_bayes.priors.reader import Priors
from cassini_bayes.spacecraft import (
    Spacecraft,
    lever_arms,
    thruster_directions,
    wheel_axes,
    wheel_inertias,
)
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

GRAVITY_M_S2: Final = 9.8065  # as printed in paper 001
TORQUE_LIMIT_N_M: Final = 0.03  # of the wheel manager (paper 001, section IV)
LOOP_S: Final = 16.5
SAMPLE_S: Final = 1.0
SPECIFIC_IMPULSE: Final = (160.0, 0.0, 0.0, 0.0, 0.0)
"""P0 … P4 of eq. 19, printed nowhere; 160 s is what both ground-software columns come near to."""

IMPLIED: Final = (
    "cm_x_m",
    "cm_y_m",
    "rwa1_inertia_kg_m2",
    "rwa2_inertia_kg_m2",
    "rwa4_inertia_kg_m2",
    "rwa4_tilt_u_rad",
    "rwa4_tilt_v_rad",
)


@dataclass(frozen=True)
class GroundInputs:
    """Input of the ground software: thrust (all thrusters alike), mass, parameters by name."""

    spacecraft: Spacecraft
    branch: str
    parameters: Mapping[str, float]
    thrust_n: float
    mass_kg: float
    specific_impulse: tuple[float, float, float, float, float] = SPECIFIC_IMPULSE


@dataclass(frozen=True)
class GroundPrediction:
    """Output of the method: on-times (K,) s, ΔV (3,) m/s in body axes, hydrazine, duration."""

    on_time_s: Array
    delta_v_m_s: Array
    hydrazine_g: float
    duration_s: float


def specific_impulse_s(duty_cycle: Array, p: tuple[float, float, float, float, float]) -> Array:
    """Paper 001 eq. 19: I_sp(μ) = P0 − P1 exp(−P2 μ) − P3 exp(−P4 μ), s."""
    mu = np.asarray(duty_cycle, dtype=np.float64)
    return np.asarray(p[0] - p[1] * np.exp(-p[2] * mu) - p[3] * np.exp(-p[4] * mu))


def ground_manager(inputs: GroundInputs) -> WheelManager:
    """Wheel manager with the printed torque limit and the loop time that durations imply."""
    inertia = wheel_inertias(inputs.spacecraft, inputs.parameters)
    ramps = {
        wheel.number: float(value) * RAD_S_PER_RPM / TORQUE_LIMIT_N_M
        for wheel, value in zip(inputs.spacecraft.wheels, inertia, strict=True)
    }
    return WheelManager(ramps, LOOP_S)


def ground_prediction(inputs: GroundInputs, request: BiasRequest) -> GroundPrediction:
    """The "ideal" column: rectangular pulses, no calibration."""
    layout = pair_layout(inputs.spacecraft, inputs.branch)
    manager = ground_manager(inputs)
    total = duration_s(manager, request.wheels, request.end_rpm - request.start_rpm)
    time = np.append(np.arange(0.0, total, SAMPLE_S), total)
    rates = rates_rpm(manager, request.wheels, request.start_rpm, request.end_rpm, time)
    rates[-1] = request.end_rpm
    momentum = wheel_momentum_n_m_s(inputs, request.wheels, rates)
    arms = lever_arms(inputs.spacecraft, inputs.branch, inputs.parameters) * inputs.thrust_n
    steps = np.diff(momentum, axis=0)
    on_time = ideal_on_times(steps, arms, layout).sum(0)
    directions = thruster_directions(inputs.spacecraft, inputs.branch)
    isp = specific_impulse_s(on_time / total, inputs.specific_impulse)
    return GroundPrediction(
        on_time_s=on_time,
        delta_v_m_s=np.asarray(directions @ on_time * inputs.thrust_n / inputs.mass_kg),
        hydrazine_g=float(1e3 * (inputs.thrust_n * on_time / isp).sum() / GRAVITY_M_S2),
        duration_s=total,
    )


def wheel_momentum_n_m_s(inputs: GroundInputs, wheels: tuple[int, ...], rates_rpm_: Array) -> Array:
    """Momentum of the wheels (N, 3) in body axes at rates (N, W) rev/min (eq. 16)."""
    numbers = [wheel.number for wheel in inputs.spacecraft.wheels]
    columns = [numbers.index(n) for n in wheels]
    axes = wheel_axes(inputs.spacecraft, inputs.parameters)[:, columns]
    inertia = wheel_inertias(inputs.spacecraft, inputs.parameters)[columns]
    return np.asarray(rates_rpm_ * RAD_S_PER_RPM * inertia @ axes.T)


def ideal_on_times(steps: Array, torque: Array, layout: PairLayout) -> Array:
    """On-times (…, N, K) ≥ 0 of samples from momentum steps (…, N, 3), torques (…, 3, K) N m."""
    result = np.zeros((*steps.shape[:-1], torque.shape[-1]))
    left = steps.copy()
    c = layout.couple_axis
    for unit, sign in zip(layout.units[:2], (-1.0, 1.0), strict=True):
        pair = torque[..., list(unit)].sum(-1)
        seconds = np.maximum(sign * steps[..., c], 0.0) / (sign * pair[..., c, None])
        result[..., list(unit)] += seconds[..., None]
        left = left - seconds[..., None] * pair[..., None, :]
    ring = layout.ring.ravel()
    axes = np.array(layout.ring_axes)
    least = np.full(steps.shape[:-1], np.inf)
    best = [np.zeros(steps.shape[:-1]) for _ in ring]
    for pair_of_ring in combinations(range(len(ring)), 2):
        columns = ring[list(pair_of_ring)]
        inverse = np.linalg.inv(torque[..., axes[:, None], columns])
        seconds = left[..., axes] @ np.swapaxes(inverse, -1, -2)
        # two columns by name: reductions over so short an axis are slow
        one, other = seconds[..., 0], seconds[..., 1]
        better = (one >= -1e-12) & (other >= -1e-12) & (one + other < least)
        least = np.where(better, one + other, least)
        fired = dict(zip(pair_of_ring, (one, other), strict=True))
        for place, before in enumerate(best):
            best[place] = np.where(better, np.maximum(fired.get(place, 0.0), 0.0), before)
    result[..., ring] += np.stack(best, axis=-1)
    return result


def prior_parameters(priors: Priors) -> dict[str, float]:
    """Mean of every prior, value of every fixed parameter."""
    return priors.means()


def implied_parameters(
    printed: Sequence[TotalsEvent],
    spacecraft: Spacecraft,
    branch: str,
    start: Mapping[str, float],
) -> dict[str, float]:
    """Inputs that the printed ideal on-times imply: least squares over :data:`IMPLIED`."""
    from scipy.optimize import least_squares

    first = [unit[0] for unit in pair_layout(spacecraft, branch).units]
    centre = np.array([start[name] for name in IMPLIED])
    scale = np.where(np.abs(centre) > 0.0, 0.05 * np.abs(centre), 0.01)

    def values(x: Array) -> dict[str, float]:
        moved = (centre + scale * x).tolist()
        return {**start, **dict(zip(IMPLIED, moved, strict=True))}

    def misses(x: Array) -> Array:
        parameters, result = values(x), []
        for event in printed:
            assert event.thrust_predicted_n is not None
            assert event.mass_kg is not None
            inputs = GroundInputs(
                spacecraft, branch, parameters, event.thrust_predicted_n, event.mass_kg
            )
            rebuilt = ground_prediction(inputs, request_of(event))
            result.append((rebuilt.on_time_s - event.on_time_s)[first])
        return np.concatenate(result)

    return values(least_squares(misses, np.zeros(len(IMPLIED)), diff_step=1e-3).x)
