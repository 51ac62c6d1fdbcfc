"""Thrusts of all events together: their prior, integrated out exactly, and drawn back.

Thrust of thruster k in event e is F = common + individual_k + event_e + jitter_ek, all normal. Each
event's information on its thrusts is normal too, so its own coordinates are eliminated first, then
the shared ones, and the cost grows linearly with events. ``docs/topics/totals-likelihood.md``
derives the formulae.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import prod

import numpy as np

from cassini_bayes.balance.physics import Parameters
from cassini_bayes.computing.arrays import Array
from cassini_bayes.priors.chaining import ChainedLevels
from cassini_bayes.priors.reader import Priors
from cassini_bayes.spacecraft.parameters import THRUST_COMMON, THRUST_LEVELS


@dataclass(frozen=True)
class ThrustPrior:
    """Prior of the thrusts, which enter linearly.

    thrust[e] = common mean + shared @ η + departures @ ξ_e, with η shared by all events, ξ_e the
    event's own, all N(0, 1) before the data: shared @ sharedᵀ is the prior covariance of the
    thrusters' levels (common + individual), departures @ departuresᵀ that of an event's departures
    (event + jitter). Where nothing fires there are no thrusters, K = 0.

    Either factor may have a leading axis of events, ``shared`` also one of points before it: every
    event then has a design row of its own for the shared coefficients (docs/topics/mission.md).
    """

    common_mean_n: float
    common_sd_n: float  # 0 where the common level is walked or fixed
    common_is_walked: bool
    individual_sd_n: float
    shared: Array  # (K, q), or (…, E, K, q)
    departures: Array  # (K, p), or (E, K, p)
    # levels from an earlier fit: ``shared`` is then a factor of their covariance given the walked
    # parameters, and their mean takes the place of the common one
    chained: ChainedLevels | None = None

    @property
    def walked(self) -> tuple[str, ...]:
        """The common thrust, where its prior is no normal one."""
        return (THRUST_COMMON,) if self.common_is_walked else ()

    @property
    def integrated(self) -> tuple[str, ...]:
        """Parameters whose priors act although they are not walked."""
        names = (THRUST_COMMON, *THRUST_LEVELS) if len(self.shared) else ()
        return tuple(name for name in names if name not in self.walked)

    def common_at(self, parameters: Parameters, n: int) -> Array:
        """The level about which thrusts are counted, (n,) N."""
        common = parameters[THRUST_COMMON] if self.common_is_walked else self.common_mean_n
        return np.broadcast_to(np.asarray(common, dtype=np.float64), (n,))

    def offset_at(self, parameters: Parameters, common_n: Array) -> Array | None:
        """Mean levels less the common one (n, K), from an earlier fit; None without one."""
        if self.chained is None:
            return None
        return self.chained.levels_n(parameters) - common_n[:, None]

    def mean_at(self, parameters: Parameters, common_n: Array) -> Array:
        """Mean levels (n, K) or, where they are all the common one, (n, 1)."""
        offset = self.offset_at(parameters, common_n)
        return common_n[:, None] if offset is None else common_n[:, None] + offset

    def scaled(self, factor: Array | None) -> ThrustPrior:
        """With effects' factors (…, E, K) on the levels: departures keep their widths."""
        if factor is None:
            return self
        return replace(self, shared=factor[..., None] * self.shared)


def thrust_prior_of(priors: Priors, thrusters: int) -> ThrustPrior:
    """The thrusts' prior; its parameters must be normal or fixed, the common level may be walked.

    Raises
    ------
    InputError
        A parameter that the file lacks, or whose prior cannot be integrated out.
    """
    if not thrusters:
        nothing = np.zeros((0, 0))
        return ThrustPrior(0.0, 0.0, False, 0.0, nothing, nothing)
    priors.require([THRUST_COMMON], "the thrusts")
    individual, event, jitter = priors.normal(THRUST_LEVELS)[1]
    common = priors.parameters[THRUST_COMMON]
    walked = common.distribution is not None and not common.distribution.is_normal
    common_sd = 0.0 if common.distribution is None or walked else common.distribution.sd()
    return ThrustPrior(
        common_mean_n=common.mean,
        common_sd_n=common_sd,
        common_is_walked=walked,
        individual_sd_n=individual,
        shared=level_factor(common_sd, individual, thrusters),
        departures=level_factor(event, jitter, thrusters),
    )


