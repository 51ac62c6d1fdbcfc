"""What hand-picked perturbation bars are worth: coverage and length beside other error bars.

Sets of wheel biases are simulated with parameters drawn from the perturbation sizes of paper 003
§IV, read as one standard deviation or as largest error, everything else from the priors. Every set
is estimated by the papers' least squares (with perturbation bars and with the standard errors of
the fit), by a Laplace approximation and by the posterior, and each interval is held against the
truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Literal

import numpy as np
import pandas as pd
from scipy.stats import norm
from scipy.stats import t as student

from cassini_bayes.balance.totals_terms import wheel_momentum
from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.draws import draw, draw_prior
from cassini_bayes.model.posterior import Model, build_model, log_posterior
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.published import perturbations
from cassini_bayes.results.baselines import (
    MEAN,
    PER_EVENT,
    POOLED,
    correction_factor,
    perturbation_bars,
)
from cassini_bayes.sampling.ensembles import SamplerSettings, sample
from cassini_bayes.sampling.warmstart import TRUSTED_K, laplace, warm_start
from cassini_bayes.studies.repeated import Repeated
from cassini_bayes.studies.totals_calibration import simulate_totals, with_room

Reading = Literal["one sigma", "maximum"]
READINGS: Final[tuple[Reading, ...]] = ("one sigma", "maximum")

EVENT_MEAN: Final = "mean thrust of an event"
THRUSTER: Final = "thruster, all events together"
THRUSTER_EVENT: Final = "thruster in one event"
ESTIMANDS: Final = (EVENT_MEAN, THRUSTER, THRUSTER_EVENT)

RSS: Final = "perturbation bars, RSS"
WORST: Final = "perturbation bars, worst case"
SQUARES: Final = "least-squares standard error"
BOTH: Final = "RSS bars and standard error together"
LAPLACE: Final = "Laplace"
POSTERIOR: Final = "posterior"
METHODS: Final = (RSS, WORST, SQUARES, BOTH, LAPLACE, POSTERIOR)
CLAIMS: Final = (0.68, 0.9)

DRAWS: Final = 2_000
MODULE: Final = "studies.perturbation_coverage"
"""Whose code, with all that it imports, a set runs through."""
_OF_BLOCK: Final[Mapping[str, str]] = {
    "centre of mass": "center_of_mass",
    "wheel inertia": "rwa_inertia",
    "wheel alignment": "rwa4_axis",
    "geometry": "thruster_location",
}


@dataclass(frozen=True)
class CoverageCampaign(Repeated):
    """What finished sets depend on: template events, priors, seed, and how sizes are read."""

    events: Path
    priors: Path
    reading: Reading

    def repetition(self, index: int) -> dict[str, Array]:
        """Simulate and estimate one set: see :func:`covered_set`."""
        return covered_set(self, index)


def size_of(name: str, block: str) -> tuple[float, bool]:
    """Perturbation of a parameter in paper 003's list, and whether it is relative; 0 if not there.

    The list perturbs the column of the wheel's axis by 1 %: for a unit vector 0.01 rad.
    """
    percent = {entry.quantity: entry.error_percent for entry in perturbations()}
    if block == "inertia":
        diagonal = name.split("_")[1] in ("xx", "yy", "zz")
        key = "moments_of_inertia" if diagonal else "products_of_inertia"
    elif name == "tau_fall_s":
        key = "tau_fall"
    elif block in _OF_BLOCK:
        key = _OF_BLOCK[block]
    else:
        return 0.0, True
    return percent[key] / 100.0, block != "wheel alignment"


def stated_priors(priors: Priors, reading: Reading) -> Priors:
    """The priors with paper 003's sizes: normal (one sigma) or uniform up to them (maximum)."""
    for name, prior in priors.parameters.items():
        if prior.distribution is None:
            continue
        size, relative = size_of(name, prior.spec.block)
        if size == 0.0:
            continue
        centre = prior.distribution.loc
        width = size * abs(centre) if relative else size
        if reading == "one sigma":
            stated = Distribution("norm", {"loc": centre, "scale": width})
        else:
            stated = Distribution("uniform", {"loc": centre - width, "scale": 2.0 * width})
        priors = priors.with_distribution(name, stated)
    return priors


