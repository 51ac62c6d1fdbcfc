"""Which knowledge to buy: how much narrower each interval gets if a prior were known perfectly.

If the parameters θ_B of a block were measured exactly, a quantity q would be left with the
variance E[Var(q | θ_B)] on average over the outcomes of the measurement. Over posterior draws it is
the residual variance of the regression of q on θ_B; a quadratic in each coordinate takes up
curvature.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.sweep.coordinates import Coordinates
from cassini_bayes.sweep.weights import batch_labels


def knowledge_table(
    blocks: Mapping[str, Coordinates],
    chains: int,
    names: Sequence[str],
    values: Array,
    units: Sequence[str],
) -> pd.DataFrame:
    """Expected ratio of interval widths if a block, or one parameter of it, were known.

    blocks as from :func:`block_coordinates` with posterior draws (n, p), values (n, q) the same
    draws of the quantities, ``chains`` how many chains the draws are of. Columns: block, known
    (the block or a parameter), level (``block`` or ``parameter``), quantity, unit, width_ratio (of
    standard deviations; 90 % intervals shrink alike where the posterior is near normal) and
    width_error (Monte Carlo, jackknife over batches of the chains).
    """
    rows = []
    batches = batch_labels(chains, len(values) // chains)
    for block, coordinates in blocks.items():
        items = [(block, "block", coordinates.posterior)]
        if len(coordinates.names) > 1:
            items += [
                (name, "parameter", coordinates.posterior[:, [i]])
                for i, name in enumerate(coordinates.names)
            ]
        for known, level, draws in items:
            ratio, error = residual_ratio(draws, values, batches)
            rows += [
                (block, known, level, name, units[j], float(ratio[j]), float(error[j]))
                for j, name in enumerate(names)
            ]
    columns = ["block", "known", "level", "quantity", "unit", "width_ratio", "width_error"]
    return pd.DataFrame(rows, columns=columns)


def residual_ratio(known: Array, values: Array, batches: NDArray[np.int64]) -> tuple[Array, Array]:
    """√(residual variance / variance) of values (n, q) on known (n, p), with its error (q,)."""
    centred = known - known.mean(0)
    columns = np.concatenate([np.ones((len(known), 1)), centred, centred**2], axis=1)
    shifted = values - values.mean(0)
    scale = shifted.std(0)
    target = shifted / np.where(scale > 0, scale, 1.0)
    count = int(batches.max()) + 1
    joint = np.concatenate([columns, target], axis=1)
    parts = (joint[batches == batch] for batch in range(count))
    grams = np.stack([part.T @ part for part in parts])
    total = grams.sum(0)
    left_out = np.stack([_ratio(total - gram, columns.shape[1]) for gram in grams])
    error = np.sqrt((count - 1.0) / count * ((left_out - left_out.mean(0)) ** 2).sum(0))
    return _ratio(total, columns.shape[1]), error


def _ratio(gram: Array, p: int) -> Array:
    """√(residual / total variance) from the Gram matrix of [1, columns | targets]."""
    n = gram[0, 0]
    projected = np.linalg.lstsq(gram[:p, :p], gram[:p, p:], rcond=1e-12)[0]
    residual = np.diagonal(gram[p:, p:]) - (gram[:p, p:] * projected).sum(0)
    variance = np.diagonal(gram[p:, p:]) - gram[0, p:] ** 2 / n
    spent = (n - 1.0) / (n - p)  # the regression follows noise with each of its coefficients
    ratio = np.clip(spent * residual / np.where(variance > 0, variance, 1.0), 0.0, 1.0)
    return np.asarray(np.sqrt(ratio), dtype=np.float64)