def level_factor(common_sd: float, individual_sd: float, size: int) -> Array:
    """Factor B (K, rank) with B Bᵀ = common_sd² 1 1ᵀ + individual_sd² 1."""
    if individual_sd > 0:
        covariance = np.full((size, size), common_sd**2) + individual_sd**2 * np.eye(size)
        factor = np.linalg.cholesky(covariance)
    else:
        factor = np.full((size, int(common_sd > 0)), common_sd)
    factor.setflags(write=False)
    return np.asarray(factor, dtype=np.float64)


@dataclass(frozen=True)
class ThrustInformation:
    """Information of events on their thrusts, their other unknowns integrated out.

    With d = F − common: log L_e(F) = constant + vectorᵀ d − ½ dᵀ matrix d.
    """

    matrix: Array  # (n, E, K, K)
    vector: Array  # (n, E, K)
    constant: Array  # (n, E)

    @classmethod
    def nothing(cls, n: int, thrusters: int) -> ThrustInformation:
        """Of no event."""
        return cls(
            np.zeros((n, 0, thrusters, thrusters)), np.zeros((n, 0, thrusters)), np.zeros((n, 0))
        )

    def about(self, offset_n: Array) -> ThrustInformation:
        """The same about other mean levels, common + offset (n, K), or (n, E, K) event by event.

        With d = d' + δ: c + νᵀd − ½ dᵀGd = (c + νᵀδ − ½ δᵀGδ) + (ν − Gδ)ᵀ d' − ½ d'ᵀ G d'.
        """
        each = _each_event(offset_n)
        moved = (self.matrix @ each[..., None])[..., 0]
        along = each * (self.vector - 0.5 * moved)
        return replace(self, vector=self.vector - moved, constant=self.constant + along.sum(-1))

    def without_departures(self, loading: Array) -> ThrustInformation:
        """What is left for the levels once the events' own departures are integrated out.

        With L = ``loading`` (K, p) or (E, K, p): G − GL(1 + LᵀGL)⁻¹LᵀG, and ν likewise.
        """
        across = np.swapaxes(loading, -1, -2) @ self.matrix
        factor = _cholesky(across @ loading + np.eye(loading.shape[-1]))
        linear = np.swapaxes(loading, -1, -2) @ self.vector[..., None]
        solved = np.linalg.solve(factor, np.concatenate([across, linear], axis=-1))
        schur = np.swapaxes(solved, -1, -2) @ solved
        log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
        return ThrustInformation(
            self.matrix - schur[..., :-1, :-1],
            self.vector - schur[..., :-1, -1],
            self.constant + 0.5 * schur[..., -1, -1] - log_det,
        )


def _each_event(offset_n: Array) -> Array:
    """Mean levels (n, K) of all events, or (n, E, K) of each, against (n, E, K)."""
    return offset_n[:, None, :] if offset_n.ndim == 2 else offset_n


@dataclass(frozen=True)
class ThrustDraws:
    """One draw of the thrusts per parameter point."""

    thrust_n: Array  # (n, E, K)
    common_n: Array  # (n,) the common level
    level_n: Array  # (n, K) common + individual: a thruster's level over all events, no effects
    factor: Array | float = 1.0  # (n, E, K) of effects on the levels


@dataclass(frozen=True)
class CollapsedThrusts:
    """Conditional normal of the thrusts at a batch of points, by its factors.

    Coordinates are the events' own ξ_e (p of them) and the shared η (q); all have N(0, 1) priors.
    Levels are counted from the common one and an earlier fit's ``offset_n``; thrusts are
    ``factor`` times these and their departures.
    """

    log_likelihood: Array  # (n,)
    event_factor: Array  # (n, E, p, p) lower Cholesky factor of an event's own precision
    event_coupling: Array  # (n, E, p, q) event_factor⁻¹ Λ_ξη
    event_shift: Array  # (n, E, p) event_factor⁻¹ ν_ξ
    shared_factor: Array  # (n, q, q) lower Cholesky factor of the shared precision
    shared_shift: Array  # (n, q) shared_factor⁻¹ ν_η
    common_n: Array  # (n,)
    offset_n: Array | None  # (n, K), or (n, E, K)
    factor: Array | None = None  # (n, E, K)


