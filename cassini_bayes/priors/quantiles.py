"""Quantiles of distributions in standard-normal coordinates: θ = F⁻¹(Φ(z)), its inverse, log p(θ).

The distributions that a fit meets on every step (norm, lognorm, uniform, halfnorm, and the first
two between bounds) have closed forms; any other continuous distribution of ``scipy.stats`` goes
through its ``ppf`` and ``isf``. Both tails are kept accurate by working with the smaller of F and
the survival function 1 − F: between bounds F(θ) = F(low) Φ(−z) + F(high) Φ(z), and the same with
the survival function, are sums of positive numbers, so neither cancels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf, erfcinv, erfinv, log_ndtr, ndtr, ndtri, ndtri_exp

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property

_HALF_LOG_2PI: Final = 0.5 * math.log(2.0 * math.pi)
_SQRT_2: Final = math.sqrt(2.0)
NORMAL_90: Final = 1.6448536269514722
"""Half-width of a normal's 90 % interval, in its standard deviations."""


def standard_normal_log_density(z: ArrayLike) -> Array:
    """log N(z; 0, 1) = −½ z² − ½ log 2π, elementwise."""
    return np.asarray(-0.5 * np.square(z) - _HALF_LOG_2PI)


class Kernel(Protocol):
    """What a distribution needs: quantile and its inverse in z, and the density in θ."""

    def quantile_of_standard(self, z: Array) -> Array:
        """θ = F⁻¹(Φ(z)), elementwise."""

    def standard_of(self, x: Array) -> Array:
        """z = Φ⁻¹(F(θ)), elementwise; ∓inf at and beyond the ends of the support."""

    def log_density(self, x: Array) -> Array:
        """log p(θ), elementwise; −inf outside the support."""


@dataclass(frozen=True)
class Normal:
    """θ = loc + scale · z."""

    loc: float
    scale: float

    def quantile_of_standard(self, z: Array) -> Array:
        """θ = F⁻¹(Φ(z)), elementwise."""
        return self.loc + self.scale * z

    def standard_of(self, x: Array) -> Array:
        """z = Φ⁻¹(F(θ)), elementwise."""
        return (x - self.loc) / self.scale

    def log_density(self, x: Array) -> Array:
        """log p(θ), elementwise; −inf outside the support."""
        return standard_normal_log_density((x - self.loc) / self.scale) - math.log(self.scale)


@dataclass(frozen=True)
class LogNormal:
    """θ = loc + scale · exp(s z)."""

    s: float
    loc: float
    scale: float

    def quantile_of_standard(self, z: Array) -> Array:
        """θ = F⁻¹(Φ(z)), elementwise."""
        return self.loc + self.scale * np.exp(self.s * z)

    def standard_of(self, x: Array) -> Array:
        """z = Φ⁻¹(F(θ)), elementwise."""
        ratio = (x - self.loc) / self.scale
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.where(ratio > 0, ratio, 0.0)) / self.s)

    def log_density(self, x: Array) -> Array:
        """log p(θ), elementwise; −inf outside the support."""
        inside = x > self.loc
        ratio = np.where(inside, (x - self.loc) / self.scale, 1.0)
        log_ratio = np.log(ratio)
        density = standard_normal_log_density(log_ratio / self.s) - log_ratio
        return np.where(inside, density - math.log(self.s * self.scale), -np.inf)


@dataclass(frozen=True)
class Uniform:
    """Uniform between ``low`` and ``high``."""

    low: float
    high: float

    def quantile_of_standard(self, z: Array) -> Array:
        """θ = F⁻¹(Φ(z)), elementwise."""
        width = self.high - self.low
        return np.asarray(np.where(z < 0, self.low + width * ndtr(z), self.high - width * ndtr(-z)))

    def standard_of(self, x: Array) -> Array:
        """z = Φ⁻¹(F(θ)), elementwise."""
        from_low = np.clip((x - self.low) / (self.high - self.low), 0.0, 1.0)
        from_high = np.clip((self.high - x) / (self.high - self.low), 0.0, 1.0)
        return np.asarray(np.where(from_low < 0.5, ndtri(from_low), -ndtri(from_high)))

    def log_density(self, x: Array) -> Array:
        """log p(θ), elementwise; −inf outside the support."""
        inside = (x >= self.low) & (x <= self.high)
        return np.where(inside, -math.log(self.high - self.low), -np.inf)


@dataclass(frozen=True)
class HalfNormal:
    """Upper half of N(loc, scale²): 1 − F = 2 Φ(−(θ − loc)/scale)."""

    loc: float
    scale: float

    def quantile_of_standard(self, z: Array) -> Array:
        """θ = F⁻¹(Φ(z)), elementwise."""
        lower = erfinv(ndtr(np.minimum(z, 0.0)))
        upper = erfcinv(ndtr(-np.maximum(z, 0.0)))
        return np.asarray(self.loc + self.scale * _SQRT_2 * np.where(z < 0, lower, upper))

    def standard_of(self, x: Array) -> Array:
        """z = Φ⁻¹(F(θ)), elementwise."""
        y = np.maximum((x - self.loc) / self.scale, 0.0)
        lower = ndtri(erf(np.minimum(y, 1.0) / _SQRT_2))
        upper = -ndtri_exp(log_ndtr(-np.maximum(y, 0.5)) + math.log(2.0))
        return np.asarray(np.where(y < 0.67, lower, upper))

    def log_density(self, x: Array) -> Array:
        """log p(θ), elementwise; −inf outside the support."""
        density = standard_normal_log_density((x - self.loc) / self.scale)
        return np.where(x >= self.loc, density + math.log(2.0 / self.scale), -np.inf)


