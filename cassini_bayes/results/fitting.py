"""Fit a model: warm start, ensembles, thrusts drawn back. What a run file and a notebook share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.computing.processes import in_parts, in_processes
from cassini_bayes.computing.threads import one_thread
from cassini_bayes.files.as_arrays import arrays_of, value_of
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.model.draws import Draws, draw
from cassini_bayes.model.posterior import Model, log_posterior
from cassini_bayes.model.telemetry import TAILS
from cassini_bayes.priors.starts import Starts
from cassini_bayes.results.groups import build_fit
from cassini_bayes.results.record import Fit, labelled
from cassini_bayes.sampling.ensembles import (
    Chains,
    Convergence,
    ProgressReport,
    SamplerSettings,
    sample,
    stored_ess,
)
from cassini_bayes.sampling.warmstart import (
    TRUSTED_K,
    LogDensity,
    WarmStart,
    warm_start,
)

_WARM_START, _LINEAR = 1, 2  # random streams of the stages, all from the one seed
SERIOUS_EXPANSION_ERROR: Final = 0.1  # nats: changes weights of draws by a tenth
WALKED: Final = "walked"
"""Dimension of the statistics of walked parameters."""
CONVERGENCE: Final = {
    "tau_steps": ("tau_steps", "autocorrelation time, steps"),
    "rhat": ("walked_rhat", "R-hat between independent ensembles"),
    "ess": ("walked_ess", "effective sample size, the smaller of two estimates"),
}
"""Column of the table, variable of the record and meaning of the stop rule's figures."""
ALL_MET: Final = "all criteria met"
IMPORTANCE_MET: Final = "importance draws: Pareto k below 0.7"
"""The stop rule of a fit of a mission, which no chain has walked."""
FALLBACK_INDEPENDENCE: Final = 0.2  # of the moves, where the proposal is poor (judgement)


@dataclass(frozen=True)
class Sampled:
    """A fitted model: the record of the fit, and what it was made of.

    ``z`` (M, n, d) are the stored draws in walked coordinates, in the order of ``fit.posterior``.
    """

    model: Model
    settings: SamplerSettings
    fit: Fit
    z: Array
    warm: WarmStart
    chains: Chains

    @property
    def flat_z(self) -> Array:
        """Stored draws of all ensembles, (M n, d)."""
        return self.z.reshape(-1, self.z.shape[-1])

    @property
    def warnings(self) -> list[str]:
        """Sentences about anything that makes the draws or the evidence doubtful."""
        return fit_warnings(self.fit)


def stop_rule_held(fit: Fit) -> bool:
    """Whether the stop rule held while sampling; a fit that does not say so has not converged."""
    return fit.attributes.get("stop_rule") in (ALL_MET, IMPORTANCE_MET)


def fit_warnings(fit: Fit) -> list[str]:
    """Sentences about anything that makes the draws or the evidence of a fit doubtful."""
    result, kept = [], fit.attributes
    if not stop_rule_held(fit):
        failed = kept.get("stop_rule", "no stop rule is recorded")
        result.append(f"Sampling stopped at its limit before the stop rule held: {failed}")
    pareto_k = float(kept.get("pareto_k", 0.0))
    if pareto_k > TRUSTED_K:
        result.append(
            "The importance draws behind the evidence are not reliable (Pareto k̂ = "
            f"{pareto_k:.2f} > {TRUSTED_K}); differential evolution did most of the "
            "sampling instead of the independence move."
        )
    stats = fit.groups["sample_stats"]
    if "jacobian_expansion_error" not in stats:
        return result
    error = stats["jacobian_expansion_error"].values.std()
    if error > SERIOUS_EXPANSION_ERROR:
        result.append(
            f"The expansion of the response Jacobian is off by {error:.2f} nats (standard "
            f"deviation over the posterior; {SERIOUS_EXPANSION_ERROR} is tolerable)."
        )
    return result


