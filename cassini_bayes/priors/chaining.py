"""The posterior of one fit as the prior of the next: moments of its joint draws.

A priors file may name an earlier fit (``from_fit``). Shared walked parameters then have, instead of
their own priors, the normal distribution with the mean and covariance of that fit's draws, in the
standard coordinates z of the file's distributions (a positive parameter stays positive). Thrust
levels, which are integrated out, have a normal given z: its mean is the regression of the levels
on z, its covariance what the regression leaves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.stats import kurtosis, skew

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.netcdf import read_groups
from cassini_bayes.files.storage import digest
from cassini_bayes.priors.distributions import Distribution, standard_columns
from cassini_bayes.priors.parameter_space import JointNormal
from cassini_bayes.spacecraft import Spacecraft
from cassini_bayes.spacecraft.parameters import SOFTWARE, THRUST_COMMON

LEVELS: Final = "thrust_level_n"
WHEEL_INERTIA: Final = "rwa_inertia_kg_m2"
MOST_SKEW: Final = 0.75
LEAST_KURTOSIS: Final = -1.0  # two modes
MOST_KURTOSIS: Final = 2.0  # a Student-t of seven degrees of freedom
MOST_DISTANCE_SPREAD: Final = 1.5
FEWEST_DRAWS: Final = 1_000
MOST_DRAWS: Final = 16_000


@dataclass(frozen=True)
class ChainedLevels:
    """Mean of the thrust levels given the walked parameters, from an earlier fit.

    A full quadratic in the standard coordinates z of ``names``: thrust and tail-off trade along a
    curve (a longer tail with less thrust), which a straight line would blur.
    """

    names: tuple[str, ...]
    distributions: tuple[Distribution, ...]
    coefficients: Array  # (1 + m + m (m + 1)/2, K)

    def levels_n(self, parameters: Mapping[str, ArrayLike]) -> Array:
        """Mean levels (..., K) at walked parameters name → (...,)."""
        z = standard_columns(self.names, self.distributions, parameters)
        return np.asarray(quadratic(z) @ self.coefficients)


def quadratic(z: Array) -> Array:
    """Columns 1, z_i, z_i z_j of a full quadratic: (..., m) → (..., 1 + m + m (m + 1)/2)."""
    rows, columns = np.triu_indices(z.shape[-1])
    one = np.ones((*z.shape[:-1], 1))
    return np.concatenate([one, z, z[..., rows] * z[..., columns]], axis=-1)


@dataclass(frozen=True)
class EarlierFit:
    """Draws of an earlier fit: walked parameters in z (n, m) and thrust levels in N (n, K).

    ``digest`` is the SHA-256 of the file.
    """

    names: tuple[str, ...]
    distributions: tuple[Distribution, ...]
    thrusters: tuple[str, ...]
    z: Array
    levels_n: Array
    path: str
    digest: str

    def joint(self, names: Sequence[str]) -> JointNormal:
        """The normal of those of ``names`` that the earlier fit had, the others left out."""
        kept = [i for i, name in enumerate(self.names) if name in names]
        return JointNormal(
            names=tuple(self.names[i] for i in kept),
            mean=self.z[:, kept].mean(0),
            factor=_lower(np.cov(self.z[:, kept], rowvar=False)),
        )

    def levels(self, names: Sequence[str]) -> tuple[ChainedLevels, Array]:
        """Levels given those of ``names``: their mean, and a factor of their covariance (K, K)."""
        kept = [i for i, name in enumerate(self.names) if name in names]
        coefficients, rest = _regression(self.z[:, kept], self.levels_n)
        chained = ChainedLevels(
            names=tuple(self.names[i] for i in kept),
            distributions=tuple(self.distributions[i] for i in kept),
            coefficients=coefficients,
        )
        spent = len(coefficients)  # the regression follows noise with each coefficient
        return chained, _lower(rest.T @ rest / (len(rest) - spent))


def _regression(z: Array, levels_n: Array) -> tuple[Array, Array]:
    """Coefficients of the quadratic of levels (n, K) in z (n, m), and the residuals (n, K)."""
    columns = quadratic(z)
    coefficients = np.linalg.lstsq(columns, levels_n, rcond=None)[0]
    return np.asarray(coefficients, dtype=np.float64), levels_n - columns @ coefficients


def _lower(covariance: Array) -> Array:
    return np.asarray(np.linalg.cholesky(np.atleast_2d(covariance)), dtype=np.float64)


def read_earlier(
    path: Path,
    where: str,
    distributions: Mapping[str, Distribution],
    spacecraft: Spacecraft,
    thrusters: Sequence[str],
) -> EarlierFit:
    """Moments of the joint posterior in ``fit.nc``.

    Parameters
    ----------
    path, where
        The file, and the key of the priors file that names it.
    distributions
        Free parameters of the priors file; those that the fit walked are chained.
    spacecraft
        That of the priors file: its wheels.
    thrusters
        Thrusters of the branch in order: the fit has to be of the same.

    Raises
    ------
    InputError
        No such fit, another branch, nothing to chain, or draws that are visibly not normal.
    """
    posterior, content = _posterior(path, where)
    if LEVELS not in posterior:
        raise InputError(where, "a fit with thrust levels", str(path), "name a fit of wheel biases")
    result = tuple(str(name) for name in posterior.coords["thruster"].values)
    if result != tuple(thrusters):
        raise InputError(
            where, f"a fit of {', '.join(thrusters)}", ", ".join(result), "chain fits of one branch"
        )
    wheels = inertia_wheels(posterior, spacecraft)
    columns, names = [], []
    for name, distribution in distributions.items():
        # the levels hold the common one, unless it is walked
        if name in SOFTWARE or (name == THRUST_COMMON and distribution.is_normal):
            continue
        values = _draws(posterior, name, wheels)
        if values is not None:
            names.append(name)
            columns.append(distribution.standard_of(values))
    if not names:
        raise InputError(
            where,
            "a free parameter that the earlier fit walked",
            f"none: what {path} walked is fixed here, or not in this file",
            "give one of them dist in place of fixed, or leave from_fit out",
        )
    levels = posterior[LEVELS].values.reshape(-1, len(result))
    step = -(-len(levels) // MOST_DRAWS)
    z, levels = np.stack(columns, axis=-1)[::step], np.asarray(levels[::step], dtype=np.float64)
    _refuse_visibly_other(z, levels, (*names, *result), where, path)
    return EarlierFit(
        names=tuple(names),
        distributions=tuple(distributions[name] for name in names),
        thrusters=result,
        z=z,
        levels_n=levels,
        path=str(path),
        digest=content,
    )


def _posterior(path: Path, where: str) -> tuple[xr.Dataset, str]:
    try:
        groups, _ = read_groups(path, {"posterior": ()}, "the fit.nc of a finished run")
    except InputError as error:
        raise InputError(where, error.expected, f"{path}: {error.got}", error.fix) from None
    return groups["posterior"], digest(path)


def inertia_wheels(posterior: xr.Dataset, spacecraft: Spacecraft) -> dict[str, str]:
    """Inertia parameter → name of the first wheel that has it, of those in a posterior.

    Wheels may share a parameter, and a fit has prime wheels only.
    """
    if WHEEL_INERTIA not in posterior:
        return {}
    fitted = set(map(str, posterior[WHEEL_INERTIA].coords["wheel"].values))
    return {
        wheel.inertia_parameter: wheel.name
        for wheel in reversed(spacecraft.wheels)
        if wheel.name in fitted
    }


def _draws(posterior: xr.Dataset, name: str, wheels: Mapping[str, str]) -> Array | None:
    """Draws (n,) of a parameter that the earlier fit walked; None where it did not."""
    if name in wheels:
        values = posterior[WHEEL_INERTIA].sel(wheel=wheels[name]).values.reshape(-1)
    elif name in posterior and posterior[name].ndim == 2:  # one number per draw
        values = posterior[name].values.reshape(-1)
    else:
        return None
    return np.asarray(values, dtype=np.float64) if np.ptp(values) > 0 else None


def _refuse_visibly_other(
    z: Array, levels_n: Array, labels: Sequence[str], where: str, path: Path
) -> None:
    """Refuse draws that what is handed on does not describe.

    Skewness and excess kurtosis of z (n, m) and of what the quadratic leaves of the levels (n, K),
    coordinate by coordinate and along principal axes, and the spread of the squared distances from
    the mean, which for a normal of p coordinates is √(2 p).
    """

    def refuse(what: str) -> InputError:
        return InputError(
            where,
            "draws that are near normal (moments are all that is handed on)",
            f"{path}: {what}",
            "fit both sets of events together instead",
        )

    if len(z) < max(FEWEST_DRAWS, 4 * quadratic(z[:1]).shape[1]):
        raise refuse(f"{len(z)} draws of {len(labels)} numbers: too few for their moments")
    for label, column in zip(labels, z.T, strict=False):
        if not np.isfinite(column).all():
            raise refuse(f"{label} leaves the support of its prior in this file")
    draws = np.concatenate([z, _regression(z, levels_n)[1]], axis=-1)
    values, vectors = np.linalg.eigh(np.corrcoef(draws, rowvar=False))
    white = (draws - draws.mean(0)) / draws.std(0) @ (vectors / np.sqrt(values))
    axes = [f"principal axis {i + 1}" for i in range(len(values))]
    for label, column in zip((*labels, *axes), (*draws.T, *white.T), strict=True):
        lean, tails = float(skew(column)), float(kurtosis(column))
        if abs(lean) > MOST_SKEW or not LEAST_KURTOSIS < tails < MOST_KURTOSIS:
            raise refuse(f"{label} has skewness {lean:.2f} and excess kurtosis {tails:.2f}")
    spread = float((white**2).sum(-1).std() / np.sqrt(2.0 * len(values)))
    if not 1.0 / MOST_DISTANCE_SPREAD < spread < MOST_DISTANCE_SPREAD:
        raise refuse(f"distances from the mean scatter {spread:.1f} times as for a normal")
