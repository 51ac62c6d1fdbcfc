"""Everything a finished sweep found, as tables: drawn nowhere, written nowhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.results.record import Fit
from cassini_bayes.sweep.conflict import conflict_table
from cassini_bayes.sweep.coordinates import block_coordinates
from cassini_bayes.sweep.knowledge import knowledge_table
from cassini_bayes.sweep.models import ModelFactory, values_of
from cassini_bayes.sweep.plan import Sweep, baseline_table, sweep_table
from cassini_bayes.sweep.scaling import components, power_scaling


@dataclass(frozen=True)
class SweepTables:
    """Everything a sweep found, as tables; intervals are in the columns' names."""

    baseline: pd.DataFrame
    sweep: pd.DataFrame
    scaling: pd.DataFrame
    knowledge: pd.DataFrame
    data_worth: pd.DataFrame
    conflict: pd.DataFrame

    def files(self) -> Mapping[str, pd.DataFrame]:
        """The tables by the name of their file."""
        return dict(vars(self))


def tables_of(sweep: Sweep, store: CheckpointStore, factory: ModelFactory, fit: Fit) -> SweepTables:
    """Every table of a finished sweep."""
    names, units = sweep.baseline.names, sweep.units
    blocks = block_coordinates(factory.build(factory.priors), factory.priors, fit)
    values = values_of(fit.posterior, names)
    chains = fit.posterior.sizes["chain"]
    cells = sweep_table(sweep, store)
    left_out = cells[(cells["kind"] == "without") & cells["reported"]]
    worth = left_out.assign(event=left_out["change"].str.removeprefix("without "))
    columns = ["event", "quantity", "unit", "estimate", "pareto_k", "effective_draws"]
    numbers = ["shift_sd", "shift_error", "width_ratio", "width_error"]
    return SweepTables(
        baseline=baseline_table(sweep),
        sweep=cells,
        scaling=power_scaling(components(fit), names, values, units),
        knowledge=knowledge_table(blocks, chains, names, values, units),
        data_worth=worth[[*columns, *numbers]].reset_index(drop=True),
        conflict=conflict_table(blocks, fit),
    )
