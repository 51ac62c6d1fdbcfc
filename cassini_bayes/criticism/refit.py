"""The extended model as an ordinary model: sampled with emcee, its table written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from cassini_bayes.criticism.diagnosis import Diagnosis
from cassini_bayes.criticism.evidence import DOF
from cassini_bayes.criticism.naming import effect_values, weighted_interval
from cassini_bayes.sampling import SamplerSettings, sample
from cassini_bayes.storage import write_text
from cassini_bayes.warmstart import Proposal

DRAWS = 4_000


def fit_extended(
    diagnosis: Diagnosis, folder: Path, seed: int, say: Callable[[str], None]
) -> pd.DataFrame:
    """Sample the extended model and write ``summary.csv`` of its walked and effect parameters."""
    weighed = diagnosis.extended
    proposal = Proposal(weighed.mode.point, weighed.mode.factor, DOF)
    settings = SamplerSettings(target_ess=1_000, seed=seed)
    say(f"sampling {weighed.name}, {weighed.hypothesis.dimension} dimensions")
    chains = sample(weighed.hypothesis.log_density, proposal, settings)
    z, _ = chains.thinned(DRAWS)
    flat = z.reshape(-1, weighed.hypothesis.dimension)
    parameters = weighed.hypothesis.model.space.to_parameters(flat)
    own = {p.name for e in weighed.hypothesis.effects for p in e.parameters}
    values = {
        name: np.asarray(parameters[name])
        for name in weighed.hypothesis.model.space.names
        if name not in own
    }
    values |= effect_values(weighed, flat)
    equal = np.full(len(flat), 1.0 / len(flat))
    rows = []
    for name, draws in values.items():
        low, high = weighted_interval(draws, equal)
        rows.append(
            {
                "name": name,
                "mean": draws.mean(),
                "sd": draws.std(),
                "hdi_90_low": low,
                "hdi_90_high": high,
            }
        )
    table = pd.DataFrame(rows)
    write_text(folder / "summary.csv", table.to_csv(index=False))
    return table