def _log_normal_mass(low: float, high: float) -> float:
    """log P(low < Z < high) of a standard normal, from the tail in which nothing cancels."""
    if low > 0:
        low, high = -high, -low
    log_high, log_low = float(log_ndtr(high)), float(log_ndtr(low))
    return log_high + math.log1p(-math.exp(log_low - log_high)) if log_high > log_low else -math.inf


@dataclass(frozen=True)
class Truncated:
    """A normal or log-normal between bounds; ``low`` and ``high`` are bounds of θ."""

    base: Normal | LogNormal
    low: float
    high: float

    @cached_property
    def _standard_bounds(self) -> tuple[float, float]:
        ends = self.base.standard_of(np.array([self.low, self.high]))
        return float(ends[0]), float(ends[1])

    @cached_property
    def _log_tails(self) -> tuple[float, float, float, float]:
        low, high = self._standard_bounds
        ends = log_ndtr(np.array([low, high, -low, -high]))
        return float(ends[0]), float(ends[1]), float(ends[2]), float(ends[3])

    @cached_property
    def log_mass(self) -> float:
        """Log probability of the untruncated distribution between the bounds."""
        return _log_normal_mass(*self._standard_bounds)

    def quantile_of_standard(self, z: Array) -> Array:
        """θ = F⁻¹(Φ(z)), elementwise."""
        below_low, below_high, above_low, above_high = self._log_tails
        log_down, log_up = log_ndtr(-z), log_ndtr(z)
        log_below = np.logaddexp(below_low + log_down, below_high + log_up)
        log_above = np.logaddexp(above_low + log_down, above_high + log_up)
        y = np.where(
            log_below < log_above,
            ndtri_exp(np.minimum(log_below, 0.0)),
            -ndtri_exp(np.minimum(log_above, 0.0)),
        )
        # Only rounding of the last digit can put a value outside.
        return np.clip(self.base.quantile_of_standard(y), self.low, self.high)

    def standard_of(self, x: Array) -> Array:
        """z = Φ⁻¹(F(θ)), elementwise."""
        low, high = self._standard_bounds
        y = np.clip(self.base.standard_of(x), low, high)
        below = _log_normal_mass_between(low, y) - self.log_mass
        above = _log_normal_mass_between(-high, -y) - self.log_mass
        lower, upper = ndtri_exp(np.minimum(below, 0.0)), -ndtri_exp(np.minimum(above, 0.0))
        return np.asarray(np.where(below < above, lower, upper))

    def log_density(self, x: Array) -> Array:
        """log p(θ), elementwise; −inf outside the support."""
        inside = (x >= self.low) & (x <= self.high)
        return np.where(inside, self.base.log_density(x) - self.log_mass, -np.inf)


def _log_normal_mass_between(low: float, y: Array) -> Array:
    """log P(low < Z < y) for an array of upper ends y ≥ low; −inf where y = low."""
    mirrored = low > 0
    upper = log_ndtr(-low) if mirrored else log_ndtr(y)
    lower = log_ndtr(-y) if mirrored else log_ndtr(low)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.where(np.isneginf(lower), -np.inf, lower - upper)
        return np.asarray(upper + np.log(-np.expm1(np.minimum(gap, 0.0))))


@dataclass(frozen=True)
class Generic:
    """Any continuous distribution of scipy.stats, between bounds or not."""

    frozen: Any  # scipy.stats frozen distribution; scipy ships no type for it
    low: float
    high: float

    @cached_property
    def _tails(self) -> tuple[float, float, float, float]:
        cdf, sf = self.frozen.cdf, self.frozen.sf
        ends = (cdf(self.low), cdf(self.high), sf(self.low), sf(self.high))
        return float(ends[0]), float(ends[1]), float(ends[2]), float(ends[3])

    @cached_property
    def mass(self) -> float:
        """Probability of the untruncated distribution between the bounds."""
        below_low, below_high, above_low, above_high = self._tails
        return below_high - below_low if below_low < above_low else above_low - above_high

    def quantile_of_standard(self, z: Array) -> Array:
        """θ = F⁻¹(Φ(z)), elementwise."""
        below_low, below_high, above_low, above_high = self._tails
        down, up = ndtr(-z), ndtr(z)
        below = np.asarray(below_low * down + below_high * up)
        above = np.asarray(above_low * down + above_high * up)
        lower = below < above
        x = np.empty_like(below)
        # scipy's inverses are slow and fussy far outside their half: each gets its own only.
        x[lower] = self.frozen.ppf(below[lower])
        x[~lower] = self.frozen.isf(above[~lower])
        return np.asarray(np.clip(x, self.low, self.high))

    def standard_of(self, x: Array) -> Array:
        """z = Φ⁻¹(F(θ)), elementwise."""
        below_low, _, _, above_high = self._tails
        x = np.clip(x, self.low, self.high)
        below = np.clip((self.frozen.cdf(x) - below_low) / self.mass, 0.0, 1.0)
        above = np.clip((self.frozen.sf(x) - above_high) / self.mass, 0.0, 1.0)
        return np.asarray(np.where(below < above, ndtri(below), -ndtri(above)))

    def log_density(self, x: Array) -> Array:
        """log p(θ), elementwise; −inf outside the support."""
        inside = (x >= self.low) & (x <= self.high)
        density = np.asarray(self.frozen.logpdf(x)) - math.log(self.mass)
        return np.where(inside, density, -np.inf)
