"""Power-scaling sensitivity: how fast a posterior moves when a prior's weight is turned up or down.

Each block's prior, or the likelihood of all or of one event, is raised to a power α near one; the
stored draws are weighted with it (Kallioinen et al. 2024). The sensitivity is the rate at which the
cumulative Jensen-Shannon distance to the posterior grows with log₂ α. Walked parameters are scaled
in their standard-normal coordinates, in which every prior is a unit normal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array
from cassini_bayes.results.groups import block_variable
from cassini_bayes.results.record import Fit
from cassini_bayes.spacecraft.parameters import BLOCKS
from cassini_bayes.sweep.weights import smoothed_weights

DELTA: Final = 1.01
SENSITIVE: Final = 0.05
LIKELIHOOD: Final = "likelihood"
EVENT: Final = "likelihood of "


def components(fit: Fit) -> dict[str, Array]:
    """What can be scaled: log prior (n,) of every block, log likelihood of all and of each event.

    Everything is evaluated at the stored draws, what is integrated out at its drawn-back values.
    """
    blocks = {block_variable(block): block for block in BLOCKS}
    result = {
        blocks.get(str(block), str(block).replace("_", " ")): values.values.reshape(-1)
        for block, values in fit.groups["log_prior"].data_vars.items()
    }
    events: dict[str, Array] = {}
    for variable in fit.groups["log_likelihood"].data_vars.values():
        for event in variable.coords["event"].values:
            values = variable.sel(event=event).values.reshape(-1)
            if np.isfinite(values).all():
                events[str(event)] = events.get(str(event), 0.0) + values
    result[LIKELIHOOD] = np.sum(list(events.values()), axis=0)
    if len(events) > 1:
        result |= {f"{EVENT}{event}": values for event, values in events.items()}
    return result


def power_scaling(
    parts: Mapping[str, Array], names: Sequence[str], values: Array, units: Sequence[str]
) -> pd.DataFrame:
    """Sensitivity of every quantity to every part, with Pareto k̂ of the two sets of weights.

    parts: name → log density (n,); values (n, q). Above 0.05 a quantity counts as sensitive.
    Columns: component, quantity, unit, sensitivity, pareto_k, sensitive.
    """
    rows = []
    for part, log_density in parts.items():
        up = smoothed_weights((DELTA - 1.0) * log_density)
        down = smoothed_weights((1.0 / DELTA - 1.0) * log_density)
        k = max(up.pareto_k, down.pareto_k)
        for j, name in enumerate(names):
            distances = [cjs_distance(values[:, j], w.values) for w in (up, down)]
            sensitivity = float(np.sum(distances)) / (2.0 * np.log2(DELTA))
            rows.append((part, name, units[j], sensitivity, k, sensitivity > SENSITIVE))
    columns = ["component", "quantity", "unit", "sensitivity", "pareto_k", "sensitive"]
    return pd.DataFrame(rows, columns=columns)


def cjs_distance(values: Array, weights: Array) -> float:
    """Symmetric cumulative Jensen-Shannon distance between draws (n,) and the same ones weighted.

    With P, Q the distribution functions, D(P‖Q) = ∫ P log₂(2P/(P+Q)) dx + ½/ln2 ∫ (Q−P) dx; the
    distance is √[(D(P‖Q) + D(Q‖P)) / ∫(P+Q) dx], the larger of those of x and of −x.
    """
    return max(_one_sided(values, weights), _one_sided(-values, weights))


def _one_sided(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    steps = np.diff(values[order])
    p = np.arange(1, len(values)) / len(values)
    q = np.clip(np.cumsum(weights[order])[:-1], 0.0, 1.0)
    total = float((steps * (p + q)).sum())
    if total <= 0.0:
        return 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        pq = np.where(p > 0, p * np.log2(2.0 * p / (p + q)), 0.0)
        qp = np.where(q > 0, q * np.log2(2.0 * q / (p + q)), 0.0)
    # the two linear terms cancel in the sum of both directions
    return float(np.sqrt(max(float((steps * (pq + qp)).sum()), 0.0) / total))
