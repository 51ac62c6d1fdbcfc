"""Two leak monitors on one event: residual momentum with a threshold, and sequential odds.

Paper 000 section IV has one on board (*excessive thruster commanding*): what Euler's equation
leaves is integrated over time, and a residual momentum beyond a threshold within a set time is a
leak; the signs of its three components name the thruster. It prints neither threshold nor time.
Beside it stands the posterior: the same residual is Gaussian with a covariance of channel noise,
torque noise and every uncertain parameter, a leak adds a known column from its start on, and the
odds of a leak are updated row by row. Both see the same rows, at which no thruster delivers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.measured_delta_v import on_time_columns, rows_at_rest
from cassini_bayes.balance.physics import Physics, physics_of
from cassini_bayes.balance.statistics import Samples
from cassini_bayes.balance.statistics.turns import turns_between
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.errors import InputError
from cassini_bayes.model.event_reduction import sampling_of
from cassini_bayes.priors.reader import Priors
from cassini_bayes.spacecraft.attitude import direction_cosines
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

ROWS_EVERY_S: Final = 10.0
STARTS_EVERY_S: Final = 50.0
SIZES_N: Final = np.geomspace(1e-5, 5e-3, 28)
"""Sizes of a leak, even odds each: log-uniform over what the campaign simulates."""
POLARITY_SHARE: Final = 0.25
"""Of the greatest component: a smaller one counts as zero where signs are compared."""
HALF_ROWS: Final = 3
"""Rows to either side of a row at rest over whose turn its rate is taken."""
_LEAST_ROWS: Final = 5
_STEP: Final = 1e-3  # of a prior standard deviation, for derivatives: the residual is nearly linear


@dataclass(frozen=True)
class Residual:
    """Residual momentum of one event along its rows at rest, at nominal parameters.

    ``covariance`` is that of ``momentum`` (N, 3) flattened row by row, of all that is uncertain but
    a leak. ``arms`` (3, K) are the thrusters' torques per newton.
    """

    time_s: Array  # (N,) since the first row
    momentum_n_m_s: Array  # (N, 3) axes of the body at the first row
    covariance: Array  # (3N, 3N)
    arms_m: Array  # (3, K)
    thrusters: tuple[str, ...]
    first_s: float = 0.0  # time of the first row


@dataclass(frozen=True)
class Stretches:
    """Rows at rest amid stretches in which nothing delivers, with their mean rates there.

    The turn over a stretch tells the body's rate far better than a measured rate does
    (docs/topics/telemetry-likelihood.md §5). ``rate_per_rad`` (N,) is the noise of these rates per
    noise of an attitude, 1/s; ``wheel_share`` (N,) that of the wheels' mean rates per noise of a
    row.
    """

    rows: NDArray[np.intp]  # (N,) among the samples
    time_s: Array  # (N,)
    rate_rad_s: Array  # (N, 3)
    wheel_rad_s: Array  # (N, W)
    rate_per_rad: Array
    wheel_share: Array


def stretches(samples: Samples, guard_s: float) -> Stretches:
    """Stretches of :data:`HALF_ROWS` rows to either side, not closer than :data:`ROWS_EVERY_S`.

    Raises
    ------
    InputError
        There are fewer than a handful.
    """
    known = np.isfinite(np.column_stack([samples.attitude, samples.wheel_rad_s])).all(axis=1)
    measured = np.flatnonzero(known)
    rest = np.searchsorted(measured, rows_at_rest(samples, np.asarray(known), guard_s))
    inside = rest[2 * HALF_ROWS :] - rest[: -2 * HALF_ROWS] == 2 * HALF_ROWS
    middle = rest[HALF_ROWS:-HALF_ROWS][inside]
    cell = samples.time_s[measured[middle]] // ROWS_EVERY_S
    middle = middle[np.diff(cell, prepend=-1.0) > 0.0]
    if len(middle) < _LEAST_ROWS:
        raise InputError(
            "telemetry",
            f"at least {_LEAST_ROWS} stretches of {2 * HALF_ROWS + 1} rows at rest,"
            f" {ROWS_EVERY_S:g} s apart",
            str(len(middle)),
            "use a longer event",
        )
    around = measured[middle[:, None] + np.arange(-HALF_ROWS, HALF_ROWS + 1)]
    time = samples.time_s[around]
    span = time[:, -1] - time[:, 0]
    turns = turns_between(direction_cosines(samples.attitude[measured]))
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(turns, axis=0)])
    turned = turned[middle + HALF_ROWS] - turned[middle - HALF_ROWS]
    half_steps = 0.5 * np.diff(time, axis=1)
    weights = np.pad(half_steps, ((0, 0), (1, 0))) + np.pad(half_steps, ((0, 0), (0, 1)))
    weights = weights / span[:, None]
    return Stretches(
        measured[middle],
        samples.time_s[measured[middle]],
        turned / span[:, None],
        np.einsum("nr,nrw->nw", weights, samples.wheel_rad_s[around]),
        np.sqrt(2.0) / span,
        np.sqrt((weights**2).sum(axis=1)),
    )


def residual_of(
    samples: Samples, thrusters: tuple[str, ...], wheels: tuple[int, ...], priors: Priors
) -> Residual:
    """The residual momentum I ω + T I_w ρ − Σ q F s since the first row, and its covariance.

    Rates are those of :func:`stretches`, of turns.

    Parameters
    ----------
    samples
        A bias: all channels at once in the rows that are used, the attitude near the first one's.
    thrusters, wheels
        In the order of the samples' columns.
    priors
        Nominal values and widths. Noise of the channels enters at its prior mean.
    """
    sampling = sampling_of(priors, thrusters, float(samples.time_s[-1]), "first_order")
    still = stretches(samples, sampling.guard_s)
    rows = still.rows
    columns = on_time_columns(samples, rows, sampling).reshape(len(rows), len(thrusters), -1)
    to_body = direction_cosines(samples.attitude[rows])
    back = np.einsum("ab,ncb->nac", to_body[0], to_body)  # to the first row's axes
    craft = priors.spacecraft
    numbers = [wheel.number for wheel in craft.wheels]
    places = [numbers.index(number) for number in wheels]
    means = {name: prior.mean for name, prior in priors.parameters.items()}
    idle = dict.fromkeys(craft.wheel_parameters(), 0.0)

    def physics(values: Mapping[str, float]) -> Physics:
        arrays = {name: np.asarray(value) for name, value in {**idle, **values}.items()}
        return physics_of(craft, priors.branch, arrays)

    def momentum(values: Mapping[str, float], thrust_n: Array) -> Array:
        body_physics = physics(values)
        body = still.rate_rad_s @ body_physics.inertia_kg_m2.T
        body = body + still.wheel_rad_s @ body_physics.wheel_weights[:, places].T
        seconds = columns @ sampling.pulses.weights(body_physics.tau_s)
        total = np.einsum("nac,nc->na", back, body) - seconds @ (body_physics.arms_m * thrust_n).T
        return np.asarray(total - total[0])

    level = np.full(len(thrusters), means["thrust_common_n"])
    at_means = momentum(means, level)
    slopes = []
    for name in _walked(priors, wheels):
        sd = priors.parameters[name].sd
        moved = momentum({**means, name: means[name] + _STEP * sd}, level)
        slopes.append((moved - at_means) / _STEP)
    common = priors.parameters["thrust_common_n"].sd
    body_physics = np.sqrt(
        sum(
            priors.parameters[f"thrust_{which}_n"].sd ** 2
            for which in ("individual", "event", "jitter")
        )
    )
    for k in range(len(thrusters)):
        moved = momentum(means, level + np.eye(len(thrusters))[k])
        slopes.append(body_physics * (moved - at_means))
    slopes.append(common * (momentum(means, level + 1.0) - at_means))
    time = samples.time_s[rows] - samples.time_s[rows[0]]
    torques = [priors.parameters[f"external_torque_{axis}_n_m"] for axis in "xyz"]
    for axis, torque in enumerate(torques):
        slopes.append(torque.sd * time[:, None] * np.eye(3)[axis])
    jacobian = np.stack([slope.ravel() for slope in slopes], axis=1)
    mean = time[:, None] * np.array([torque.mean for torque in torques])
    nominal = physics(means)
    return Residual(
        time,
        at_means - mean,
        jacobian @ jacobian.T + _noise(nominal, places, means, still),
        np.asarray(nominal.arms_m),
        thrusters,
        float(still.time_s[0]),
    )


def _walked(priors: Priors, wheels: tuple[int, ...]) -> list[str]:
    """Parameters with a width that move the residual."""
    craft = priors.spacecraft
    names = [
        *(f"inertia_{element}_kg_m2" for element in ("xx", "yy", "zz", "xy", "xz", "yz")),
        *craft.wheel_parameters(wheels),
        "tau_rise_s",
        "tau_fall_s",
        "cm_x_m",
        "cm_y_m",
        "cm_z_m",
        *craft.geometry_of(priors.branch).parameters,
    ]
    return [name for name in names if priors.parameters[name].sd > 0.0]


def _noise(
    physics: Physics, places: list[int], means: Mapping[str, float], still: Stretches
) -> Array:
    """Covariance (3N, 3N) of channel noise, the first row's in every row, and of torque noise."""
    weights = physics.wheel_weights[:, places]
    time = still.time_s - still.time_s[0]
    turn_square = (means["attitude_noise_rad"] * still.rate_per_rad) ** 2
    wheel_square = (means["wheel_noise_rpm"] * RAD_S_PER_RPM * still.wheel_share) ** 2
    walk = means["torque_noise_n_m_s05"] ** 2 * np.minimum(time[:, None], time)
    return np.asarray(
        np.kron(_shared(turn_square), physics.inertia_kg_m2 @ physics.inertia_kg_m2.T)
        + np.kron(_shared(wheel_square), weights @ weights.T)
        + np.kron(walk, np.eye(3))
    )