def collapse_thrusts(
    prior: ThrustPrior,
    information: ThrustInformation,
    common_n: Array,
    offset_n: Array | None,
    factor: Array | None = None,
) -> CollapsedThrusts:
    """Integrate the thrusts out of the information of all events.

    Thrust is S η + L ξ_e beyond the mean level, so ξ_e is eliminated with the Cholesky factor of
    1 + LᵀGL and η with that of 1 + Sᵀ Σ_e [G − GL(1 + LᵀGL)⁻¹LᵀG] S (Rasmussen & Williams 2006,
    eqs. A.9-A.12). ``offset_n`` is that of the mean levels from the common one, ``factor``
    (n, E, K) that of effects on the levels: S is then theirs event by event.
    """
    if offset_n is not None:
        information = information.about(offset_n)
    if factor is not None:
        mean = common_n[:, None] if offset_n is None else common_n[:, None] + offset_n
        information = information.about((factor - 1.0) * mean[:, None, :])
    loading, shared = prior.departures, prior.scaled(factor).shared
    matrix, vector = information.matrix, information.vector
    by_shared = _times(matrix, shared)
    own_precision = _times(np.swapaxes(_times(matrix, loading), -1, -2), loading)
    event_factor = _cholesky(own_precision + np.eye(loading.shape[-1]))
    right = _times(
        np.concatenate([np.swapaxes(by_shared, -1, -2), vector[..., None, :]], axis=-2), loading
    )
    solved: Array = np.asarray(
        np.linalg.solve(event_factor, np.swapaxes(right, -1, -2)), dtype=float
    )
    schur = np.swapaxes(solved, -1, -2) @ solved
    if shared.ndim == 2:
        precision, linear = shared.T @ by_shared.sum(-3), vector.sum(-2) @ shared
    else:
        precision = (np.swapaxes(shared, -1, -2) @ by_shared).sum(-3)
        linear = (vector[..., None, :] @ shared)[..., 0, :].sum(-2)
    shared_precision = precision - schur[..., :-1, :-1].sum(-3)
    shared_linear = linear - schur[..., :-1, -1].sum(-2)
    shared_factor = _cholesky(shared_precision + np.eye(shared.shape[-1]))
    shared_shift = np.linalg.solve(shared_factor, shared_linear[..., None])[..., 0]
    own_log_det = np.log(np.diagonal(event_factor, axis1=-2, axis2=-1)).sum(-1)
    shared_log_det = np.log(np.diagonal(shared_factor, axis1=-2, axis2=-1)).sum(-1)
    log_likelihood = (
        (information.constant + 0.5 * schur[..., -1, -1] - own_log_det).sum(-1)
        + 0.5 * (shared_shift**2).sum(-1)
        - shared_log_det
    )
    return CollapsedThrusts(
        log_likelihood=log_likelihood,
        event_factor=event_factor,
        event_coupling=solved[..., :-1],
        event_shift=solved[..., -1],
        shared_factor=shared_factor,
        shared_shift=shared_shift,
        common_n=common_n,
        offset_n=offset_n,
        factor=factor,
    )


def _cholesky(matrix: Array) -> Array:
    return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)


def _times(stack: Array, matrix: Array) -> Array:
    """stack (..., r, K) @ matrix (K, c) as one product: numpy would loop over the stack.

    A matrix that differs between events, (..., K, c), is multiplied event by event.
    """
    if matrix.ndim > 2:
        return np.asarray(stack @ matrix)
    product = stack.reshape(prod(stack.shape[:-1]), stack.shape[-1]) @ matrix
    return np.asarray(product.reshape(*stack.shape[:-1], matrix.shape[1]))


def _solve_transposed(factor: Array, right: Array) -> Array:
    """Solve factorᵀ x = right for stacked lower factors and vectors."""
    solution = np.linalg.solve(np.swapaxes(factor, -1, -2), right[..., None])
    return np.asarray(solution[..., 0])


