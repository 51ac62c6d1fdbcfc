"""What can be named: causes, parameters of a priors file, quantities of a fit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import pandas as pd

from cassini_bayes.effects.catalogue import read_catalogue
from cassini_bayes.effects.registry import read_kinds
from cassini_bayes.effects.tables import INPUTS
from cassini_bayes.model.gather import PathLike
from cassini_bayes.pipeline.fits import FitResult, read_fit
from cassini_bayes.pipeline.models import PriorsLike, priors_of
from cassini_bayes.prediction.planning import LEVEL
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import known_parameters
from cassini_bayes.spacecraft import Spacecraft, load_spacecraft
from cassini_bayes.spacecraft.parameters import THRUST_COMMON, ParameterSpec
from cassini_bayes.sweep.models import scalar_names

_FITTED: Final = frozenset({"telemetry", "totals"})
"""Inputs that a model is made of; a diagnosis weighs more (on-times, printed estimates)."""


def causes(priors: PriorsLike, *, effect_files: Sequence[PathLike] = ()) -> pd.DataFrame:
    """Causes that a diagnosis weighs, and effects that a fit takes by name.

    Parameters
    ----------
    priors
        Their spacecraft and branch give the targets, their widths the scale of departures.
    effect_files
        Files of effects beyond those of the package.

    Returns
    -------
    DataFrame, one row per cause and parameter: ``name`` (``thruster_leak:z3``), ``inputs`` that
    show it, ``prior_probability`` of the cause among all, ``parameter``, ``unit``, ``prior`` and
    ``fitted_by_name``: whether ``fit`` takes it. It does not where a search comes first
    (``diagnose``), or where neither telemetry nor totals show it.

    Raises
    ------
    InputError
        Bad priors or effects.
    """
    known = priors_of(priors)
    kinds = read_kinds([Path(path) for path in effect_files])
    tables = {kind.name: table for kind, table in kinds.kinds}
    catalogue = read_catalogue(known, known.wheels, INPUTS, kinds)
    rows = [
        {
            "name": effect.name,
            "inputs": ", ".join(tables[effect.kind.name].inputs),
            "prior_probability": effect.prior_probability,
            "parameter": parameter.key,
            "unit": parameter.unit,
            "prior": in_words(parameter.distribution),
            "fitted_by_name": not (
                effect.needs_search or _FITTED.isdisjoint(tables[effect.kind.name].inputs)
            ),
        }
        for effect in catalogue.effects
        for parameter in effect.parameters
    ]
    return pd.DataFrame(rows)


def parameters(of: PriorsLike | Spacecraft = "cassini") -> pd.DataFrame:
    """Parameters that a priors file may give, with their priors where one is named.

    Parameters
    ----------
    of
        A priors file, what :func:`read_priors` made of it, or a spacecraft or its name.

    Returns
    -------
    DataFrame, one row per parameter: ``name``, ``unit``, ``block``, ``meaning``, and of priors
    ``prior``, ``mean``, ``sd``, ``source``.

    Raises
    ------
    InputError
        Bad priors; an unknown spacecraft.
    """
    if isinstance(of, Spacecraft) or (isinstance(of, str) and not of.endswith(".toml")):
        spacecraft = of if isinstance(of, Spacecraft) else load_spacecraft(of)
        return _described(known_parameters(spacecraft).values())
    priors = list(priors_of(of).parameters.values())
    fixed = ["" if prior.fixed is None else f"fixed at {prior.fixed:g}" for prior in priors]
    return _described(prior.spec for prior in priors).assign(
        prior=[
            in_words(own.distribution) if own.distribution else otherwise
            for own, otherwise in zip(priors, fixed, strict=True)
        ],
        **{name: [getattr(prior, name) for prior in priors] for name in ("mean", "sd", "source")},
    )


def _described(specs: Iterable[ParameterSpec]) -> pd.DataFrame:
    """What parameters are, a row each."""
    names = ["name", "unit", "block", "meaning"]
    return pd.DataFrame([[getattr(spec, name) for name in names] for spec in specs], columns=names)


def quantities(fit: FitResult | PathLike) -> pd.DataFrame:
    """Scalars of a fit by the names that summaries, sweeps, plots and plans take.

    Parameters
    ----------
    fit
        A fit, a run's folder or its ``fit.nc``.

    Returns
    -------
    DataFrame: ``name``, ``unit``, ``meaning``, ``used_by`` (``summary, sweep``, ``plan`` or both;
    of a fit of a mission, which can be neither swept nor planned with, ``summary`` alone).

    Raises
    ------
    InputError
        No fit there.
    """
    read = fit if isinstance(fit, FitResult) else read_fit(fit)
    is_of_mission = THRUST_COMMON not in read.posterior
    rows = []
    for name in scalar_names(read.posterior):
        attributes = read.posterior[name.split("[")[0]].attrs
        whole = "[" not in name and name != THRUST_COMMON
        used_by = "summary, sweep, plan" if whole else "summary, sweep"
        rows.append(
            {
                "name": name,
                "unit": attributes["units"],
                "meaning": attributes["long_name"],
                "used_by": "summary" if is_of_mission else used_by,
            }
        )
    if "thruster" in read.posterior.dims and not is_of_mission:
        names = [str(name) for name in read.posterior["thruster"].values]
        of_plans = [
            *((f"{LEVEL}{name}_n", f"level of {name} over all events") for name in names),
            ("thrust_mean_n", "mean level of all thrusters"),
            *((f"impulse_per_on_time_{n}_n", f"{n}, tail-off in it") for n in names),
        ]
        rows += [
            {"name": name, "unit": "N", "meaning": meaning, "used_by": "plan"}
            for name, meaning in of_plans
        ]
    return pd.DataFrame(rows)


def in_words(prior: Distribution) -> str:
    """A distribution as a priors file writes it: ``norm(loc=0.05, scale=0.02), low 0``."""
    inside = ", ".join(f"{key}={value:g}" for key, value in prior.keywords.items())
    bounds = [f"{k} {v:g}" for k, v in (("low", prior.low), ("high", prior.high)) if v is not None]
    return ", ".join([f"{prior.name}({inside})", *bounds])
