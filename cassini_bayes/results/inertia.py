"""The inertia tensor of a fit, both ways (:mod:`cassini_bayes.balance.inertia`)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from cassini_bayes.balance.inertia import (
    ELEMENTS,
    WITH_WHEELS,
    WITHOUT_WHEELS,
    elements_of,
    tensor_of,
)
from cassini_bayes.computing.arrays import Array
from cassini_bayes.results.record import Fit


def inertia_draws(
    draws: Mapping[str, Array], constants: Mapping[str, float], pattern: str
) -> Array:
    """Tensors (n, 3, 3) from named draws (n,), fixed elements from ``constants``."""
    size = max((len(values) for values in draws.values()), default=1)
    columns = []
    for element in ELEMENTS:
        name = pattern.format(element)
        value = draws[name] if name in draws else np.asarray(constants[name])
        columns.append(np.broadcast_to(value, (size,)))
    return tensor_of(np.stack(columns, axis=-1))


def inertia_table(with_wheels: Array, without: Array, prior: Array) -> pd.DataFrame:
    """Elements both ways: mean and sd of draws (n, 3, 3), and the prior's of the first kind."""
    columns: dict[str, object] = {"element": list(ELEMENTS)}
    for kind, tensors in (("prior_", prior), ("", with_wheels), ("without_wheels_", without)):
        draws = elements_of(tensors)
        columns[f"{kind}mean_kg_m2"] = draws.mean(0)
        columns[f"{kind}sd_kg_m2"] = draws.std(0, ddof=1)
    return pd.DataFrame(columns)


def tensors_of(fit: Fit) -> tuple[Array, Array, Array]:
    """Inertia draws of a fit: with the wheels, without their spin inertia, and of the prior."""
    constants = {
        str(name): float(variable.values)
        for name, variable in fit.groups["constant_data"].data_vars.items()
        if variable.ndim == 0
    }
    result = []
    for dataset, pattern in (
        (fit.posterior, WITH_WHEELS),
        (fit.posterior, WITHOUT_WHEELS),
        (fit.prior, WITH_WHEELS),
    ):
        names = [str(name) for name in dataset.data_vars if str(name).startswith("inertia_")]
        draws = {name: dataset[name].values.reshape(-1) for name in names}
        result.append(inertia_draws(draws, constants, pattern))
    return result[0], result[1], result[2]
