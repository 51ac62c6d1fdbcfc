"""The plain likelihood: every row's density, nothing integrated out, no Gram matrices.

One function for numpy and for JAX: ``xp`` is the array module, ``special`` its special functions.
All unknowns are sampled, each with an N(0, 1) prior: walked parameters z, the event's thrusts, its
initial momentum, torque and cut tails. The wheels' motion has its integral as a table, as ours has;
at the faster frequencies it is told from what the slow rows' best unknowns leave to the wheels, as
in ours. The torque noise is a covariance between rows, diagonal in the slow modes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np
import scipy.special

from cassini_bayes.balance.bands import Band
from cassini_bayes.balance.physics import INERTIA_PARAMETERS
from cassini_bayes.balance.statistics import Carry, Samples, settle
from cassini_bayes.balance.statistics.columns import CUT_PARTS
from cassini_bayes.balance.statistics.reduction import MODES
from cassini_bayes.balance.telemetry_balance import (
    CONTROL_CYCLE_S,
    INITIAL_SD_N_M_S,
    TelemetryBalance,
    cut_probability,
    cut_tail_sd,
)
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.posterior import Model
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.spacecraft.description import CENTRE_OF_MASS
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM
from speed.wheel_motion import fast_motion, mean_walk, slow_motion

Values = Any  # arrays of either module
_INDEPENDENT = 1e-9  # least share of the largest square that a mode of its own has
_THRUST_SPREAD = 0.3  # of thrusts about their level, where the slow rows place them


@dataclass(frozen=True)
class Slow:
    """Coordinates of the rows on the modes of the slow band."""

    vector: Values  # (3 M, V)
    counts: Values  # (M, C)
    rate: Values  # (M, 3)


@dataclass(frozen=True)
class Problem:
    """One bias: the model, its rows as columns, and the orthonormal modes of its bands."""

    model: Model
    terms: TelemetryBalance
    vector: Values  # (3 n, V)
    counts: Values  # (n, C) of pulses that may have cut tails
    rate: Values  # (n, 3)
    slow: Slow
    modes: Values  # (n, M) orthonormal, the slowest first
    bands: tuple[Band, ...]
    places: tuple[slice, ...]  # modes of every band but the last, which is what they leave
    wheels: tuple[Values, ...]  # wheel rates per band, on its modes (M, W), the last on rows (n, W)
    thrust_factor: Values  # (K, K) of the prior covariance of this event's thrusts

    @property
    def size(self) -> int:
        """Number of unknowns that are sampled."""
        return len(self.model.space.names) + self.linear_size

    @property
    def linear_size(self) -> int:
        """Of these, the ones that our own likelihood integrates out."""
        return self.terms.pattern.thrusters + 6 + len(self.terms.pattern.cuts)


def make_problem(model: Model, event: ReducedEvent) -> Problem:
    """Rows of an event for the plain likelihood."""
    samples = Samples.joined(tuple(event.rows))
    layout, terms = event.statistics.layout, model.telemetry[0].balance
    rows, _ = settle(samples, Carry.start(layout), layout, event.sampling, final=True)
    n, offset = len(rows.time_s), len(layout.vector)
    bands = (terms.slow, *terms.fast)
    edges = np.cumsum([0, *(band.rows for band in bands[:-1])])
    modes = slow_modes(rows.time_s, event.statistics.duration_s, int(edges[-1]))
    places = tuple(slice(int(a), int(b)) for a, b in pairwise(edges))
    rate, wheel = (
        rows.scalar[:, part.start - offset : part.stop - offset]
        for part in (layout.rate, layout.wheel)
    )
    counts = rows.scalar[:, [layout.cut.start + place - offset for place in terms.pattern.cuts]]
    vector = rows.vector.reshape(n, -1)
    slow = modes[:, places[0]].T
    amplitude = modes.T @ wheel
    own, shared = model.thrust_prior.departures, model.thrust_prior.shared
    return Problem(
        model=model,
        terms=terms,
        vector=vector.reshape(3 * n, -1),
        counts=counts,
        rate=rate,
        slow=Slow((slow @ vector).reshape(3 * len(slow), -1), slow @ counts, slow @ rate),
        modes=modes,
        bands=bands,
        places=places,
        wheels=(*(amplitude[place] for place in places), wheel - modes @ amplitude),
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
    inertia, wheels, arms, taus = physics(xp, problem, parameters)
    columns = column_weights(xp, problem, arms, taus)
    noise = noise_of(parameters, inertia, problem)
    kept, log_density = slow_motion(xp, problem.bands[0], noise.wheel)
    first = slow_noise(xp, problem, noise, wheels, kept)
    placed = placed_by_slow_rows(xp, problem, columns, first, (inertia, wheels @ kept))
    measured = problem.rate @ inertia.T
    residual = measured - modelled(problem, columns, unknowns)
    lacking = modelled(problem, columns, placed) - measured
    both = xp.concatenate([residual, lacking], axis=1)
    amplitude = problem.modes.T @ both
    parts = [amplitude[place] for place in problem.places[1:]]
    parts.append(both - problem.modes @ amplitude)
    slow = amplitude[problem.places[0], :3] + problem.wheels[0] @ (wheels @ kept).T
    log_likelihood = log_density - quadratic(xp, slow, first) - 0.5 * xp.sum(xp.log(first[1]))
    for band, rates, part in zip(problem.bands[1:], problem.wheels[1:], parts, strict=True):
        log_likelihood = log_likelihood + _fast_band(xp, band, noise, wheels, rates, part)
    rows, channels = len(problem.rate), 3 + wheels.shape[1]
    log_likelihood = log_likelihood + rows * (
        xp.linalg.slogdet(inertia)[1] - 0.5 * channels * np.log(2.0 * np.pi)
    )
    return log_likelihood - 0.5 * xp.sum(x**2) - 0.5 * len(x) * np.log(2.0 * np.pi)


@dataclass(frozen=True)
class Noise:
    """Noise of rows: covariance (3, 3) but for the wheels, (N m s)²; variances of the others."""

    white: Values
    wheel: Values  # rad²/s²
    walk: Values  # (N m)² s


def noise_of(parameters: dict[str, Values], inertia: Values, problem: Problem) -> Noise:
    """Noise levels as variances."""
    return Noise(
        white=parameters["rate_noise_rad_s"] ** 2 * inertia @ inertia.T
        + parameters["attitude_noise_rad"] ** 2 * problem.terms.spin,
        wheel=(parameters["wheel_noise_rpm"] * RAD_S_PER_RPM) ** 2,
        walk=parameters["torque_noise_n_m_s05"] ** 2,
    )


def slow_noise(
    xp: ModuleType, problem: Problem, noise: Noise, wheels: Values, kept: Values
) -> tuple[Values, Values]:
    """Principal axes (3, 3) of the slow band's noise, and its variances along them, (M, 3)."""
    values, axes = xp.linalg.eigh(noise.white + noise.wheel * wheels @ kept @ wheels.T)
    return axes, values + noise.walk * xp.asarray(problem.bands[0].walk)[:, None]