def _shared(square: Array) -> Array:
    """Covariance (N, N) of white noise of variances (N,) less that of the first row.

    The first row's own residual is zero (its variance is only there to be inverted).
    """
    covariance = np.diag(square) + square[0]
    covariance[0], covariance[:, 0] = 0.0, 0.0
    covariance[0, 0] = 1e-6 * square[0]
    return np.asarray(covariance)


@dataclass(frozen=True)
class Track:
    """Output of a monitor along the rows: a statistic (N,) and the thruster it would name (N,)."""

    statistic: Array
    thruster: Array  # places among the thrusters; −1: none fits


@dataclass(frozen=True)
class Odds:
    """Sequential odds of a leak, every thruster, start and size weighed by its prior.

    With L Lᵀ the covariance, whitened residuals and columns of the first n rows are the first 3n
    entries of L⁻¹ r and L⁻¹ g: one factorisation serves every time. The log Bayes factor of a leak
    of size x is x a − ½ x² b, a = g·C⁻¹ r and b = g·C⁻¹ g over those rows.
    """

    residual: Residual

    @cached_property
    def log_bayes_factor(self) -> Array:
        """By row and thruster (N, K), sizes and starts averaged over their priors."""
        residual = self.residual
        n = len(residual.time_s)
        lower = np.linalg.cholesky(residual.covariance)
        left = np.linalg.solve(lower, residual.momentum_n_m_s.ravel())
        starts = np.arange(0.0, residual.time_s[-1], STARTS_EVERY_S)
        running = np.maximum(residual.time_s[:, None] - starts, 0.0)  # (N, S)
        columns = np.einsum("ns,ck->ncsk", running, residual.arms_m).reshape(3 * n, -1)
        white = np.linalg.solve(lower, columns)
        along = np.cumsum(white * left[:, None], axis=0)[2::3]
        square = np.cumsum(white**2, axis=0)[2::3]
        exponents = SIZES_N[:, None, None] * along - 0.5 * SIZES_N[:, None, None] ** 2 * square
        by_size = exponents.reshape(len(SIZES_N), n, len(starts), -1)
        top = by_size.max(axis=(0, 2))
        mean = np.exp(by_size - top[None, :, None]).mean(axis=(0, 2))
        return np.asarray(top + np.log(mean))

    def track(self) -> Track:
        """Log Bayes factor of a leak of any thruster against none, and the likeliest one."""
        each = self.log_bayes_factor
        top = each.max(axis=1, keepdims=True)
        total = top[:, 0] + np.log(np.exp(each - top).mean(axis=1))
        return Track(total, each.argmax(axis=1))


