"""The eight flight biases under other beliefs: the ideal column's geometry, a tested tail-off.

Paper 001's ideal column is computed from a centre of mass and a wheel-4 axis of its own, which its
on-times give away (docs/results/prediction.md); today's priors are values of 2011. A ground test of
the tail-off at 400 psia is of the A branch.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.draws import draw
from cassini_bayes.model.posterior import build_model, log_posterior
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import Priors
from cassini_bayes.sampling.warmstart import warm_start

IDEAL: Final[Mapping[str, tuple[float, float]]] = {
    "cm_x_m": (0.128, 0.0128),
    "cm_y_m": (0.0453, 0.00453),
    "rwa4_tilt_u_rad": (0.010, 0.01),
    "rwa4_tilt_v_rad": (-0.006, 0.01),
}
"""Mean and standard deviation; widths as today's (10 %, and 1 % of a column of T)."""
TESTED: Final[Mapping[str, tuple[float, float]]] = {"tau_fall_s": (0.0486, 0.0044)}
"""Ground test at 400 psia: the mission's significant events of 1-7 June 2006."""
UPLINKED: Final[Mapping[str, tuple[float, float]]] = {"tau_fall_s": (0.043, 0.0044)}
"""What explained velocity changes 1.10-1.16 times the prediction, uplinked; the test's width."""
VARIANTS: Final[Mapping[str, Mapping[str, tuple[float, float]]]] = {
    "today": {},
    "ideal column": IDEAL,
    "tested tail-off": TESTED,
    "uplinked tail-off": UPLINKED,
    "ideal column and tested tail-off": {**IDEAL, **TESTED},
}
DRAWS: Final = 4_000


def with_beliefs(priors: Priors, beliefs: Mapping[str, tuple[float, float]]) -> Priors:
    """The priors with some means and widths changed; a bound at zero stays."""
    for name, (mean, sd) in beliefs.items():
        known = priors.parameters[name].distribution
        low = None if known is None else known.low
        moved = Distribution("norm", {"loc": mean, "scale": sd}, low)
        priors = priors.with_distribution(name, moved)
    return priors


def compare_priors(events: tuple[TotalsEvent, ...], priors: Priors, seed: int) -> pd.DataFrame:
    """One row per variant: evidence, and means and sds of what moves.

    ``thrust_<name>_n`` are the thrusters' levels over all events.
    """
    rows = []
    for name, beliefs in VARIANTS.items():
        model = build_model(events, with_beliefs(priors, beliefs))
        rng = np.random.default_rng(seed)
        warm = warm_start(partial(log_posterior, model), model.space.dimension, rng)
        z = warm.draws.resample(rng, DRAWS)
        drawn = draw(model, z, rng)
        values = {key: np.asarray(drawn.parameters[key]) for key in ("tau_fall_s", "cm_y_m")}
        values |= {
            f"thrust_{thruster}_n": drawn.thrusts.level_n[:, k]
            for k, thruster in enumerate(model.thrusters)
        }
        values["thrust_mean_n"] = drawn.thrusts.level_n.mean(1)
        rows.append(
            {
                "priors": name,
                "log_evidence": warm.draws.log_evidence,
                "pareto_k": warm.draws.pareto_k,
                **{key: float(value.mean()) for key, value in values.items()},
                **{f"{key}_sd": float(value.std()) for key, value in values.items()},
            }
        )
    return pd.DataFrame(rows)
