"""A whole sweep of one fit: its plan, its cells, its tables."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.workers import Workers
from cassini_bayes.errors import InputError
from cassini_bayes.files.as_arrays import value_of
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.checks import check_known
from cassini_bayes.files.pieces import finished, run_pieces
from cassini_bayes.priors.quantiles import standard_normal_log_density
from cassini_bayes.results.record import FIT_FILE, Fit
from cassini_bayes.spacecraft.parameters import THRUST_COMMON
from cassini_bayes.sweep.cells import Baseline, Estimate, cell_arrays
from cassini_bayes.sweep.models import (
    ModelFactory,
    SweepModel,
    chosen_names,
    units_of,
    values_of,
    walked_values,
)
from cassini_bayes.sweep.scaling import LIKELIHOOD, components
from cassini_bayes.sweep.specification import EVENTS, SweepFile
from cassini_bayes.sweep.variations import Group, Variation, blocks_of, grid_of
from cassini_bayes.sweep.weights import BATCHES, batch_labels, moments

SAME_DENSITY: Final = 1e-5
_CHECKED: Final = 20
COLUMNS: Final = (
    "group", "kind", "change", "parameters", "quantity", "unit", "estimate", "pareto_k",
    "effective_draws", "mean", "sd", "shift_sd", "shift_error", "width_ratio", "width_error",
    "reported",
)  # fmt: skip


@dataclass(frozen=True)
class Sweep:
    """A sweep ready to run: the baseline, its quantities' units, and the cells by file name."""

    baseline: Baseline
    units: tuple[str, ...]
    cells: Mapping[str, Variation]
    refit: str

    def identity(self, depends_on: str) -> str:
        """Hash of all that a finished cell depends on besides its own change."""
        base = self.baseline
        total = hashlib.sha256(json.dumps([depends_on, base.names, base.seed, self.refit]).encode())
        total.update(np.ascontiguousarray(base.values).tobytes())
        for name in sorted(base.parameters):
            total.update(np.ascontiguousarray(base.parameters[name]).tobytes())
        return total.hexdigest()

    def run(self, store: CheckpointStore, workers: Workers) -> Iterator[tuple[int, int]]:
        """Work out the cells that are not stored yet; yields (done, all)."""
        tasks = {name: (cell, self.refit) for name, cell in self.cells.items()}
        return run_pieces(cell_arrays, self.baseline, tasks, store, workers)


def plan(
    factory: ModelFactory,
    fit: Fit,
    sweep: SweepFile,
    where: str,
    fit_file: str = FIT_FILE,
    changed: Sequence[str] = (),
) -> Sweep:
    """Read the draws of a fit and lay out the cells.

    ``where`` and ``fit_file`` are what refusals call the sweep file and the fit's; ``changed`` are
    inputs that are known to be others than those of the fit.

    Raises
    ------
    InputError
        The fit is not one of this model, a quantity, block or parameter is unknown, or nothing is
        left to change.
    """
    model = factory.build(factory.priors)
    rows = _kept(fit, sweep.draws)
    posterior = fit.posterior.isel(draw=rows)
    names = chosen_names(posterior, sweep.quantities, f"{where}: quantities")
    wanted = list(model.space.names)
    if THRUST_COMMON in posterior and THRUST_COMMON not in wanted:
        wanted.append(THRUST_COMMON)
    draws = walked_values(posterior, wanted, factory.priors.spacecraft)
    z = model.space.to_standard({name: draws[name] for name in model.space.names})
    stored = fit.groups["sample_stats"]["lp"].isel(draw=rows).values.reshape(-1)
    log_prior = standard_normal_log_density(z).sum(-1)
    baseline = Baseline(
        factory=factory,
        parameters=draws,
        names=names,
        values=values_of(posterior, names),
        log_likelihood=stored - log_prior,
        batches=batch_labels(posterior.sizes["chain"], posterior.sizes["draw"]),
        seed=sweep.seed,
    )
    _refuse_other_fit(model, z, baseline.log_likelihood, fit_file, changed)
    _refuse_older_fit(model, factory, fit, fit_file)
    cells = grid_of(
        _groups(factory, sweep, where),
        model,
        factory.priors,
        sweep.grid,
        where,
    )
    if sweep.grid.events and len(factory.event_ids) > 1:
        cells += tuple(Variation(EVENTS, "without", event=name) for name in factory.event_ids)
    if not cells:
        raise InputError(f"{where}: grid", "at least one change", "none", "add widths or shifts")
    return Sweep(baseline, units_of(posterior, names), _by_key(cells, where), sweep.refit)


def _by_key(cells: Iterable[Variation], where: str) -> dict[str, Variation]:
    """Cells by the name of their file; names that only signs tell apart are refused."""
    by_name: dict[str, Variation] = {}
    for cell in cells:
        other = by_name.setdefault(cell.name, cell)
        if other != cell:
            raise InputError(
                f"{where}: group",
                "names and amounts that differ by letters or digits",
                f"{other.group}, {other.label} beside {cell.group}, {cell.label}",
                "rename one of them",
            )
    return {cell.key: cell for cell in by_name.values()}


