"""The firing logic as a statistical model: opposing firings of the limit cycle, shared thruster.

What the wheels demand is met by one side of every axis (:mod:`.demand`). On top, both sides of an
axis fire against each other. Observed, without any physics, is the lesser side: of the couple axis
M_c = min of its two pairs; of the two ring axes together M_r (their sum is all that four thrusters
tell). With a the part of it that reversals of the demand explain, U the demand (s), D the duration

    E[M_c] = a_c + g (b0 + b1 D + b2 U_c),   E[M_r] = a_r + g (2 b0 + 2 b1 D + b2 U_r),

g log-normal with mean 1 and spread ``event_spread``, one per event; M is gamma distributed with
variance q (E[M] − a) + q min(a, q), q a quantum near one control cycle. The thruster that two
demands have in common fires alone in N cycles, negative binomial with mean c min(U_a, U_b) and
shape k. docs/topics/prediction.md derives it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import gammaln

from cassini_bayes.computing.arrays import Array
from cassini_bayes.prediction.beliefs import FIRING, Beliefs
from cassini_bayes.prediction.demand import PairLayout
from cassini_bayes.priors.parameter_space import ParameterSpace

Parameters = Mapping[str, Array | float]

NAMES: Final = tuple(FIRING)
LEAST_MINOR_S: Final = 0.005
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(15)
_LOG_WEIGHTS: Final = np.log(_WEIGHTS / _WEIGHTS.sum())


@dataclass(frozen=True)
class Features:
    """What the firing model knows of an event before it is flown; arrays (n,) over draws, s."""

    duration_s: Array
    reversal_ring_s: Array
    reversal_couple_s: Array
    demand_ring_s: Array
    demand_couple_s: Array
    common_s: Array  # the lesser of the two ring demands


@dataclass(frozen=True)
class Observation:
    """Data of the firing logic in the totals of one event, without physics."""

    minor_ring_s: float
    minor_couple_s: float
    shared_cycles: int


def firing_space(beliefs: Beliefs) -> ParameterSpace:
    """The walked parameters of the firing model in standard-normal coordinates."""
    return ParameterSpace(
        NAMES, {}, tuple(beliefs.distributions[name] for name in NAMES), ("firing",) * len(NAMES)
    )


def observe(on_time_s: Array, layout: PairLayout) -> Observation:
    """Lesser sides and shared cycles from the on-times (K,) of an event.

    With T_ij the ring's thrusters, i the sign about axis a and j about b: X = (Σ_j T_0j − T_1j)/2,
    Y likewise, v = surplus of the diagonal that holds the busiest thruster. Then
    M_r = (Σ T/2 − |X| − |Y|)/2 + v/4 and N = v over a control cycle.
    """
    ring = on_time_s[layout.ring]
    x, y = (ring[0] - ring[1]).sum() / 2.0, (ring[:, 0] - ring[:, 1]).sum() / 2.0
    surplus = ring[0, 0] + ring[1, 1] - ring[0, 1] - ring[1, 0]
    alone = max(float(surplus if x * y >= 0 else -surplus), 0.0)
    minor = (ring.sum() / 2.0 - abs(x) - abs(y)) / 2.0 + alone / 4.0
    pairs = [on_time_s[list(unit)].mean() for unit in layout.units[:2]]
    return Observation(
        minor_ring_s=max(float(minor), LEAST_MINOR_S),
        minor_couple_s=max(float(min(pairs)), LEAST_MINOR_S),
        shared_cycles=round(alone / layout.cycle_s),
    )


def expected_minor(p: Parameters, f: Features) -> tuple[Array, Array]:
    """Mean opposing on-time of the ring's axes together and of the couple axis, s, at g = 1."""
    per_axis = p["minor_constant_s"] + p["minor_per_duration"] * f.duration_s
    ring = 2.0 * per_axis + p["minor_per_demand"] * f.demand_ring_s
    couple = per_axis + p["minor_per_demand"] * f.demand_couple_s
    return np.asarray(ring), np.asarray(couple)