@one_thread()
def fit_model(
    model: Model,
    settings: SamplerSettings | None = None,
    *,
    draws_per_ensemble: int = 4_000,
    prior_draws: int = 4_000,
    store: CheckpointStore | None = None,
    log: Log = silent,
    progress: Callable[[ProgressReport], None] | None = None,
    threads: int = 1,
) -> Sampled:
    """Sample the posterior of a model until the stop rule holds, and assemble the fit.

    Parameters
    ----------
    model
        Of any events.
    settings
        Sampler settings with the seed; the same seed gives the same draws.
    draws_per_ensemble, prior_draws
        How many draws the fit keeps.
    store
        Where finished blocks are kept, to go on from after a kill.
    log, progress
        Told about stages and sampling progress.
    threads
        For the likelihood; the draws do not depend on it.

    Raises
    ------
    InputError
        Settings that the sampler cannot use, or checkpoints of another run.
    """
    settings = settings or SamplerSettings()
    settings.walkers_for(len(model.space.names))
    settings.check_kept(draws_per_ensemble)
    log(
        f"{_count(model.event_ids)}, {len(model.space.names)} walked and "
        f"{collapsed_size(model)} collapsed parameters"
    )
    with in_parts(partial(log_posterior, model), threads) as density_of:
        warm, chains, last = _sampled(
            model, density_of, settings, draws_per_ensemble, store, log, progress, threads
        )
    z, density = chains.thinned(draws_per_ensemble)
    convergence = chains.convergence
    log(f"drawing thrusts back, {z.shape[0] * z.shape[1]} draws")
    attributes: dict[str, str | float | int] = {
        "seed": settings.seed,
        "target_ess": settings.target_ess,
        "walkers": chains.z.shape[2],
        "log_evidence": warm.draws.log_evidence,
        "log_evidence_se": warm.draws.log_evidence_se,
        "pareto_k": warm.draws.pareto_k,
        "importance_efficiency": warm.draws.efficiency,
        "laplace_log_evidence": warm.laplace_log_evidence,
        "steps": convergence.step,
        "burn_in_steps": chains.burn_in,
        "acceptance": float(chains.acceptance.mean()),
        "stop_rule": "; ".join(convergence.failed) or ALL_MET,
        "largest_tau_steps": float(convergence.autocorrelation_time.max()),
        "tau_change": float(convergence.tau_change),
        "worst_rhat": float(convergence.rhat.max()),
        "least_ess": float(convergence.ess.min()),
    }
    if last is None or not np.array_equal(last.z, z):  # stopped at the limit of steps
        last = _drawn_back(model, z, settings.seed)
    fit = build_fit(model, z, density, last.rng, attributes, prior_draws, drawn=last.draws)
    fit = _with_convergence(fit, model.space.names, convergence)
    return Sampled(model, settings, fit, z, warm, chains)


def _with_convergence(fit: Fit, names: Sequence[str], convergence: Convergence) -> Fit:
    """The fit with the stop rule's figures of every walked parameter among its statistics."""
    each = (convergence.autocorrelation_time, convergence.rhat, convergence.ess)
    variables = {
        name: labelled((WALKED,), values, "1", meaning)
        for values, (name, meaning) in zip(each, CONVERGENCE.values(), strict=True)
    }
    stats = fit.groups["sample_stats"].assign(variables).assign_coords({WALKED: list(names)})
    return Fit({**fit.groups, "sample_stats": stats}, fit.attributes)