def draw_thrusts(
    prior: ThrustPrior, collapsed: CollapsedThrusts, rng: np.random.Generator
) -> ThrustDraws:
    """One draw of all events' thrusts from their conditional normal at every parameter point."""
    n, n_events, n_own, n_shared = collapsed.event_coupling.shape
    shared = _solve_transposed(
        collapsed.shared_factor, collapsed.shared_shift + rng.standard_normal((n, n_shared))
    )
    pull = collapsed.event_shift - (collapsed.event_coupling @ shared[:, None, :, None])[..., 0]
    white = _solve_transposed(
        collapsed.event_factor, pull + rng.standard_normal((n, n_events, n_own))
    )
    common = collapsed.common_n
    if prior.shared.ndim > 2:
        raise ValueError("levels differ between events: draw the shared coefficients instead")
    level = common[:, None] + shared @ prior.shared.T
    if collapsed.offset_n is not None:
        level = level + collapsed.offset_n
    factor = np.ones((n, n_events, 1)) if collapsed.factor is None else collapsed.factor
    return ThrustDraws(
        thrust_n=factor * level[:, None, :] + white @ prior.departures.T,
        common_n=_draw_common(prior, common, level, rng),
        level_n=level,
        factor=factor,
    )


def _draw_common(
    prior: ThrustPrior, common_n: Array, level_n: Array, rng: np.random.Generator
) -> Array:
    """The common level given every thruster's level = common + individual; the data add nothing.

    A thruster's own departure of width zero makes the common level that of every thruster.
    """
    if not level_n.shape[1]:
        return common_n
    normals = rng.standard_normal(len(level_n))
    if prior.common_sd_n == 0.0:
        return common_n
    if prior.individual_sd_n == 0.0:
        return level_n[:, 0]
    weight = prior.common_sd_n**-2 + level_n.shape[1] * prior.individual_sd_n**-2
    mean = (common_n * prior.common_sd_n**-2 + level_n.sum(-1) * prior.individual_sd_n**-2) / weight
    return np.asarray(mean + normals / np.sqrt(weight))


def thrust_moments(prior: ThrustPrior, collapsed: CollapsedThrusts) -> tuple[Array, Array]:
    """Mean and variance (n, E, K) of the thrusts that :func:`draw_thrusts` draws.

    This is the estimate, and the noise-only variance, that a fit with all nuisances held at these
    points would report; its change with them is the consider-style contribution of each nuisance.
    """
    loading, shared = prior.departures, prior.scaled(collapsed.factor).shared
    shared_inverse = np.linalg.inv(collapsed.shared_factor)
    shared_mean = (np.swapaxes(shared_inverse, -1, -2) @ collapsed.shared_shift[..., None])[..., 0]
    own_inverse_t = np.swapaxes(np.linalg.inv(collapsed.event_factor), -1, -2)
    pull = (
        collapsed.event_shift - (collapsed.event_coupling @ shared_mean[:, None, :, None])[..., 0]
    )
    own_mean = (own_inverse_t @ pull[..., None])[..., 0]
    # thrust = … + [S − L gain] (η − η̂) + L (own noise)
    gain = own_inverse_t @ collapsed.event_coupling
    response = (shared - loading @ gain) @ np.swapaxes(shared_inverse, -1, -2)[:, None]
    spread = loading @ own_inverse_t
    common = collapsed.common_n[:, None, None]
    if shared.ndim == 2:
        levels = (shared_mean @ shared.T)[:, None, :]
    else:
        levels = (shared @ shared_mean[:, None, :, None])[..., 0]
    departures = (
        own_mean @ loading.T if loading.ndim == 2 else (loading @ own_mean[..., None])[..., 0]
    )
    centre = common if collapsed.offset_n is None else common + _each_event(collapsed.offset_n)
    if collapsed.factor is not None:
        centre = collapsed.factor * centre
    mean = centre + departures + levels
    return mean, (spread**2).sum(-1) + (response**2).sum(-1)


