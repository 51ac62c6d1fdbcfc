"""What each use of ΔV makes of the thrusts: left out, as declared, as if it had been measured."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.draws import draw
from cassini_bayes.model.posterior import Model, build_model, log_posterior
from cassini_bayes.model.totals import DeltaVUse
from cassini_bayes.priors.reader import Priors
from cassini_bayes.results.record import Fit
from cassini_bayes.results.tables import by_event, described
from cassini_bayes.sampling.warmstart import TRUSTED_K, warm_start

USES: Final[Mapping[DeltaVUse, str]] = {
    "ignore": "ΔV left out",
    "as-declared": "ΔV as declared",
    "as-measured": "ΔV as if measured",
}


def thrusts_by_delta_v_use(
    model: Model, priors: Priors, fit: Fit, rng: np.random.Generator
) -> pd.DataFrame:
    """Thrust posteriors of totals rows under every use of their ΔV, long format.

    The use that was fitted is the fit itself; the others are importance draws, with k̂ in the name
    of the variant where it is too large to trust. Nothing without a ΔV.
    """
    tables = []
    for term in model.totals:
        if not term.stack.has_delta_v.any():
            continue
        for use, label in USES.items():
            if use == term.delta_v:
                values = fit.posterior["thrust_n"].sel(event=list(term.event_ids)).values
                tables.append(_table(label, model, values.reshape(-1, *values.shape[2:])))
                continue
            shape = term.pulse_shape.name
            other = build_model(
                model.sources, priors, pulse_shape=shape, delta_v=use, effects=model.effects
            )
            warm = warm_start(partial(log_posterior, other), other.space.dimension, rng)
            z = warm.draws.resample(rng, len(warm.draws.z))
            thrusts = draw(other, z, rng).thrusts.thrust_n
            k = warm.draws.pareto_k
            note = "" if k < TRUSTED_K else f" (importance draws, k̂ = {k:.2f}: not reliable)"
            tables.append(_table(label + note, model, thrusts[:, : len(term.event_ids)]))
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def _table(name: str, model: Model, thrust_n: Array) -> pd.DataFrame:
    """Thrusts (n, E, K) of the totals rows under one use."""
    events = model.event_ids[: thrust_n.shape[1]]
    table = by_event(events, "thruster", model.thrusters, described(thrust_n, "n"))
    table.insert(0, "variant", name)
    return table