def _kept(fit: Fit, draws: int) -> NDArray[np.int64]:
    """Indices of evenly spaced draws, the same in every chain."""
    chains, stored = fit.posterior.sizes["chain"], fit.posterior.sizes["draw"]
    wanted = min(stored, max(draws // chains, BATCHES))
    return np.unique(np.linspace(0, stored - 1, wanted).round().astype(np.int64))


def _groups(factory: ModelFactory, sweep: SweepFile, where: str) -> tuple[Group, ...]:
    blocks = {g.name: g for g in blocks_of(factory.build(factory.priors), factory.priors)}
    for name in sweep.blocks:
        check_known(f"{where}: blocks", name, blocks, "prior blocks of the model")
    groups = tuple(Group(g.name, tuple(g.parameters)) for g in sweep.group)
    if sweep.blocks or groups:
        return (*(blocks[name] for name in sweep.blocks), *groups)
    return tuple(blocks.values())


def _refuse_other_fit(
    model: SweepModel, z: Array, log_likelihood: Array, fit_file: str, changed: Sequence[str]
) -> None:
    """Refuse draws whose stored log density the model does not give back."""
    rows = np.linspace(0, len(z) - 1, _CHECKED).astype(int)
    worst = float(np.max(np.abs(model.log_likelihood(z[rows]) - log_likelihood[rows])))
    if not worst < SAME_DENSITY:
        raise InputError(
            fit_file,
            "a fit of these events and priors",
            f"log densities that differ by {worst:.3g}",
            f"run the fit again: {', '.join(changed) or 'its data or the model'} changed since",
        )


def _refuse_older_fit(model: SweepModel, factory: ModelFactory, fit: Fit, fit_file: str) -> None:
    """Refuse a fit without log priors of a block: its power scaling would silently be left out."""
    kept = components(fit)
    for block in blocks_of(model, factory.priors):
        if block.name not in kept:
            raise InputError(
                f"{fit_file}: log_prior",
                f"the block {block.name}",
                ", ".join(name for name in kept if not name.startswith(LIKELIHOOD)),
                "run the fit again with this version",
            )


def baseline_table(sweep: Sweep) -> pd.DataFrame:
    """Mean, sd and central 90 % interval of every quantity before anything is changed."""
    values = sweep.baseline.values
    result = moments(values, np.full(len(values), 1.0 / len(values)))
    return pd.DataFrame(
        {
            "quantity": sweep.baseline.names,
            "unit": sweep.units,
            "mean": result.mean,
            "sd": result.sd,
            "central_90_low": np.quantile(values, 0.05, axis=0),
            "central_90_high": np.quantile(values, 0.95, axis=0),
        }
    )


def sweep_table(sweep: Sweep, store: CheckpointStore) -> pd.DataFrame:
    """Every cell and quantity, one row per way of estimating it.

    ``shift_sd`` is the shift of the mean in posterior standard deviations of the baseline,
    ``width_ratio`` the ratio of standard deviations; errors are Monte Carlo standard errors.
    ``reported`` marks the estimate to be used: fitted anew where that was done.
    """
    rows: list[tuple[object, ...]] = []
    for name, cell in sweep.cells.items():
        arrays = finished(store, name)
        ways = [way for way in ("0", "1") if f"{way}.kind" in arrays]
        for way in ways:
            rows += _rows(sweep, cell, arrays, way, reported=way == ways[-1])
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    return table[table["mean"].notna() | (table["kind"] != "without")].reset_index(drop=True)


def _rows(
    sweep: Sweep,
    cell: Variation,
    arrays: Mapping[str, NDArray[np.generic]],
    way: str,
    *,
    reported: bool,
) -> list[tuple[object, ...]]:
    found: Estimate = value_of(Estimate, arrays, way)
    head = (cell.group, cell.kind, cell.label, " ".join(cell.parameters))
    estimate = (found.kind, found.pareto_k, found.effective)
    changes = (found.shift, found.shift_error, found.width, found.width_error)
    numbers = np.stack([found.mean, found.sd, *changes], axis=-1).tolist()
    return [
        (*head, name, unit, *estimate, *own, reported)
        for name, unit, own in zip(sweep.baseline.names, sweep.units, numbers, strict=True)
    ]


def reported_quantiles(sweep: Sweep, store: CheckpointStore) -> dict[str, Array]:
    """Quantiles (199, q) at (i + 1)/200 of every cell's reported estimate, for overlays."""
    result = {}
    for name in sweep.cells:
        arrays = finished(store, name)
        way = "1" if "1.kind" in arrays else "0"
        result[name] = np.asarray(arrays[f"{way}.quantiles"], dtype=np.float64)
    return result
