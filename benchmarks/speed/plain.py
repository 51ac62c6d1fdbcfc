"""The plain likelihood: every row's density, nothing integrated out, no Gram matrices.

One function for numpy and for JAX: ``xp`` is the array module, ``special`` its special functions.
All unknowns are sampled, each with an N(0, 1) prior: walked parameters z, the event's thrusts, its
initial momentum, torque and cut tails, and with torque noise the amplitudes of its cosines.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from cassini_bayes.distributions import Distribution
from cassini_bayes.event_reduction import ReducedEvent, samples_of
from cassini_bayes.joint import JointModel
from cassini_bayes.physics import INERTIA_PARAMETERS
from cassini_bayes.spacecraft.description import CENTRE_OF_MASS
from cassini_bayes.statistics import Carry, settle
from cassini_bayes.statistics.columns import CUT_PARTS
from cassini_bayes.telemetry import load_event
from cassini_bayes.telemetry_terms import (
    CONTROL_CYCLE_S,
    INITIAL_SD_N_M_S,
    TelemetryTerms,
    cut_probability,
)
from cassini_bayes.terms import RAD_S_PER_RPM

Values = Any  # arrays of either module
MODES = 32


@dataclass(frozen=True)
class Problem:
    """One bias: the model, and its rows as columns."""

    model: JointModel
    terms: TelemetryTerms
    vector: Values  # (3 n, V)
    scalar: Values  # (n, S)
    waves: Values  # (n, M) scaled cosines, for unit torque noise
    has_noise: bool
    thrust_factor: Values  # (K, K) of the prior covariance of this event's thrusts

    @property
    def size(self) -> int:
        """Number of unknowns that are sampled."""
        return len(self.model.space.names) + self.linear_size

    @property
    def linear_size(self) -> int:
        """Of these, the ones that our own likelihood integrates out."""
        k, cuts = self.terms.pattern.thrusters, len(self.terms.pattern.cuts)
        return k + 6 + cuts + (3 * MODES if self.has_noise else 0)


def make_problem(model: JointModel, event: ReducedEvent, has_noise: bool) -> Problem:
    """Rows of an event for the plain likelihood."""
    samples = samples_of(load_event(event.event, model.spacecraft))
    layout = event.statistics.layout
    rows, _ = settle(samples, Carry.start(layout), layout, event.sampling, final=True)
    n, duration = len(rows.time_s), event.statistics.duration_s
    order = np.arange(1, MODES + 1)
    waves = np.cos(np.pi * rows.time_s[:, None] / duration * order)
    own, shared = model.linear.own, model.linear.shared
    return Problem(
        model=model,
        terms=model.telemetry[0],
        vector=rows.vector.reshape(3 * n, -1),
        scalar=rows.scalar,
        waves=waves * np.sqrt(2.0 * duration) / (order * np.pi),
        has_noise=has_noise,
        thrust_factor=np.linalg.cholesky(own @ own.T + shared @ shared.T),
    )


def log_posterior(xp: ModuleType, special: Any, problem: Problem, x: Values) -> Values:
    """Log density of the data and of everything sampled, at one point x."""
    parameters, unknowns = unpacked(xp, special, problem, x)
    residual, noise, weights, spread = balance(xp, problem, parameters, unknowns)
    if problem.has_noise:
        amplitudes = x[-3 * MODES :].reshape(-1, 3)
        residual = residual - parameters["torque_noise_n_m_s05"] * (problem.waves @ amplitudes)
    rows = len(problem.scalar)
    whitened = residual @ xp.linalg.inv(noise)
    log_likelihood = -0.5 * xp.sum(whitened * residual) + rows * (
        -0.5 * xp.linalg.slogdet(noise)[1]
        + 0.5 * xp.linalg.slogdet(weights @ weights.T)[1]
        - 0.5 * spread
        - 3.0 * np.log(2.0 * np.pi)
    )
    return log_likelihood - 0.5 * xp.sum(x**2) - 0.5 * len(x) * np.log(2.0 * np.pi)


def unpacked(
    xp: ModuleType, special: Any, problem: Problem, x: Values
) -> tuple[dict[str, Values], tuple[Values, ...]]:
    """Parameters, and (thrusts, initial momentum, torque, cut tails) at a point."""
    d, k = len(problem.model.space.names), problem.terms.pattern.thrusters
    white = x[d:]
    unknowns = (
        problem.model.linear.common_mean_n + problem.thrust_factor @ white[:k],
        problem.terms.initial_mean_n_m_s + INITIAL_SD_N_M_S * white[k : k + 3],
        problem.model.torque_mean_n_m + problem.model.torque_sd_n_m * white[k + 3 : k + 6],
        white[k + 6 : k + 6 + len(problem.terms.pattern.cuts)],
    )
    return to_parameters(xp, special, problem.model, x[:d]), unknowns


def balance(
    xp: ModuleType, problem: Problem, parameters: dict[str, Values], unknowns: tuple[Values, ...]
) -> tuple[Values, Values, Values, Values]:
    """Residual (n, 3) of every row, its covariance, the wheels' weights, and the rates' density."""
    terms, layout = problem.terms, problem.terms.statistics.layout
    thrust, start, torque, tails = unknowns
    inertia, weights, arms, (rise, fall) = physics(xp, problem, parameters)
    variance = parameters["rate_noise_rad_s"] ** 2
    total = xp.maximum(terms.rate_values, variance)
    kept = (terms.rate_vectors * (1.0 - variance / total)) @ terms.rate_vectors.T
    spread = xp.sum(xp.log(total) + terms.rate_values / total)
    offset = len(layout.vector)
    rate = problem.scalar[:, layout.rate.start - offset : layout.rate.stop - offset]
    wheel = problem.scalar[:, layout.wheel.start - offset : layout.wheel.stop - offset]
    latent = terms.mean_rate + (rate - terms.mean_rate) @ kept
    measured = latent @ inertia.T + wheel @ weights.T
    _, reference_rise, reference_fall = terms.sampling.pulse_reference_s
    pulse = xp.stack([xp.ones(()), rise - reference_rise, fall - reference_fall])
    fired = (arms.T * thrust[:, None])[:, :, None] * pulse  # (K, axis, pulse column)
    model = (problem.vector @ xp.concatenate([start, torque, fired.reshape(-1)])).reshape(-1, 3)
    chance = cut_probability(terms.statistics.counter_interval_s)
    lost = (fall - rise) * xp.exp(-CONTROL_CYCLE_S / fall)
    for i, place in enumerate(terms.pattern.cuts):
        members = list(layout.couples[place // CUT_PARTS])
        count = problem.scalar[:, layout.cut.start + place - offset]
        sd = np.sqrt(chance * (1.0 - chance) / terms.statistics.close_pairs[place])
        push = -chance * lost * (arms[:, members] @ thrust[np.array(members)])
        push = push + problem.model.linear.common_mean_n * lost * sd * tails[i] * xp.sum(
            arms[:, members], axis=1
        )
        model = model + count[:, None] * push
    noise = (
        variance * inertia @ kept @ inertia.T
        + (parameters["wheel_noise_rpm"] * RAD_S_PER_RPM) ** 2 * weights @ weights.T
        + parameters["attitude_noise_rad"] ** 2 * terms.spin
    )
    return measured - model, noise, weights, spread


def physics(xp: ModuleType, problem: Problem, parameters: dict[str, Values]) -> tuple[Any, ...]:
    """Inertia, wheel weights T I_w of the event's wheels, lever arms, (τ_r, τ_f)."""
    spacecraft = problem.model.spacecraft
    xx, yy, zz, xy, xz, yz = (parameters[name] for name in INERTIA_PARAMETERS)
    inertia = xp.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz]).reshape(3, 3)
    columns = []
    for place in problem.terms.wheel_places:
        wheel = spacecraft.wheels[place]
        axis = xp.asarray(wheel.axis)
        if wheel.tilt_parameters:
            tilt = xp.stack([parameters[name] for name in wheel.tilt_parameters])
            axis = axis + tilt @ wheel.tilt_axes
            axis = axis / xp.sqrt(xp.sum(axis**2))
        columns.append(axis * parameters[wheel.inertia_parameter])
    geometry = spacecraft.geometry[problem.model.branch]
    names = (*geometry.parameters, *CENTRE_OF_MASS)
    values = xp.stack([parameters[name] for name in names])
    arms = geometry.arm_constant + xp.tensordot(values, geometry.arm_weights, axes=1)
    taus = parameters["tau_rise_s"], parameters["tau_fall_s"]
    return inertia, xp.stack(columns, axis=1), arms, taus