def _sampled(
    model: Model,
    density_of: LogDensity,
    settings: SamplerSettings,
    draws_per_ensemble: int,
    store: CheckpointStore | None,
    log: Log,
    progress: Callable[[ProgressReport], None] | None,
    processes: int,
) -> tuple[WarmStart, Chains, _DrawnBack | None]:
    """Warm start and ensembles, the moves chosen by what the warm start is worth.

    Also what the stop rule drew back last.
    """
    warm = _warm_start(density_of, model.starts, settings.seed, store)
    log(
        f"warm start: log evidence {warm.draws.log_evidence:.2f} ± {warm.draws.log_evidence_se:.2f}"
        f", Pareto k̂ {warm.draws.pareto_k:.2f}, efficiency {warm.draws.efficiency:.0%}"
    )
    moves = settings
    if warm.draws.pareto_k > TRUSTED_K and settings.independence_share > FALLBACK_INDEPENDENCE:
        moves = replace(settings, independence_share=FALLBACK_INDEPENDENCE)
        log(
            f"the proposal is poor (Pareto k̂ > {TRUSTED_K}): falling back on differential "
            f"evolution, {1 - FALLBACK_INDEPENDENCE:.0%} of the moves; slower, the same posterior"
        )

    last: _DrawnBack | None = None

    def wants_more(chains: Chains) -> bool:
        nonlocal last
        z, _ = chains.thinned(draws_per_ensemble)
        last = _drawn_back(model, z, settings.seed)
        return _derived_ess(last, chains.z.shape[2], processes) < settings.target_ess

    chains = sample(
        density_of,
        warm.proposal,
        moves,
        store=store,
        progress=progress,
        more=wants_more,
    )
    return warm, chains, last


def _count(events: Sequence[str]) -> str:
    return f"{len(events)} event{'s' if len(events) != 1 else ''}"


def convergence_table(fit: Sampled | Fit) -> pd.DataFrame:
    """Autocorrelation time, R-hat and effective sample size of every walked parameter.

    Empty for a fit that an earlier version stored without them.
    """
    stats = (fit.fit if isinstance(fit, Sampled) else fit).groups["sample_stats"]
    if WALKED not in stats.coords:
        return pd.DataFrame({"name": [], **{column: [] for column in CONVERGENCE}})
    figures = {column: stats[name].values for column, (name, _) in CONVERGENCE.items()}
    return pd.DataFrame({"name": stats[WALKED].values.astype(object), **figures})


def _stream(seed: int, which: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence((seed, which)))


def collapsed_size(model: Model) -> int:
    """Numbers integrated out: shared thrust levels, and each event's thrusts, torques and so on.

    Torques whose prior has no width are none.
    """
    known = int(np.count_nonzero(model.torque_sd_n_m == 0.0))
    unknowns = model.unknowns
    return int(unknowns.size - unknowns.walked.stop - known * len(unknowns.events))


def _warm_start(
    density_of: LogDensity, starts: Starts, seed: int, store: CheckpointStore | None
) -> WarmStart:
    """The warm start: from its checkpoint, or computed and stored."""
    stored = store.load("warmstart") if store else None
    if stored is not None:
        kept: WarmStart = value_of(WarmStart, stored)
        return kept
    rng = _stream(seed, _WARM_START)
    warm = warm_start(density_of, starts.dimension, rng, starts=starts)
    if store is not None:
        store.save("warmstart", arrays_of(warm))
    return warm


@dataclass(frozen=True)
class _DrawnBack:
    """Stored draws z (M, n, d) with all that is integrated out, and the stream they came from."""

    z: Array
    draws: Draws
    rng: np.random.Generator


def _drawn_back(model: Model, z: Array, seed: int) -> _DrawnBack:
    rng = _stream(seed, _LINEAR)
    return _DrawnBack(z, draw(model, z.reshape(-1, z.shape[-1]), rng), rng)


def _derived_ess(drawn: _DrawnBack, walkers: int, processes: int) -> float:
    """Smallest bulk or tail effective sample size over what is drawn back for these points."""
    m, n, _ = drawn.z.shape
    values = watched(drawn.draws).reshape(m, n, -1)
    varying = np.flatnonzero(values.std((0, 1)) > 0)
    sizes = in_processes(
        lambda places: [min(stored_ess(values[:, :, j], walkers)) for j in places],
        [part for part in np.array_split(varying, processes) if len(part)],
        processes,
    )
    return min((size for part in sizes for size in part), default=np.inf)


def watched(draws: Draws) -> Array:
    """Draws (n, q) that the stop rule watches beside the walked ones: all but cut tails."""
    integrated = [
        values for part in draws.integrated for name, values in part.items() if name != TAILS
    ]
    parts = (draws.thrusts.thrust_n, draws.thrusts.level_n, *integrated)
    return np.concatenate([values.reshape(draws.size, -1) for values in parts], axis=1)
