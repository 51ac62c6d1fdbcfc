"""The extended model as an ordinary model: sampled with emcee, written as a fit and a table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes import __version__
from cassini_bayes.diagnosis.diagnosis import Diagnosis
from cassini_bayes.diagnosis.evidence import DOF, Weighed
from cassini_bayes.diagnosis.extended import Hypothesis
from cassini_bayes.diagnosis.sizes import effect_values, weighted_interval
from cassini_bayes.effects.catalogue import Effect, EffectParameter
from cassini_bayes.files.storage import write_text
from cassini_bayes.files.tables import frame_csv
from cassini_bayes.model.posterior import Model
from cassini_bayes.results.groups import build_fit
from cassini_bayes.results.record import Fit, save_fit
from cassini_bayes.sampling.ensembles import SamplerSettings, sample
from cassini_bayes.sampling.warmstart import Proposal, importance, laplace, refined
from cassini_bayes.spacecraft.parameters import ParameterSpec

Array = NDArray[np.float64]
DRAWS: Final = 1_000  # of every ensemble
PILOT_ROUNDS: Final = 2
PILOT_DRAWS: Final = 4_000
_PILOTS, _LINEAR = 6, 7  # streams of the proposal's draws, and of what is integrated out


def effect_variable(effect: Effect, parameter: EffectParameter) -> str:
    """Name in ``fit.nc`` of an effect's parameter: cause and key, ``thruster_leak_z3_leak_n``."""
    return f"{effect.name.replace(':', '_')}_{parameter.key}"


def with_effect_specs(hypothesis: Hypothesis) -> Model:
    """The hypothesis's model with unit and meaning of the effects' parameters."""
    specs = {
        p.name: ParameterSpec(p.name, p.unit, "effect", f"{effect.name}: {p.key}{_kind(p)}")
        for effect in hypothesis.effects
        for p in effect.parameters
    }
    return replace(hypothesis.model, specs={**hypothesis.model.specs, **specs})


def _kind(parameter: EffectParameter) -> str:
    return ", departure from the baseline's" if parameter.is_departure else ""


def _renamed(fit: Fit, weighed: Weighed, z: Array) -> Fit:
    """Effect parameters under their own names; departures keep theirs beside the value."""
    names, values = {}, {}
    found = effect_values(weighed, z.reshape(-1, z.shape[2]))
    for effect in weighed.hypothesis.effects:
        for p in effect.parameters:
            name = effect_variable(effect, p)
            names[p.name] = f"{name}_departure" if p.is_departure else name
            if p.is_departure:
                meta = {"units": p.unit, "long_name": f"{effect.name}: {p.key}"}
                values[name] = (("chain", "draw"), found[p.key].reshape(z.shape[:2]), meta)
    groups = dict(fit.groups)
    for group in ("posterior", "prior"):
        groups[group] = groups[group].rename(names)
    groups["posterior"] = groups["posterior"].assign(values)
    return Fit(groups, fit.attributes)


def fit_extended(
    diagnosis: Diagnosis,
    folder: Path,
    seed: int,
    say: Callable[[str], None],
    target_ess: int = 1_000,
) -> pd.DataFrame:
    """Sample the extended model; write ``fit.nc`` and ``summary.csv``.

    Effect parameters are variables of ``fit.nc`` like all others (:func:`effect_variable`).

    Parameters
    ----------
    diagnosis
        What was found.
    folder, seed, say
        Where to write, the sampler's seed, told how far it got.
    target_ess
        Effective draws of every walked parameter to stop at.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    weighed = diagnosis.extended
    density_of = weighed.hypothesis.log_density
    # the ridge along which all masses and thrusts scale together needs axes of its own
    proposal = Proposal(*laplace(density_of, weighed.mode.point), DOF)
    pilot = np.random.default_rng((seed, _PILOTS))
    for _ in range(PILOT_ROUNDS):
        proposal = refined(proposal, importance(density_of, proposal, pilot, PILOT_DRAWS))
    settings = SamplerSettings(target_ess=target_ess, seed=seed)
    say(f"sampling {weighed.name}, {weighed.hypothesis.dimension} dimensions")
    chains = sample(density_of, proposal, settings)
    z, density = chains.thinned(DRAWS)
    attributes: dict[str, str | float | int] = {
        "created_by": f"cassini_bayes {__version__}",
        "model": "baseline without torque noise, extended by a diagnosis",
        "causes": weighed.name,
        "seed": seed,
        "log_evidence": float(weighed.log_evidence),
        "stop_rule": "; ".join(chains.convergence.failed) or "all criteria met",
    }
    rng = np.random.default_rng((seed, _LINEAR))
    model = with_effect_specs(weighed.hypothesis)
    fit = build_fit(model, z, density, rng, attributes)
    save_fit(_renamed(fit, weighed, z), folder / "fit.nc")
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
    write_text(folder / "summary.csv", frame_csv(table))
    return table