def quadratic(xp: ModuleType, residual: Values, noise: tuple[Values, Values]) -> Values:
    """Half the sum of squares of residuals (n, 3) over their noise, by axes and variances."""
    axes, variance = noise
    return 0.5 * xp.sum((residual @ axes) ** 2 / variance)


def _fast_band(
    xp: ModuleType, band: Band, noise: Noise, wheels: Values, rates: Values, part: Values
) -> Values:
    """Log density of one fast band; ``part`` is the residual and what lacks, wheels apart."""
    residual, lacking = part[:, :3], part[:, 3:]
    seen = xp.concatenate([lacking, xp.asarray(rates)], axis=1)
    other = noise.white + noise.walk * mean_walk(band) * np.eye(3)
    moments = seen.T @ seen / band.rows
    kept, log_density = fast_motion(xp, band, moments, other, wheels, noise.wheel)
    values, axes = xp.linalg.eigh(other + noise.wheel * wheels @ kept @ wheels.T)
    # the determinants are within the motion's density
    return log_density - quadratic(xp, residual + rates @ (wheels @ kept).T, (axes, values))


def placed_by_slow_rows(
    xp: ModuleType,
    problem: Problem,
    columns: tuple[Values, Values],
    noise: tuple[Values, Values],
    measured: tuple[Values, Values],
) -> Values:
    """The unknowns (P,) where the slow rows and their priors have them.

    ``measured`` are the weights of rates and wheel rates in the measured momentum.
    """
    axes, variance = noise
    by_vector, by_count = columns
    slow, modes = problem.slow, len(problem.slow.rate)
    design = (slow.vector @ by_vector).reshape(modes, 3, -1)
    design = design + xp.tensordot(xp.asarray(slow.counts), by_count, axes=1)
    mean, sd = slow_prior(problem)
    target = slow.rate @ measured[0].T + problem.wheels[0] @ measured[1].T - design @ mean
    turned = xp.swapaxes(axes.T @ design, 1, 2) * sd[:, None]  # (M, P, 3)
    weighted = turned / variance[:, None, :]
    precision = xp.tensordot(weighted, turned, axes=((0, 2), (0, 2))) + np.eye(len(sd))
    pull = xp.tensordot(weighted, target @ axes, axes=((0, 2), (0, 1)))
    return mean + sd * xp.linalg.solve(precision, pull)


def slow_prior(problem: Problem) -> tuple[Values, Values]:
    """Mean and sd (P,) of thrusts, initial momentum, torque and tails for the slow rows."""
    model, terms = problem.model, problem.terms
    common, k = model.thrust_prior.common_mean_n, terms.pattern.thrusters
    tails = np.zeros(len(terms.pattern.cuts))
    mean = [np.full(k, common), terms.initial_mean_n_m_s, model.torque_mean_n_m, tails]
    sd = [np.full(k, _THRUST_SPREAD * common), np.full(3, INITIAL_SD_N_M_S), model.torque_sd_n_m]
    return np.concatenate(mean), np.concatenate([*sd, cut_tail_sd(terms)])


