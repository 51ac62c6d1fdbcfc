"""The plain likelihood: every row's density, nothing integrated out, no Gram matrices.

One function for numpy and for JAX: ``xp`` is the array module, ``special`` its special functions.
All unknowns are sampled, each with an N(0, 1) prior: walked parameters z, the event's thrusts, its
initial momentum, torque and cut tails. The wheels' motion has its integral as a table, as ours has;
the torque noise is a covariance between rows, diagonal in the slow modes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
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
from cassini_bayes.statistics.reduction import MODES
from cassini_bayes.telemetry import load_event
from cassini_bayes.telemetry_bands import Band
from cassini_bayes.telemetry_terms import (
    CONTROL_CYCLE_S,
    INITIAL_SD_N_M_S,
    TelemetryTerms,
    cut_probability,
)
from cassini_bayes.terms import RAD_S_PER_RPM

Values = Any  # arrays of either module
_INDEPENDENT = 1e-9  # least share of the largest square that a mode of its own has


@dataclass(frozen=True)
class Problem:
    """One bias: the model, its rows as columns, and the orthonormal modes of its bands."""

    model: JointModel
    terms: TelemetryTerms
    vector: Values  # (3 n, V)
    scalar: Values  # (n, S)
    modes: Values  # (n, M) orthonormal, the slowest first
    bands: tuple[Band, ...]
    places: tuple[slice, ...]  # modes of every band but the last, which is what they leave
    wheels: tuple[Values, ...]  # (n, W) wheel rates, the part within every band
    thrust_factor: Values  # (K, K) of the prior covariance of this event's thrusts

    @property
    def size(self) -> int:
        """Number of unknowns that are sampled."""
        return len(self.model.space.names) + self.linear_size

    @property
    def linear_size(self) -> int:
        """Of these, the ones that our own likelihood integrates out."""
        return self.terms.pattern.thrusters + 6 + len(self.terms.pattern.cuts)


def make_problem(model: JointModel, event: ReducedEvent) -> Problem:
    """Rows of an event for the plain likelihood."""
    samples = samples_of(load_event(event.event, model.spacecraft))
    layout, terms = event.statistics.layout, model.telemetry[0]
    rows, _ = settle(samples, Carry.start(layout), layout, event.sampling, final=True)
    n, offset = len(rows.time_s), len(layout.vector)
    bands = (terms.slow, *terms.fast)
    edges = np.cumsum([0, *(band.rows for band in bands[:-1])])
    modes = slow_modes(rows.time_s, event.statistics.duration_s, int(edges[-1]))
    places = tuple(slice(int(a), int(b)) for a, b in pairwise(edges))
    wheel = rows.scalar[:, layout.wheel.start - offset : layout.wheel.stop - offset]
    parts = [modes[:, place] @ (modes[:, place].T @ wheel) for place in places]
    own, shared = model.linear.own, model.linear.shared
    return Problem(
        model=model,
        terms=terms,
        vector=rows.vector.reshape(3 * n, -1),
        scalar=rows.scalar,
        modes=modes,
        bands=bands,
        places=places,
        wheels=(*parts, wheel - sum(parts)),
        thrust_factor=np.linalg.cholesky(own @ own.T + shared @ shared.T),
    )


def slow_modes(time_s: Values, duration_s: float, count: int) -> Values:
    """Orthonormal modes (n, count) of a random walk about its mean, the largest first."""
    order = np.arange(1, MODES + 1)
    waves = np.cos(np.pi * time_s[:, None] / duration_s * order) * np.sqrt(2.0) / order / np.pi
    constant = np.full((len(time_s), 1), 1.0 / np.sqrt(3.0))
    modes, sizes, _ = np.linalg.svd(np.concatenate([constant, waves], axis=1), full_matrices=False)
    assert count <= int(np.sum(sizes**2 > _INDEPENDENT * sizes[0] ** 2))
    return modes[:, :count]


def log_posterior(xp: ModuleType, special: Any, problem: Problem, x: Values) -> Values:
    """Log density of the data and of everything sampled, at one point x."""
    parameters, unknowns = unpacked(xp, special, problem, x)
    inertia, weights, arms, taus = physics(xp, problem, parameters)
    kept, log_density = latent_wheels(xp, problem, parameters)
    latent = xp.concatenate([(weights @ own).T for own in kept])
    layout = problem.terms.statistics.layout
    first = layout.rate.start - len(layout.vector)
    rate = problem.scalar[:, first : first + 3]
    measured = rate @ inertia.T + np.concatenate(problem.wheels, axis=1) @ latent
    residual = measured - modelled(xp, problem, unknowns, arms, taus)
    rows, channels = len(problem.scalar), 3 + len(problem.terms.wheel_places)
    log_likelihood = (
        log_density
        + gaussian(xp, problem, parameters, residual, (inertia, weights, kept))
        + rows * (xp.linalg.slogdet(inertia)[1] - 0.5 * channels * np.log(2.0 * np.pi))
    )
    return log_likelihood - 0.5 * xp.sum(x**2) - 0.5 * len(x) * np.log(2.0 * np.pi)


def gaussian(
    xp: ModuleType,
    problem: Problem,
    parameters: dict[str, Values],
    residual: Values,
    physical: tuple[Values, Values, list[Values]],
) -> Values:
    """Log density of residuals (n, 3), without the factors 2π: every band has its own noise."""
    inertia, weights, kept = physical
    walk = parameters["torque_noise_n_m_s05"] ** 2
    white = (
        parameters["rate_noise_rad_s"] ** 2 * inertia @ inertia.T
        + parameters["attitude_noise_rad"] ** 2 * problem.terms.spin
    )
    wheel = (parameters["wheel_noise_rpm"] * RAD_S_PER_RPM) ** 2
    amplitude = problem.modes.T @ residual
    parts = [amplitude[place] for place in problem.places]
    parts.append(residual - problem.modes @ amplitude)
    total = 0.0
    for i, (band, own, part) in enumerate(zip(problem.bands, kept, parts, strict=True)):
        values, axes = xp.linalg.eigh(white + wheel * weights @ own @ weights.T)
        drift = walk * (band.walk if i == 0 else np.mean(band.walk, keepdims=True))
        variance = values + xp.asarray(drift)[:, None]
        each = band.rows / len(band.walk) if i == 0 else band.rows
        total = total - 0.5 * xp.sum((part @ axes) ** 2 / variance)
        total = total - 0.5 * each * xp.sum(xp.log(variance))
    return total


def latent_wheels(
    xp: ModuleType, problem: Problem, parameters: dict[str, Values]
) -> tuple[list[Values], Values]:
    """Per band the matrix (W, W) from measured to true wheel rates; their summed log density."""
    log_noise = 2.0 * xp.log(parameters["wheel_noise_rpm"] * RAD_S_PER_RPM)
    kept, total = [], 0.0
    for band in problem.bands:
        table, knots = xp.asarray(band.motion.c), xp.asarray(band.motion.x)
        t = xp.clip(log_noise - np.log(band.values), band.motion.x[0], band.motion.x[-1])
        place = xp.clip(xp.searchsorted(knots, t, side="right") - 1, 0, len(band.motion.x) - 2)
        step = (t - knots[place])[:, None]
        cubic = table[:, place]
        found = ((cubic[0] * step + cubic[1]) * step + cubic[2]) * step + cubic[3]
        share = xp.clip(found[:, 1], 0.0, 1.0)
        kept.append((band.vectors * share) @ band.vectors.T)
        total = total + xp.sum(found[:, 0]) - 0.5 * band.rows * np.sum(np.log(band.values))
    return kept, total


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


def modelled(
    xp: ModuleType,
    problem: Problem,
    unknowns: tuple[Values, ...],
    arms: Values,
    taus: tuple[Values, Values],
) -> Values:
    """Momentum (n, 3) that the unknowns put into every row."""
    terms, layout = problem.terms, problem.terms.statistics.layout
    thrust, start, torque, tails = unknowns
    rise, fall = taus
    _, reference_rise, reference_fall = terms.sampling.pulse_reference_s
    pulse = xp.stack([xp.ones(()), rise - reference_rise, fall - reference_fall])
    fired = (arms.T * thrust[:, None])[:, :, None] * pulse  # (K, axis, pulse column)
    model = (problem.vector @ xp.concatenate([start, torque, fired.reshape(-1)])).reshape(-1, 3)
    chance = cut_probability(terms.statistics.counter_interval_s)
    lost = (fall - rise) * xp.exp(-CONTROL_CYCLE_S / fall)
    for i, place in enumerate(terms.pattern.cuts):
        members = list(layout.couples[place // CUT_PARTS])
        count = problem.scalar[:, layout.cut.start + place - len(layout.vector)]
        sd = np.sqrt(chance * (1.0 - chance) / terms.statistics.close_pairs[place])
        push = -chance * lost * (arms[:, members] @ thrust[np.array(members)])
        push = push + problem.model.linear.common_mean_n * lost * sd * tails[i] * xp.sum(
            arms[:, members], axis=1
        )
        model = model + count[:, None] * push
    return model


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
