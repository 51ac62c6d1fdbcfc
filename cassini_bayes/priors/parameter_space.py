"""The ordered space of parameters a model walks in: names, priors, fixed values, coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from cassini_bayes.computing.arrays import Array
from cassini_bayes.priors.distributions import Distribution, standard_columns
from cassini_bayes.priors.quantiles import standard_normal_log_density


@dataclass(frozen=True)
class JointNormal:
    """Correlated normal of some parameters' standard coordinates: mean (m,) + factor (m, m) u.

    It stands in for their own unit normals where an earlier fit gives more than a prior each.
    """

    names: tuple[str, ...]
    mean: Array
    factor: Array


@dataclass(frozen=True)
class ParameterSpace:
    """An ordered space of free parameters, walked in standard-normal coordinates z.

    Parameters
    ----------
    names
        The d free parameters in order; no name occurs twice.
    fixed
        Parameters carried along at a fixed value.
    distributions, blocks
        Prior and block (``thrust``, ``centre of mass``, …) of each free parameter, as ``names``.
    joint
        Joint normal of some of ``names``: their z is mean + factor u with u walked in its place, so
        what is walked has the prior N(0, 1) all the same.
    """

    names: tuple[str, ...]
    fixed: Mapping[str, float]
    distributions: tuple[Distribution, ...]
    blocks: tuple[str, ...]
    joint: JointNormal | None = field(default=None, compare=False)
    _loc: Array = field(init=False, repr=False, compare=False)
    _scale: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if len(set(self.names)) != len(self.names) or set(self.names) & set(self.fixed):
            raise ValueError(f"a parameter occurs twice in {self.names} and {tuple(self.fixed)}")
        if not len(self.names) == len(self.distributions) == len(self.blocks):
            raise ValueError("names, distributions and blocks must have the same length")
        object.__setattr__(self, "fixed", MappingProxyType(dict(self.fixed)))
        normal = [d if d.is_normal else None for d in self.distributions]
        loc = np.array([d.mean() if d is not None else 0.0 for d in normal])
        scale = np.array([d.sd() if d is not None else 1.0 for d in normal])
        for name, array in (("_loc", loc), ("_scale", scale)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __reduce__(self) -> tuple[object, ...]:
        # A read-only mapping cannot be sent to a worker process; the arguments can.
        arguments = (self.names, dict(self.fixed), self.distributions, self.blocks, self.joint)
        return ParameterSpace, arguments

    @property
    def dimension(self) -> int:
        """Number of free parameters d."""
        return len(self.names)

    def centre(self) -> dict[str, float]:
        """Prior mean of every walked parameter and value of every fixed one.

        With an earlier fit, where its mean lies.
        """
        if self.joint is not None:
            at_mean = self.to_parameters(np.zeros(self.dimension))
            return {name: float(value) for name, value in at_mean.items()}
        means = (distribution.mean() for distribution in self.distributions)
        return {**self.fixed, **dict(zip(self.names, means, strict=True))}

    def to_parameters(self, z: ArrayLike) -> dict[str, Array | float]:
        """θ_i = F_i⁻¹(Φ(z_i)): z (..., d) → name → (...,) array; fixed values as floats."""
        points = self._correlated(self._points(z))
        # One affine operation serves every plain normal; the others are mapped one by one.
        affine = self._loc + self._scale * points
        parameters: dict[str, Array | float] = dict(self.fixed)
        for i, (name, distribution) in enumerate(zip(self.names, self.distributions, strict=True)):
            parameters[name] = (
                affine[..., i]
                if distribution.is_normal
                else distribution.quantile_of_standard(points[..., i])
            )
        return parameters

    @property
    def correlation_factor(self) -> Array:
        """Slopes (d, d) of the standard coordinates in the walked ones: 1 without earlier fit."""
        basis = np.concatenate([np.zeros((1, self.dimension)), np.eye(self.dimension)])
        moved = self._correlated(basis)
        return np.asarray((moved[1:] - moved[0]).T)

    def to_standard(self, parameters: Mapping[str, ArrayLike]) -> Array:
        """Inverse of :meth:`to_parameters`: the free ones of name → (...,) → z (..., d)."""
        if not self.names:
            return np.empty((0,))
        z = standard_columns(self.names, self.distributions, parameters)
        if self.joint is None:
            return z
        places = self._places(self.joint)
        white = np.linalg.solve(self.joint.factor, (z[..., places] - self.joint.mean)[..., None])
        z[..., places] = white[..., 0]
        return z

    def log_prior_terms(self, z: ArrayLike) -> Array:
        """Log prior density in z of every free parameter, log N(z_i; 0, 1), shape (..., d)."""
        return standard_normal_log_density(self._points(z))

    def log_prior_by_block(self, z: ArrayLike) -> dict[str, Array]:
        """Log prior density in z summed over each block: block → (...,)."""
        terms = self.log_prior_terms(z)
        return {
            block: terms[..., [i for i, item in enumerate(self.blocks) if item == block]].sum(-1)
            for block in dict.fromkeys(self.blocks)
        }

    def sample(self, rng: np.random.Generator, n: int) -> Array:
        """``n`` independent draws of z from the prior, shape (n, d)."""
        return rng.standard_normal((n, self.dimension))

    def _correlated(self, points: Array) -> Array:
        """Standard coordinates of what is walked: joint ones from their independent ones."""
        if self.joint is None:
            return points
        places = self._places(self.joint)
        moved = points.copy()
        moved[..., places] = self.joint.mean + points[..., places] @ self.joint.factor.T
        return moved

    def _places(self, joint: JointNormal) -> list[int]:
        return [self.names.index(name) for name in joint.names]

    def _points(self, z: ArrayLike) -> Array:
        points = np.asarray(z, dtype=np.float64)
        if points.ndim == 0 or points.shape[-1] != self.dimension:
            raise ValueError(f"expected z of shape (..., {self.dimension}), got {points.shape}")
        return points