def level_moments(prior: ThrustPrior, collapsed: CollapsedThrusts) -> tuple[Array, Array]:
    """Mean and standard deviation (n, 1 + K) of the common thrust, then of every thruster's level.

    In prior standard deviations from the prior mean, N; of levels that all events share, (K, q).
    With Σ = S Sᵀ the prior covariance of levels the common one is regressed on them by
    w = σ_c² Σ⁺ 1, which leaves σ_c² − wᵀ Σ w of its variance.
    """
    shared = prior.shared
    covariance = shared @ shared.T
    variance = prior.common_sd_n**2
    weights = variance * np.linalg.pinv(covariance, hermitian=True).sum(0)
    left = max(variance - float(weights @ covariance @ weights), 0.0)
    rows = np.concatenate([(weights @ shared)[None], shared])
    inverse = np.linalg.inv(collapsed.shared_factor)
    mean = (np.swapaxes(inverse, -1, -2) @ collapsed.shared_shift[..., None])[..., 0] @ rows.T
    spread = ((rows @ np.swapaxes(inverse, -1, -2)) ** 2).sum(-1)
    spread[:, 0] += left
    size = np.sqrt(np.concatenate([[variance], np.diagonal(covariance)]))
    unit = np.where(size > 0.0, size, 1.0)
    return np.asarray(mean / unit), np.where(size > 0.0, np.sqrt(spread) / unit, 1.0)


def prior_thrusts(
    prior: ThrustPrior,
    parameters: Parameters,
    shape: tuple[int, int],
    rng: np.random.Generator,
    factor: Array | None = None,
) -> ThrustDraws:
    """Thrusts drawn from their prior, for ``shape`` = (draws n, events E).

    ``factor`` (n, E, K) is that of effects on the levels.
    """
    drawn = _prior_thrusts(prior, parameters, shape, rng)
    if factor is None:
        return drawn
    moved = (factor - 1.0) * drawn.level_n[:, None, :]
    return replace(drawn, thrust_n=drawn.thrust_n + moved, factor=factor)


def _prior_thrusts(
    prior: ThrustPrior, parameters: Parameters, shape: tuple[int, int], rng: np.random.Generator
) -> ThrustDraws:
    n, thrusters = shape[0], len(prior.shared)
    common = prior.common_at(parameters, n)
    if not thrusters:
        return ThrustDraws(np.zeros((*shape, 0)), common, np.zeros((n, 0)))
    own = (*shape, prior.departures.shape[1])
    if prior.chained is not None:
        white = rng.standard_normal(own)
        spread = rng.standard_normal((n, prior.shared.shape[1])) @ prior.shared.T
        level = prior.chained.levels_n(parameters) + spread
        common = _draw_common(prior, common, level, rng)
    else:
        individual = prior.individual_sd_n * rng.standard_normal((n, thrusters))
        common = common + prior.common_sd_n * rng.standard_normal(n)
        white = rng.standard_normal(own)
        level = common[:, None] + individual
    return ThrustDraws(level[:, None, :] + white @ prior.departures.T, common, level)


def thrust_log_prior(prior: ThrustPrior, parameters: Parameters, draws: ThrustDraws) -> Array:
    """Log prior density (n,) of drawn thrusts: common level, thrusters' levels, departures."""
    departure = draws.thrust_n - draws.factor * draws.level_n[:, None, :]
    if prior.chained is not None:
        departures = draws.level_n - prior.chained.levels_n(parameters)
        level = np.asarray(np.linalg.solve(prior.shared, departures.T).T, dtype=np.float64)
        scale = np.log(np.diagonal(prior.shared)).sum()
        thrust = normal_log_density(level, 1.0).sum(-1) - scale
    else:
        mean = prior.common_at(parameters, len(draws.common_n))
        thrust = normal_log_density(draws.common_n - mean, prior.common_sd_n)
        individual = draws.level_n - draws.common_n[:, None]
        thrust = thrust + normal_log_density(individual, prior.individual_sd_n).sum(-1)
    if prior.departures.shape[1]:
        white = departure @ np.linalg.pinv(prior.departures).T
        scale = 0.5 * np.linalg.slogdet(prior.departures.T @ prior.departures)[1]
        thrust = thrust + (normal_log_density(white, 1.0).sum(-1) - scale).sum(-1)
    return np.asarray(thrust)


def normal_log_density(values: Array, sd: Array | float) -> Array:
    """log N(values; 0, sd²), 0 where sd is 0 (a fixed parameter has no density)."""
    scale = np.where(np.asarray(sd) > 0, sd, 1.0)
    density = -0.5 * (values / scale) ** 2 - np.log(scale * np.sqrt(2.0 * np.pi))
    return np.where(np.asarray(sd) > 0, density, 0.0)
