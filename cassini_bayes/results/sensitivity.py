"""Where each thrust's uncertainty comes from, and which priors the data disagree with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.posterior import Model, conditional_thrusts

DERIVATIVE_STEP = 0.05  # prior standard deviations, either side
CONFLICT_Z = 2.576  # standard normal: 1 % lies beyond, both sides together
LEAST_CONTRACTION = 0.05  # of the prior width: less, and the data say nothing (judgement)
MOVED = 0.5  # prior standard deviations that a mean moves without being narrowed (judgement)


def error_budget(model: Model, z: Array) -> pd.DataFrame:
    """Split every thrust's variance over the nuisances, in two ways.

    z (n, d) are posterior draws. With m(z) the conditional mean of a thrust given the nuisances:

    * *noise-only σ*: √E[Var(F | z)], what a fit with all nuisances known would report (it includes
      the priors of the collapsed thrust levels);
    * *share* of block B: Cov(m, Σ_{j∈B} b_j z_j) / Var(F) with b the regression of m on z over the
      posterior; with the noise-only share, E[Var(F|z)] / Var(F), the shares add up to one (up to
      the nonlinear part of m, which is reported as ``nonlinear|share``). A share can be negative
      where blocks are anticorrelated by the data;
    * *consider contribution* of block B: √Σ_{j∈B} (∂m/∂z_j)² at the posterior mean, i.e. the shift
      from one **prior** standard deviation of each nuisance left unestimated, as in a navigation
      consider covariance; ``consider_sd_n`` adds them to the noise-only σ in quadrature.

    Returns one row per event and thruster: event, thruster, full_sd_n, noise_only_sd_n,
    consider_sd_n, ``<block>|consider_n``, ``<block>|share``, ``noise-only|share`` and
    ``nonlinear|share``; nothing where nothing fires.
    """
    if not model.fires:
        return pd.DataFrame()
    mean, variance = conditional_thrusts(model, z)
    n, n_events, n_thrusters = mean.shape
    conditional = variance.mean(0)
    total = conditional + mean.var(0, ddof=1)
    centred_z = z - z.mean(0)
    centred_m = (mean - mean.mean(0)).reshape(n, -1)
    slopes, *_ = np.linalg.lstsq(centred_z, centred_m, rcond=None)
    per_coordinate = slopes * (centred_z.T @ centred_m) / (n - 1)
    centre = z.mean(0)
    steps = DERIVATIVE_STEP * np.eye(len(centre))
    plus, _ = conditional_thrusts(model, centre + steps)
    minus, _ = conditional_thrusts(model, centre - steps)
    derivative = ((plus - minus) / (2.0 * DERIVATIVE_STEP)).reshape(len(centre), -1)

    blocks = [model.specs[name].block for name in model.space.names]
    flat_total = total.reshape(-1)
    columns: dict[str, Array] = {}
    explained = np.zeros_like(flat_total)
    for block in dict.fromkeys(blocks):
        members = np.array([b == block for b in blocks])
        share = per_coordinate[members].sum(0) / flat_total
        consider = np.sqrt((derivative[members] ** 2).sum(0))
        if consider.max() < 1e-9 and np.abs(share).max() < 1e-6:
            continue  # a block no thrust depends on (mass, flight software) has no place here
        columns[f"{block}|consider_n"] = consider
        columns[f"{block}|share"] = share
        explained += share
    noise_share = conditional.reshape(-1) / flat_total
    events, thrusters = model.fired_ids, model.thrusters
    return pd.DataFrame(
        {
            "event": np.repeat(events, n_thrusters),
            "thruster": np.tile(thrusters, n_events),
            "full_sd_n": np.sqrt(flat_total),
            "noise_only_sd_n": np.sqrt(conditional.reshape(-1)),
            "consider_sd_n": np.sqrt(conditional.reshape(-1) + (derivative**2).sum(0)),
            **columns,
            "noise-only|share": noise_share,
            "nonlinear|share": 1.0 - noise_share - explained,
        }
    )


def prior_against_posterior(model: Model, z: Array) -> pd.DataFrame:
    """Prior and posterior of every walked parameter, with a conflict flag: :func:`conflicts`."""
    return conflicts(model.space.names, z.mean(0), z.std(0, ddof=1))


def conflicts(names: Sequence[str], mean: Array, sd: Array) -> pd.DataFrame:
    """Whether priors and data agree, from posterior means and standard deviations.

    In standard-normal coordinates the prior is N(0, 1). If prior and likelihood agree, the shift of
    the posterior mean is itself N(0, 1 − s²) with s the posterior standard deviation (exact for
    linear-Gaussian models), so ``surprise`` = mean / √(1 − s²) is a standard normal deviate. Above
    2.58 (1 % two-sided) the verdict is ``conflict``; where the data narrowed the parameter by less
    than 5 % it is ``prior returned`` and the surprise is not evaluated (NaN), unless they moved it
    by more than half a prior width; else ``informed``.
    """
    contraction = 1.0 - sd
    told = contraction > LEAST_CONTRACTION
    surprise = np.full(len(mean), np.nan)
    surprise[told] = mean[told] / np.sqrt(1.0 - sd[told] ** 2)
    # a shift without narrowing is none that a linear model knows: judged in prior widths
    moved = ~told & (np.abs(mean) > MOVED)
    surprise[moved] = mean[moved]
    verdicts = np.where(
        ~told & ~moved,
        "prior returned",
        np.where(np.abs(surprise) > CONFLICT_Z, "conflict", "informed"),
    )
    return pd.DataFrame(
        {
            "name": names,
            "contraction": contraction,
            "surprise": surprise,
            "verdict": verdicts,
        }
    )