def _shape_scale(own: Array, reversal: Array, quantum: Array | float) -> tuple[Array, Array]:
    """Gamma shape and scale with mean reversal + own and the variance of the module's text."""
    mean = np.maximum(own + reversal, 1e-6)
    variance = np.maximum(quantum * (own + np.minimum(reversal, quantum)), 1e-9)
    return mean**2 / variance, variance / mean


def log_likelihood(p: Parameters, features: list[Features], seen: list[Observation]) -> Array:
    """Log density (n,) of all events' lesser sides and shared cycles, g integrated out."""
    total: Array = np.zeros(())
    for f, o in zip(features, seen, strict=True):
        ring, couple = expected_minor(p, f)
        spread = np.asarray(p["event_spread"])[..., None]
        restless = np.exp(spread * _NODES - 0.5 * spread**2)
        density = _LOG_WEIGHTS
        for firings, reversal, minor in (
            (ring, f.reversal_ring_s, o.minor_ring_s),
            (couple, f.reversal_couple_s, o.minor_couple_s),
        ):
            quantum = np.asarray(p["minor_quantum_s"])[..., None]
            shape, scale = _shape_scale(
                restless * firings[..., None], np.asarray(reversal)[..., None], quantum
            )
            density = density + (
                (shape - 1.0) * np.log(minor)
                - minor / scale
                - shape * np.log(scale)
                - gammaln(shape)
            )
        peak = density.max(-1, keepdims=True)
        total = total + peak[..., 0] + np.log(np.exp(density - peak).sum(-1))
        total = total + _shared_log_mass(p, f, o.shared_cycles)
    return total


def _shared_log_mass(p: Parameters, f: Features, cycles: int) -> Array:
    """Log probability of the shared cycles, negative binomial."""
    k = np.asarray(p["shared_shape"])
    mean = np.maximum(np.asarray(p["shared_per_demand"]) * f.common_s, 1e-9)
    return np.asarray(
        gammaln(k + cycles)
        - gammaln(k)
        - gammaln(cycles + 1.0)
        + k * np.log(k / (k + mean))
        + cycles * np.log(mean / (k + mean))
    )


@dataclass(frozen=True)
class FiringDraws:
    """Draws of a new event's opposing on-times and of the common thruster's own, each (n,) s."""

    minor_ring_s: Array
    minor_couple_s: Array
    shared_s: Array


def draw_firing(
    p: Parameters, f: Features, rng: np.random.Generator, cycle_s: float
) -> FiringDraws:
    """One draw per parameter point for a new event; ``cycle_s`` is the controller's period, s."""
    ring, couple = expected_minor(p, f)
    spread = np.asarray(p["event_spread"])
    restless = np.exp(spread * rng.standard_normal(ring.shape) - 0.5 * spread**2)
    minors = []
    for firings, reversal in ((ring, f.reversal_ring_s), (couple, f.reversal_couple_s)):
        shape, scale = _shape_scale(restless * firings, reversal, p["minor_quantum_s"])
        minors.append(rng.gamma(shape, scale))
    k = np.asarray(p["shared_shape"])
    mean = np.asarray(p["shared_per_demand"]) * f.common_s
    cycles = rng.poisson(mean * rng.gamma(k, 1.0 / k, size=ring.shape))
    return FiringDraws(minors[0], minors[1], np.asarray(cycle_s * cycles, dtype=np.float64))


def mean_firing(p: Parameters, f: Features, cycle_s: float) -> FiringDraws:
    """Expected values instead of draws: what is left when the limit cycle is switched off."""
    ring, couple = expected_minor(p, f)
    return FiringDraws(
        ring + f.reversal_ring_s,
        couple + f.reversal_couple_s,
        np.asarray(cycle_s * np.asarray(p["shared_per_demand"]) * f.common_s),
    )