def unpacked(
    xp: ModuleType, special: Any, problem: Problem, x: Values
) -> tuple[dict[str, Values], Values]:
    """Parameters, and the unknowns (P,): thrusts, initial momentum, torque, cut tails."""
    d, k = len(problem.model.space.names), problem.terms.pattern.thrusters
    white = x[d:]
    unknowns = xp.concatenate(
        [
            problem.model.thrust_prior.common_mean_n + problem.thrust_factor @ white[:k],
            problem.terms.initial_mean_n_m_s + INITIAL_SD_N_M_S * white[k : k + 3],
            problem.model.torque_mean_n_m + problem.model.torque_sd_n_m * white[k + 3 : k + 6],
            cut_tail_sd(problem.terms) * white[k + 6 :],
        ]
    )
    return to_parameters(xp, special, problem.model, x[:d]), unknowns


def modelled(problem: Problem, columns: tuple[Values, Values], unknowns: Values) -> Values:
    """Momentum (n, 3) that the unknowns put into every row."""
    by_vector, by_count = columns
    fired = (problem.vector @ (by_vector @ unknowns)).reshape(-1, 3)
    return fired + problem.counts @ (by_count @ unknowns)


def column_weights(
    xp: ModuleType, problem: Problem, arms: Values, taus: tuple[Values, Values]
) -> tuple[Values, Values]:
    """Weights of the unknowns on the vector columns (V, P) and on the counts (C, 3, P)."""
    terms, layout = problem.terms, problem.terms.statistics.layout
    k, cuts = terms.pattern.thrusters, len(terms.pattern.cuts)
    rise, fall = taus
    _, reference_rise, reference_fall = terms.sampling.pulse_reference_s
    pulse = xp.stack([xp.ones(()), rise - reference_rise, fall - reference_fall])
    fired = (arms.T[:, :, None] * pulse).reshape(k, 9)  # (K, axis and pulse column)
    fired = (fired[:, :, None] * np.eye(k)[:, None, :]).reshape(9 * k, k)
    by_vector = xp.block(
        [[np.zeros((6, k)), np.eye(6, 6 + cuts)], [fired, np.zeros((9 * k, 6 + cuts))]]
    )
    lost = (fall - rise) * xp.exp(-CONTROL_CYCLE_S / fall)
    chance = cut_probability(terms.statistics.counter_interval_s)
    members = np.zeros((cuts, k))
    for i, place in enumerate(terms.pattern.cuts):
        members[i, list(layout.couples[place // CUT_PARTS])] = 1.0
    tails = problem.model.thrust_prior.common_mean_n * lost * (members @ arms.T)
    by_count = xp.concatenate(
        [
            -chance * lost * arms * members[:, None, :],
            np.zeros((cuts, 3, 6)),
            tails[:, :, None] * np.eye(cuts)[:, None, :],
        ],
        axis=2,
    )
    return by_vector, by_count


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


def to_parameters(xp: ModuleType, special: Any, model: Model, z: Values) -> dict[str, Values]:
    """Parameters at standard-normal coordinates z (d,)."""
    found = {name: xp.asarray(value) for name, value in model.space.fixed.items()}
    found |= {name: xp.asarray(value) for name, value in model.idle.items()}
    for i, name in enumerate(model.space.names):
        found[name] = _quantile(xp, special, model.space.distributions[i], z[i])
    return found


def _quantile(xp: ModuleType, special: Any, prior: Distribution, z: Values) -> Values:
    """Quantile of a normal or a log-normal, either one with bounds."""
    keywords = prior.keywords
    assert prior.name in ("norm", "lognorm")
    low, high = (_unbounded(prior, bound) for bound in (prior.low, prior.high))
    y = z
    if low is not None or high is not None:
        # the tail that is farther from 1 keeps the digits
        below = special.ndtr(z) * _ndtr(high, 1.0) + special.ndtr(-z) * _ndtr(low, 0.0)
        above = special.ndtr(-z) * _ndtr(low, 1.0, -1.0) + special.ndtr(z) * _ndtr(high, 0.0, -1.0)
        y = xp.where(z < 0.0, special.ndtri(below), -special.ndtri(above))
    if prior.name == "lognorm":
        return keywords.get("loc", 0.0) + keywords["scale"] * xp.exp(keywords["s"] * y)
    return keywords.get("loc", 0.0) + keywords.get("scale", 1.0) * y


def _unbounded(prior: Distribution, bound: float | None) -> float | None:
    """Standard-normal coordinate of a bound in the distribution without bounds."""
    if bound is None:
        return None
    value = (bound - prior.keywords.get("loc", 0.0)) / prior.keywords.get("scale", 1.0)
    if prior.name == "norm":
        return value
    return float(np.log(value) / prior.keywords["s"]) if value > 0.0 else None


def _ndtr(value: float | None, otherwise: float, sign: float = 1.0) -> float:
    """Standard-normal probability below ``sign`` times a bound, or what no bound means."""
    return otherwise if value is None else float(scipy.special.ndtr(sign * value))