def to_parameters(xp: ModuleType, special: Any, model: JointModel, z: Values) -> dict[str, Values]:
    """Parameters at standard-normal coordinates z (d,)."""
    found = {name: xp.asarray(value) for name, value in model.space.fixed.items()}
    found |= {name: xp.asarray(value) for name, value in model.absent_wheel_parameters.items()}
    for i, name in enumerate(model.space.names):
        found[name] = _quantile(xp, special, model.space.distributions[i], z[i])
    return found


def _quantile(xp: ModuleType, special: Any, prior: Distribution, z: Values) -> Values:
    """Quantile of a normal, a log-normal, or a normal with a lower bound."""
    keywords = prior.keywords
    if prior.is_normal:
        return prior.mean() + prior.sd() * z
    if prior.name == "lognorm":
        return keywords.get("loc", 0.0) + keywords["scale"] * xp.exp(keywords["s"] * z)
    assert prior.name == "norm"
    assert prior.high is None
    bound = (prior.low - keywords["loc"]) / keywords["scale"]
    below, above = _ndtr(bound), _ndtr(-bound)
    low = special.ndtri(below * special.ndtr(-z) + special.ndtr(z))
    high = -special.ndtri(above * special.ndtr(-z))
    return keywords["loc"] + keywords["scale"] * xp.where(z < 0.0, low, high)


def _ndtr(value: float) -> float:
    from scipy.special import ndtr

    return float(ndtr(value))
