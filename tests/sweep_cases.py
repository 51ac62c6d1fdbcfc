"""Cases for sweeps: a conjugate toy model with closed forms, and a small fit of flight events."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import xarray as xr
from scipy.stats import truncnorm
from totals_cases import flight

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model import log_posterior
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.priors.reader import Priors
from cassini_bayes.priors.starts import Starts
from cassini_bayes.results.fitting import ALL_MET
from cassini_bayes.results.groups import build_fit
from cassini_bayes.results.record import Fit
from cassini_bayes.sampling.warmstart import warm_start
from cassini_bayes.sweep.cells import Baseline
from cassini_bayes.sweep.models import Factory
from cassini_bayes.sweep.weights import batch_labels

TOY_NAMES = ("cm_x_m", "cm_y_m")
TOY_DATUM = 0.25
TOY_NOISE = 0.02


@dataclass(frozen=True)
class ToyModel:
    """One datum y = cm_x + cm_y + noise; ``blind`` has no datum (an event left out)."""

    space: ParameterSpace
    blind: bool

    @property
    def starts(self) -> Starts:
        return Starts.of(np.zeros((1, self.space.dimension)))

    @property
    def collapsed(self) -> tuple[str, ...]:
        return ()

    def log_likelihood(self, z: Array) -> Array:
        values = self.space.to_parameters(z)
        residual = TOY_DATUM - values["cm_x_m"] - values["cm_y_m"]
        return np.asarray(-0.5 * (residual / TOY_NOISE) ** 2 * (not self.blind))

    def quantities(self, z: Array, rng: np.random.Generator) -> xr.Dataset:
        del rng  # nothing is left to be drawn
        values = self.space.to_parameters(z)
        return xr.Dataset(
            {
                name: xr.DataArray(
                    np.asarray(values[name])[None], dims=("chain", "draw"), attrs={"units": "m"}
                )
                for name in TOY_NAMES
            }
        )


@dataclass(frozen=True)
class ToyFactory:
    """Makes the toy with any priors of the two centres of mass."""

    priors: Priors
    event_ids: tuple[str, ...] = ("datum",)

    def build(self, priors: Priors, without: str = "") -> ToyModel:
        return ToyModel(priors.space(TOY_NAMES), without == "datum")


def toy_exact(priors: Priors) -> tuple[Array, Array]:
    """Posterior mean and standard deviation of the toy under normal priors."""
    found = [priors.parameters[name].distribution for name in TOY_NAMES]
    mean = np.array([d.keywords["loc"] for d in found if d is not None])
    sd = np.array([d.keywords["scale"] for d in found if d is not None])
    gain = sd**2 / ((sd**2).sum() + TOY_NOISE**2)
    centre = mean + gain * (TOY_DATUM - mean.sum())
    return centre, np.sqrt(sd**2 - gain * sd**2)


def toy_baseline(n: int = 8_000, seed: int = 1) -> Baseline:
    """Independent exact draws of the toy's posterior."""
    _, priors = flight(1)
    factory = ToyFactory(priors)
    space = priors.space(TOY_NAMES)
    rng = np.random.default_rng(seed)
    draws = space.to_parameters(space.sample(rng, n))
    x = np.stack([np.asarray(draws[name]) for name in TOY_NAMES], -1)
    sd = np.array([priors.parameters[name].distribution.sd() for name in TOY_NAMES])
    gain = sd**2 / ((sd**2).sum() + TOY_NOISE**2)
    # a prior draw moved by its own simulated misfit is a posterior draw (linear and normal)
    x = x + gain * (TOY_DATUM - x.sum(-1) - TOY_NOISE * rng.standard_normal(n))[:, None]
    parameters = {name: x[:, i] for i, name in enumerate(TOY_NAMES)}
    z = space.to_standard(parameters)
    return Baseline(
        factory=factory,
        parameters=parameters,
        names=TOY_NAMES,
        values=x,
        log_likelihood=factory.build(priors).log_likelihood(z),
        batches=batch_labels(4, n // 4),
        seed=3,
    )


def bounded_baseline(n: int = 8_000) -> Baseline:
    """Exact draws of the toy with a uniform prior of cm_x_m that cuts its posterior off.

    Its likelihood is a normal N(c, s²) of cm_x_m; the prior is uniform from c + s/2 to c + 3s/2.
    """
    baseline = toy_baseline(n)
    centre, width, other = bounded_likelihood(baseline.factory.priors)
    uniform = Distribution("uniform", {"loc": centre + 0.5 * width, "scale": width})
    factory = ToyFactory(baseline.factory.priors.with_distribution("cm_x_m", uniform))
    rng = np.random.default_rng(2)
    x = truncnorm.rvs(0.5, 1.5, centre, width, size=n, random_state=rng)
    gain = other.sd() ** 2 / width**2
    y = other.mean() + gain * (TOY_DATUM - x - other.mean())
    y = y + np.sqrt(gain) * TOY_NOISE * rng.standard_normal(n)
    parameters = {"cm_x_m": x, "cm_y_m": y}
    z = factory.build(factory.priors).space.to_standard(parameters)
    return replace(
        baseline,
        factory=factory,
        parameters=parameters,
        values=np.stack([x, y], -1),
        log_likelihood=factory.build(factory.priors).log_likelihood(z),
    )


def bounded_likelihood(priors: Priors) -> tuple[float, float, Distribution]:
    """Centre and sd of the toy's likelihood of cm_x_m, and the normal prior of cm_y_m."""
    other = priors.parameters["cm_y_m"].distribution
    assert other is not None
    return TOY_DATUM - other.mean(), float(np.hypot(other.sd(), TOY_NOISE)), other


@cache
def small_fit(draws: int = 1_000) -> tuple[Factory, Fit]:
    """Importance draws, four "chains" of them, of the first two flight events without ΔV.

    Nobody may change it: all tests of a process have the same.
    """
    rows, priors = flight(2)
    factory = Factory(rows, priors, delta_v="ignore")
    model = factory.build(priors).model
    rng = np.random.default_rng(7)
    density = partial(log_posterior, model)
    warm = warm_start(density, model.space.dimension, rng, draws=6_000)
    z = warm.draws.resample(rng, 4 * draws)
    shaped = z.reshape(4, draws, -1)
    values = density(z).reshape(4, draws)
    said = {"walkers": 1, "stop_rule": ALL_MET}
    return factory, build_fit(model, shaped, values, rng, said, 2_000)