def threshold_track(residual: Residual, window_s: float) -> Track:
    """Paper 000's monitor: |R(t) − R(t − window)|, and the thruster of its polarity.

    The whole residual where the event is younger than the window.
    """
    time, momentum = residual.time_s, residual.momentum_n_m_s
    before = np.searchsorted(time, time - window_s - 1e-9)
    gained = momentum - momentum[before]
    named = np.array([_by_polarity(row, residual.arms_m) for row in gained])
    return Track(np.linalg.norm(gained, axis=1), named)


def _by_polarity(momentum: Array, arms: Array) -> int:
    """The only thruster whose torque has the signs of a momentum (3,); −1 if none or several.

    A leak of thruster k adds q_k F t to the momentum that the commands leave unexplained.
    """
    wanted = _signs(momentum)
    fitting = [k for k in range(arms.shape[1]) if np.array_equal(_signs(arms[:, k]), wanted)]
    return fitting[0] if len(fitting) == 1 else -1


def _signs(vector: Array) -> Array:
    size = np.abs(vector).max()
    return np.where(np.abs(vector) < POLARITY_SHARE * size, 0.0, np.sign(vector))


def alarm_row(statistic: Array, threshold: float, persistence: int) -> int | None:
    """The row at which a statistic has been above the threshold for so many rows in a row."""
    above = np.convolve(statistic > threshold, np.ones(persistence), mode="full")[: len(statistic)]
    result = np.flatnonzero(above >= persistence)
    return int(result[0]) if len(result) else None