def covered_set(campaign: CoverageCampaign, index: int) -> dict[str, Array]:
    """Truth and intervals of one simulated set.

    Keys ``<estimand>.truth`` (q,), ``<estimand>.valid`` (q,), ``<estimand>.<method>.<claim>``
    (q, 2) lower and upper ends, and ``pareto_k``, ``by_chain``.
    """
    priors = stated_priors(read_priors(campaign.priors), campaign.reading)
    read = read_totals(campaign.events, priors.spacecraft)
    template = tuple(with_room(event) for event in read)
    rng = campaign.stream(READINGS.index(campaign.reading), index)
    model = build_model(template, priors)
    truth = draw_prior(model, 1, rng)
    simulated = simulate_totals(template, model, truth, rng)
    return estimated(simulated, priors, truth.thrusts.thrust_n[0], rng)


def estimated(
    events: tuple[TotalsEvent, ...], priors: Priors, thrust_n: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Every estimate of a set of events with true thrusts (E, K); see :func:`covered_set`."""
    model = build_model(events, priors)
    result = _squares(model)
    truth = estimands(model, thrust_n[None])
    for name in ESTIMANDS:
        result[f"{name}.truth"] = truth[name][0]
    draws, k, by_chain = _bayesian_draws(model, rng)
    for method, thrusts in draws.items():
        for name, values in estimands(model, thrusts).items():
            for claim in CLAIMS:
                if method == LAPLACE:
                    half = norm.isf(0.5 * (1.0 - claim)) * values.std(0, ddof=1)
                    ends = np.stack([values.mean(0) - half, values.mean(0) + half], axis=-1)
                else:
                    tail = 0.5 * (1.0 - claim)
                    ends = np.quantile(values, [tail, 1.0 - tail], axis=0).T
                result[f"{name}.{method}.{claim}"] = ends
    return {**result, "pareto_k": np.array(k), "by_chain": np.array(float(by_chain))}


def estimands(model: Model, thrust_n: Array) -> dict[str, Array]:
    """What is estimated, of thrusts (n, E, K): means weighted by on-time, and thrusts themselves.

    ``EVENT_MEAN`` (n, E), ``THRUSTER`` (n, K), ``THRUSTER_EVENT`` (n, E K).
    """
    on_time = model.totals_rows.stack.on_time_s
    weighted = thrust_n * on_time
    return {
        EVENT_MEAN: weighted.sum(-1) / on_time.sum(-1),
        THRUSTER: weighted.sum(-2) / on_time.sum(0),
        THRUSTER_EVENT: thrust_n.reshape(len(thrust_n), -1),
    }


def _bayesian_draws(model: Model, rng: np.random.Generator) -> tuple[dict[str, Array], float, bool]:
    """Thrusts (n, E, K) from the Laplace normal and from the posterior; k̂, and if by a chain."""
    density = partial(log_posterior, model)
    d = model.space.dimension
    warm = warm_start(density, d, rng, pilots=1, draws=DRAWS)
    by_chain = not warm.draws.pareto_k < TRUSTED_K
    if by_chain:
        settings = SamplerSettings(target_ess=DRAWS // 2, seed=int(rng.integers(2**31)))
        z = sample(density, warm.proposal, settings).thinned(DRAWS // 4)[0].reshape(-1, d)
    else:
        z = warm.draws.resample(rng, DRAWS)
    mode, factor = laplace(density, warm.mode)
    normal = mode + rng.standard_normal((DRAWS, d)) @ factor.T
    thrusts = {
        LAPLACE: draw(model, normal, rng).thrusts.thrust_n,
        POSTERIOR: draw(model, z, rng).thrusts.thrust_n,
    }
    return thrusts, warm.draws.pareto_k, by_chain


def _squares(model: Model) -> dict[str, Array]:
    """The papers' least squares: intervals from perturbations and from the fit's own scatter."""
    nominal = model.space.centre()
    table = perturbation_bars(model, nominal)
    errors = squares_errors(model, nominal)
    result: dict[str, Array] = {}
    for name, method in ((EVENT_MEAN, MEAN), (THRUSTER, POOLED), (THRUSTER_EVENT, PER_EVENT)):
        rows = table[table["method"] == method]
        if name == EVENT_MEAN:  # one number per event, printed for each of its thrusters
            rows = rows.groupby("event", sort=False).first()
        centre, rss, worst = (
            rows[column].to_numpy(dtype=float)
            for column in ("estimate_n", "bar_rss_n", "bar_worst_n")
        )
        valid = rows["valid"].to_numpy(dtype=bool) if name != EVENT_MEAN else np.isfinite(centre)
        result[f"{name}.valid"] = valid.astype(float)
        for claim in CLAIMS:
            factor = float(norm.isf(0.5 * (1.0 - claim)))
            halves = {RSS: factor * rss, WORST: worst}
            if name in errors:
                error, freedom = errors[name]
                scatter = float(student.isf(0.5 * (1.0 - claim), freedom)) * error
                halves |= {SQUARES: scatter, BOTH: np.hypot(factor * rss, scatter)}
            for key, half in halves.items():
                result[f"{name}.{key}.{claim}"] = np.stack([centre - half, centre + half], axis=-1)
    return result


def squares_errors(model: Model, nominal: Mapping[str, float]) -> dict[str, tuple[Array, int]]:
    """Standard errors of the papers' least squares, and their degrees of freedom.

    σ̂² (UᵀU)⁻¹ with σ̂² the residual variance: the mean thrust of an event has three equations for
    one unknown, the couples of all events together three per event; a single event leaves no
    residual for its own thrusters. Errors are divided by the correction factor like the estimates.
    """
    stack = model.totals_rows.stack
    physics = model.points_at(nominal, 1).physics(())
    axes, inertias, arms = physics.wheel_axes[0], physics.wheel_inertia_kg_m2[0], physics.arms_m[0]
    change = wheel_momentum(axes, inertias, stack.wheel_end_rad_s) - wheel_momentum(
        axes, inertias, stack.wheel_start_rad_s
    )
    columns = (arms * stack.on_time_s[:, None, :]) @ stack.couples.T
    batch = {name: np.array([value]) for name, value in nominal.items()}
    means = []
    for e in range(len(stack.event_ids)):
        factor = correction_factor(stack.on_time_s[e], stack.pulses[e], batch)[0]
        weighted = (stack.on_time_s[e] * factor).sum() / stack.on_time_s[e].sum()
        means.append(_errors(columns[e].sum(-1, keepdims=True), change[e])[0] / weighted)
    pooled = _errors(columns.reshape(-1, columns.shape[-1]), change.reshape(-1))
    factor = correction_factor(stack.on_time_s.sum(0), stack.pulses.sum(0), batch)[0]
    freedom = change.size - columns.shape[-1]
    return {
        EVENT_MEAN: (np.array(means), change.shape[-1] - 1),
        THRUSTER: ((pooled @ stack.couples) / factor, freedom),
    }


def _errors(columns: Array, target: Array) -> Array:
    solution, *_ = np.linalg.lstsq(columns, target, rcond=None)
    residual = target - columns @ solution
    variance = float(residual @ residual) / (len(target) - columns.shape[1])
    return np.asarray(np.sqrt(variance * np.diagonal(np.linalg.inv(columns.T @ columns))))


def coverage_table(found: Mapping[Reading, Mapping[str, Array]]) -> pd.DataFrame:
    """Coverage and mean length of every interval, per reading, estimand and method.

    found: reading → arrays of all sets, (S, ...). Only estimates that the papers call valid count,
    for every method alike. Columns: reading, estimand, method, claim (NaN for the worst case, which
    states no probability), coverage, coverage_error (one standard error; a set counts as one, its
    events share their nuisances), mean_length_n, intervals, sets.
    """
    rows = []
    for reading, arrays in found.items():
        for name in ESTIMANDS:
            truth, valid = arrays[f"{name}.truth"], arrays[f"{name}.valid"] > 0.5
            for method in METHODS:
                claims = CLAIMS[-1:] if method == WORST else CLAIMS
                for claim in claims:
                    ends = arrays.get(f"{name}.{method}.{claim}")
                    if ends is None:
                        continue
                    held = (ends[..., 0] <= truth) & (truth <= ends[..., 1]) & valid
                    per_set = held.sum(-1) - valid.sum(-1) * held.sum() / valid.sum()
                    length = np.where(valid, ends[..., 1] - ends[..., 0], 0.0).sum() / valid.sum()
                    sets = len(truth)
                    error = np.sqrt((per_set**2).sum() * sets / (sets - 1.0)) / valid.sum()
                    rows.append(
                        {
                            "reading": reading,
                            "estimand": name,
                            "method": method,
                            "claim": np.nan if method == WORST else claim,
                            "coverage": held.sum() / valid.sum(),
                            "coverage_error": error,
                            "mean_length_n": length,
                            "intervals": int(valid.sum()),
                            "sets": sets,
                        }
                    )
    return pd.DataFrame(rows)
