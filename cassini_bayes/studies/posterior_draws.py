"""Draws that a truth is ranked among: by importance where it can be trusted, else of a chain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.priors.starts import Starts
from cassini_bayes.sampling.ensembles import SamplerSettings, sample
from cassini_bayes.sampling.warmstart import warm_start

LogDensity = Callable[[Array], Array]
Effort = tuple[float, int, int]
"""Degrees of freedom, pilots and number of importance draws."""

TRUSTED_K: Final = 0.5
RANK_DRAWS: Final = 999


def posterior_draws(
    log_density: LogDensity,
    starts: Starts,
    rng: np.random.Generator,
    efforts: Sequence[Effort],
    chain_steps: int = SamplerSettings.max_steps,
) -> tuple[Array, float, bool]:
    """Draws (n, d) of the first effort whose Pareto k̂ is trusted; k̂; whether a chain's.

    A chain of at most ``chain_steps`` stands in where none is. Searches for the mode begin at
    ``starts``.
    """
    dimension = starts.dimension
    for dof, pilots, draws in efforts:
        warm = warm_start(
            log_density, dimension, rng, starts=starts, dof=dof, pilots=pilots, draws=draws
        )
        if warm.draws.pareto_k < TRUSTED_K:
            return warm.draws.resample(rng, RANK_DRAWS), warm.draws.pareto_k, False
    seed = int(rng.integers(2**31))
    settings = SamplerSettings(target_ess=RANK_DRAWS, max_steps=chain_steps, seed=seed)
    z, _ = sample(log_density, warm.proposal, settings).thinned(4 * RANK_DRAWS)
    return rng.permutation(z.reshape(-1, dimension))[:RANK_DRAWS], warm.draws.pareto_k, True
