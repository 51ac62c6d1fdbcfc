"""The extended model as an ordinary model: sampled with emcee, written as a fit and a table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes import __version__
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.log import Log
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.evidence import DOF
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.sizes import effect_values, weighted_interval
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.storage import write_text
from cassini_bayes.files.tables import frame_csv
from cassini_bayes.results.fitting import ALL_MET
from cassini_bayes.results.groups import build_fit
from cassini_bayes.results.record import FIT_FILE, Fit, save_fit
from cassini_bayes.sampling.ensembles import SamplerSettings, sample
from cassini_bayes.sampling.warmstart import Proposal, importance, laplace, refined

DRAWS: Final = 1_000  # of every ensemble
SETTINGS: Final = SamplerSettings(target_ess=1_000)  # sizes and a summary, no corner of tails
PILOT_ROUNDS: Final = 2  # refinements of the proposal by its own draws (judgement)
PILOT_DRAWS: Final = 4_000  # of each: over a hundred for every dimension
_PILOTS, _LINEAR = 6, 7  # streams of the proposal's draws, and of what is integrated out


def _renamed(fit: Fit, weighed: Weighed[Hypothesis], z: Array) -> Fit:
    """Effect parameters under their own names; departures keep theirs beside the value."""
    names, values = {}, {}
    by_key = effect_values(weighed.hypothesis, z.reshape(-1, z.shape[2]))
    for effect in weighed.hypothesis.effects:
        for p in effect.parameters:
            names[p.name] = effect.variable(p)
            if p.is_departure:
                meta = {"units": p.unit, "long_name": f"{effect.name}: {p.key}"}
                drawn = by_key[p.key].reshape(z.shape[:2])
                name = effect.variable(replace(p, baseline=""))
                values[name] = (("chain", "draw"), drawn, meta)
    groups = dict(fit.groups)
    for group in ("posterior", "prior"):
        groups[group] = groups[group].rename(names)
    groups["posterior"] = groups["posterior"].assign(values)
    return Fit(groups, fit.attributes)


def fit_extended(
    weighed: Weighed[Hypothesis],
    folder: Path,
    seed: int,
    log: Log,
    settings: SamplerSettings = SETTINGS,
    store: CheckpointStore | None = None,
) -> pd.DataFrame:
    """Sample the extended model; write ``fit.nc`` and ``summary.csv``, and return that table.

    Its ``attrs["stop_rule"]`` are the criteria that did not hold, or :data:`.fitting.ALL_MET`.

    Effect parameters are variables of ``fit.nc`` like all others (:meth:`.Effect.variable`).

    Parameters
    ----------
    weighed
        The hypothesis whose model is sampled.
    folder, seed, log
        Where to write; the sampler's seed; a reporter of progress.
    settings
        How to sample, and when to stop; the seed is the one above.
    store
        Where blocks of draws are kept: a killed fit goes on from them.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    density_of = weighed.hypothesis.log_density
    # the ridge along which all masses and thrusts scale together needs axes of its own
    proposal = Proposal(*laplace(density_of, weighed.mode.point), DOF)
    pilot = np.random.default_rng((seed, _PILOTS))
    for _ in range(PILOT_ROUNDS):
        proposal = refined(proposal, importance(density_of, proposal, pilot, PILOT_DRAWS))
    log(f"sampling {weighed.name}, {weighed.hypothesis.dimension} dimensions")
    chains = sample(density_of, proposal, replace(settings, seed=seed), store=store)
    z, density = chains.thinned(DRAWS)
    stop_rule = "; ".join(chains.convergence.failed) or ALL_MET
    attributes: dict[str, str | float | int] = {
        "created_by": f"cassini_bayes {__version__}",
        "model": "baseline without torque noise, extended by a diagnosis",
        "causes": weighed.name,
        "seed": seed,
        "log_evidence": float(weighed.log_evidence),
        "stop_rule": stop_rule,
    }
    rng = np.random.default_rng((seed, _LINEAR))
    fit = build_fit(weighed.hypothesis.model, z, density, rng, attributes)
    save_fit(_renamed(fit, weighed, z), folder / FIT_FILE)
    flat = z.reshape(-1, weighed.hypothesis.dimension)
    parameters = weighed.hypothesis.model.space.to_parameters(flat)
    effect_names = {p.name for e in weighed.hypothesis.effects for p in e.parameters}
    values = {
        name: np.asarray(parameters[name])
        for name in weighed.hypothesis.model.space.names
        if name not in effect_names
    }
    values |= effect_values(weighed.hypothesis, flat)
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
    write_text(folder / "summary.csv", frame_csv(table))
    table.attrs["stop_rule"] = stop_rule
    return table
