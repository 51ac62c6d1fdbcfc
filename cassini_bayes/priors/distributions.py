"""One-dimensional prior distributions, walked in standard-normal coordinates.

Every free parameter θ is walked as z with θ = F⁻¹(Φ(z)), F the prior's cumulative distribution and
Φ the standard normal one: the prior of z is N(0, 1) whatever F is. Names and keywords are those of
``scipy.stats``. Bounds truncate: the density is renormalised inside them, nothing piles up at a
bound. The formulae are in :mod:`cassini_bayes.priors.quantiles`; here a distribution is named,
checked, and given its moments and variants.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import closest, finite_number, nearest
from cassini_bayes.priors.quantiles import (
    Generic,
    HalfNormal,
    Kernel,
    LogNormal,
    Normal,
    Truncated,
    Uniform,
    standard_normal_log_density,
)

# A prior with less of its probability between its bounds than this was not meant.
LEAST_SCALE: Final = 1e-100
"""Of a width: numbers divided by a smaller one may overflow."""
_LEAST_MASS: Final = 1e-12
_MOMENT_GRID: Final = np.linspace(-20.0, 20.0, 8001)


def _scipy_family(name: str) -> Any | None:
    family = getattr(stats, name, None) if name.isidentifier() else None
    return family if isinstance(family, stats.rv_continuous) else None


def distribution_names() -> tuple[str, ...]:
    """Names of all continuous distributions of ``scipy.stats``, sorted."""
    return tuple(sorted(name for name in dir(stats) if _scipy_family(name) is not None))


def keywords_of(name: str) -> tuple[str, ...]:
    """Keywords of the scipy.stats distribution ``name``: its shapes, then ``loc`` and ``scale``."""
    family = _scipy_family(name)
    shapes = (family.shapes or "") if family is not None else ""
    return (*(part.strip() for part in shapes.split(",") if part), "loc", "scale")


@dataclass(frozen=True)
class Distribution:
    """A continuous distribution of ``scipy.stats``, optionally truncated.

    Parameters
    ----------
    name, keywords
        scipy.stats name and keywords (shapes, ``loc``, ``scale``; loc 0 and scale 1 by default).
    low, high
        Bounds of the support. The density is renormalised between them (truncation, no clipping).
    where
        File and dotted key for the messages of errors; not kept.

    Raises
    ------
    InputError
        Unknown name, unknown or missing keyword, a value that is not finite, scale ≤ 0, shapes
        outside their domain, low ≥ high, or (next to) no probability between the bounds.
    """

    name: str
    keywords: Mapping[str, float]
    low: float | None = None
    high: float | None = None
    where: InitVar[str] = ""
    _kernel: Kernel = field(init=False, repr=False, compare=False)

    def __post_init__(self, where: str) -> None:
        where = where or f"distribution {self.name}"
        keywords = check_keywords(where, self.name, self.keywords)
        object.__setattr__(self, "keywords", MappingProxyType(keywords))
        for key in ("low", "high"):
            value = getattr(self, key)
            if value is not None:
                object.__setattr__(self, key, finite_number(f"{where}.{key}", value))
        kernel = _kernel_of(where, self.name, keywords, self.low, self.high)
        object.__setattr__(self, "_kernel", kernel)

    def __hash__(self) -> int:
        return hash((self.name, tuple(sorted(self.keywords.items())), self.low, self.high))

    def __repr__(self) -> str:
        given = {"low": self.low, "high": self.high}
        bounds = "".join(f", {k}={value!r}" for k, value in given.items() if value is not None)
        return f"Distribution({self.name!r}, {dict(self.keywords)!r}{bounds})"

    def __reduce__(self) -> tuple[Any, ...]:
        # A read-only mapping cannot be sent to a worker process; the arguments can.
        return Distribution, (self.name, dict(self.keywords), self.low, self.high)

    @property
    def loc(self) -> float:
        """Keyword ``loc``, 0 if left out."""
        return self.keywords.get("loc", 0.0)

    @property
    def scale(self) -> float:
        """Keyword ``scale``, 1 if left out."""
        return self.keywords.get("scale", 1.0)

    @property
    def is_normal(self) -> bool:
        """Whether this is a plain normal without bounds, so θ = mean + sd · z."""
        return isinstance(self._kernel, Normal)

    @property
    def support(self) -> tuple[float, float]:
        """Lower and upper end of the values that have a density."""
        return _support(self.name, self.keywords, self.low, self.high)

    def quantile_of_standard(self, z: ArrayLike) -> Array:
        """θ = F⁻¹(Φ(z)), elementwise; any shape."""
        return np.asarray(self._kernel.quantile_of_standard(np.asarray(z, dtype=np.float64)))

    def standard_of(self, x: ArrayLike) -> Array:
        """z = Φ⁻¹(F(θ)), elementwise; ∓inf at and beyond the ends of the support."""
        return np.asarray(self._kernel.standard_of(np.asarray(x, dtype=np.float64)))

    def log_density(self, x: ArrayLike) -> Array:
        """log p(θ), normalised between the bounds, elementwise; −inf outside the support."""
        return np.asarray(self._kernel.log_density(np.asarray(x, dtype=np.float64)))

    def sample(self, rng: np.random.Generator, n: int) -> Array:
        """``n`` independent draws, shape (n,)."""
        return self.quantile_of_standard(rng.standard_normal(n))

    def mean(self) -> float:
        """Mean; inf or nan where the distribution has none."""
        return _moments(self)[0]

    def sd(self) -> float:
        """Standard deviation; inf or nan where the distribution has none."""
        return _moments(self)[1]

    def scaled(self, width: float = 1.0, shift: float = 0.0) -> Distribution:
        """A wider (``width`` > 1) and shifted variant with the same bounds, for sensitivity sweeps.

        ``shift`` is in prior standard deviations before widening. Distributions on the whole line
        and on a finite interval are widened about their middle and moved. A log-normal is widened
        and moved in its logarithm. Other one-sided distributions keep their edge: their scale is
        multiplied by width · exp(shift · sd / (mean − edge)), so the mean moves by ``shift``
        standard deviations to first order and never crosses the edge.

        Raises
        ------
        InputError
            A width that is not above 0, a width or shift that is not finite.
        """
        if not (math.isfinite(width) and width > 0 and math.isfinite(shift)):
            raise InputError(
                f"distribution {self.name}",
                "a finite width factor above 0 and a finite shift",
                f"width {width!r}, shift {shift!r}",
                "give width as a factor and shift in prior standard deviations",
            )
        keywords = dict(self.keywords)
        loc, scale = self.loc, self.scale
        if self.name == "lognorm":
            s = keywords["s"]
            changed = {"s": s * width, "scale": scale * math.exp(shift * s)}
            return replace(self, keywords={**keywords, **changed})
        frozen = _frozen(self.name, keywords)
        low, high = _support(self.name, keywords, None, None)
        sd, mean = float(frozen.std()), float(frozen.mean())
        if not (math.isfinite(sd) and math.isfinite(mean)):
            sd, mean = scale, loc  # heavy tails: the scale stands in for the standard deviation
        if math.isfinite(low) and not math.isfinite(high):
            changed = {"scale": scale * width * math.exp(shift * sd / (mean - low))}
        else:
            middle = 0.5 * (low + high) if math.isfinite(high - low) else loc
            moved = middle + (loc - middle) * width + shift * sd
            changed = {"loc": moved, "scale": scale * width}
        return replace(self, keywords={**keywords, **changed})


def standard_columns(
    names: Sequence[str], distributions: Sequence[Distribution], values: Mapping[str, ArrayLike]
) -> Array:
    """Standard coordinates (..., d) of parameters name → (...,), in the order of ``names``."""
    pairs = zip(names, distributions, strict=True)
    columns = [distribution.standard_of(values[name]) for name, distribution in pairs]
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


@lru_cache(maxsize=1_024)  # every model asks for those of all its priors, several times
def _moments(own: Distribution) -> tuple[float, float]:
    if own.is_normal:
        return own.loc, own.scale
    frozen = _frozen(own.name, own.keywords)
    mean, variance = (float(value) for value in frozen.stats(moments="mv"))
    low, high = own.support
    truncated = (low, high) != _support(own.name, own.keywords, None, None)
    bounded = math.isfinite(high - low)
    if not truncated or not (bounded or math.isfinite(mean)):
        return mean, math.sqrt(variance) if variance >= 0 else math.nan
    # E[g(θ)] = ∫ g(F⁻¹(Φ(z))) φ(z) dz; the trapezoid rule converges very fast for it.
    weights = np.exp(standard_normal_log_density(_MOMENT_GRID))
    weights /= weights.sum()
    values = own.quantile_of_standard(_MOMENT_GRID)
    mean = float(weights @ values)
    if not bounded and not math.isfinite(variance):  # a bound on one side leaves the other's tail
        return mean, math.inf
    return mean, math.sqrt(float(weights @ (values - mean) ** 2))


def _frozen(name: str, keywords: Mapping[str, float]) -> Any:
    return _scipys(name, tuple(keywords.items()))


@lru_cache(maxsize=1_024)
def _scipys(name: str, keywords: tuple[tuple[str, float], ...]) -> Any:
    # the name was checked at construction; scipy takes two milliseconds to make one
    return getattr(stats, name)(**dict(keywords))


def _support(
    name: str, keywords: Mapping[str, float], low: float | None, high: float | None
) -> tuple[float, float]:
    left, right = (float(end) for end in _frozen(name, keywords).support())
    left = left if low is None else max(left, low)
    return left, right if high is None else min(right, high)


def check_keywords(
    where: str, name: str, keywords: Mapping[str, object], other_keys: Iterable[str] = ()
) -> dict[str, float]:
    """Keywords of the distribution ``name`` as floats, in scipy's order.

    ``other_keys`` are keys of the same table that are no keywords: only for the hint at a typo.

    Raises
    ------
    InputError
        ``where`` names the table; the messages add the key.
    """
    if _scipy_family(name) is None:
        raise InputError(
            f"{where}.dist",
            "the name of a continuous distribution of scipy.stats, e.g. norm, lognorm, uniform",
            repr(name),
            _nearest_distribution(name),
        )
    allowed = keywords_of(name)
    for key in keywords:
        if key not in allowed:
            expected = f"a keyword of scipy.stats.{name} ({', '.join(allowed)})"
            hint = nearest(key, (*allowed, *other_keys))
            raise InputError(f"{where}.{key}", expected, repr(key), hint)
    for key in allowed:
        if key not in keywords and key not in ("loc", "scale"):
            expected = f"the shape {key} that scipy.stats.{name} needs"
            raise InputError(f"{where}.{key}", expected, "nothing", f"add {key} = …")
    numbers = {
        key: finite_number(f"{where}.{key}", keywords[key]) for key in allowed if key in keywords
    }
    if numbers.get("scale", 1.0) < LEAST_SCALE:
        raise InputError(
            f"{where}.scale",
            "a width above 0",
            repr(keywords["scale"]),
            "give the width, or use fixed = … for a value that is certain",
        )
    low, high = _support(name, numbers, None, None)
    if math.isnan(low) or math.isnan(high):
        raise InputError(
            where,
            f"shapes inside the domain of scipy.stats.{name}",
            ", ".join(f"{key} = {value!r}" for key, value in numbers.items()),
            "see scipy's page of the distribution for what its shapes may be",
        )
    return numbers


def _nearest_distribution(name: str) -> str:
    aliases = {"normal": "norm", "gaussian": "norm", "lognormal": "lognorm", "student": "t"}
    hint = aliases.get(name.lower().replace("-", "").replace("_", ""))
    close = hint or closest(name, distribution_names())
    return f"did you mean {close!r}?" if close else "see scipy.stats, continuous distributions"


def _kernel_of(
    where: str, name: str, keywords: Mapping[str, float], low: float | None, high: float | None
) -> Kernel:
    left, right = _bounded_support(where, name, keywords, low, high)
    loc, scale = keywords.get("loc", 0.0), keywords.get("scale", 1.0)
    if name == "uniform":
        return Uniform(left, right)
    if name == "halfnorm" and right == math.inf and left <= loc:
        return HalfNormal(loc, scale)
    if name in ("norm", "lognorm", "halfnorm"):
        base = LogNormal(keywords["s"], loc, scale) if name == "lognorm" else Normal(loc, scale)
        whole = base.standard_of(np.array([left, right]))
        if np.isneginf(whole[0]) and np.isposinf(whole[1]):
            return base
        truncated = Truncated(base, left, right)
        _check_mass(where, name, math.exp(truncated.log_mass), left, right)
        return truncated
    generic = Generic(_frozen(name, keywords), left, right)
    _check_mass(where, name, generic.mass, left, right)
    return generic


def _bounded_support(
    where: str, name: str, keywords: Mapping[str, float], low: float | None, high: float | None
) -> tuple[float, float]:
    if low is not None and high is not None and low >= high:
        expected = f"a lower bound below high = {high!r}"
        raise InputError(f"{where}.low", expected, repr(low), "swap the two bounds")
    left, right = _support(name, keywords, low, high)
    if left >= right:
        _check_mass(where, name, 0.0, low, high)
    return left, right


def _check_mass(where: str, name: str, mass: float, low: float | None, high: float | None) -> None:
    if not mass >= _LEAST_MASS:
        raise InputError(
            f"{where}.low, .high",
            f"bounds with at least {_LEAST_MASS:g} of the {name}'s probability between them",
            f"{mass:.3g} between {low!r} and {high!r}",
            "move the bounds or the distribution",
        )


def check_bounds(where: str, distribution: Distribution) -> None:
    """Refuse a distribution on the whole line whose ``loc`` lies outside its own bounds.

    Raises
    ------
    InputError
        Such a prior is nearly always a slip of sign or unit.
    """
    loc = distribution.loc
    left, right = _support(distribution.name, distribution.keywords, None, None)
    if math.isfinite(left) or math.isfinite(right):
        return
    low, high = distribution.support
    if not low <= loc <= high:
        raise InputError(
            f"{where}.loc",
            f"a value between low = {low!r} and high = {high!r}",
            repr(loc),
            "mend the location or the bounds (check sign and unit)",
        )
