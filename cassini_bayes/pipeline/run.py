"""The pipeline of one run: settings first, then sampling, then tables, figures and report.

A run folder holds ``resolved.toml`` and ``provenance.json`` (written before sampling starts),
``checkpoint/``, then ``fit.nc``, ``summary.csv``, ``tables/``, ``figures/`` and ``report.html``.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import pandas as pd
import tomli_w

from cassini_bayes import __version__
from cassini_bayes.computing.workers import cores
from cassini_bayes.errors import InputError
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.storage import is_leftover, remove_leftovers, write_text
from cassini_bayes.model.joint import JointModel
from cassini_bayes.model.observability import observability
from cassini_bayes.model.posterior import log_posterior
from cassini_bayes.model.totals import DeltaVUse, build_model
from cassini_bayes.pipeline.inputs import STATISTICS, Inputs, read_inputs
from cassini_bayes.pipeline.provenance import Provenance, provenance_of, refuse_other_run
from cassini_bayes.pipeline.run_file import RunFile
from cassini_bayes.results.fitting import Sampled, convergence_table, fit_model
from cassini_bayes.results.joint_review import assemble_joint_review
from cassini_bayes.results.record import Fit, draws_of, save_fit
from cassini_bayes.results.review import Review, assemble_review, thrust_variant, worst_convergence
from cassini_bayes.sampling.ensembles import MAX_RHAT, ProgressReport
from cassini_bayes.sampling.warmstart import warm_start

VARIANTS: Final[Mapping[DeltaVUse, str]] = {
    "ignore": "ΔV left out",
    "as-declared": "ΔV as declared",
    "as-measured": "ΔV as if measured",
}
VARIANT_STREAM: Final = 3
WRITTEN: Final = (
    "provenance.json",
    "checkpoint",
    STATISTICS,
    "fit.nc",
    "summary.csv",
    "tables",
    "figures",
    "report.html",
    "resolved.toml",  # last: it makes a folder a run, so a removal cut short can be done again
)
"""What a run writes into its folder: all that ``--force`` removes."""
SERIES_STREAM: Final = 4


class Reporter(Protocol):
    """Where a run says what it is doing."""

    def say(self, text: str) -> None:
        """One line about a stage that begins or has ended."""

    def progress(self, report: ProgressReport) -> None:
        """Where sampling stands, and the time left."""


@dataclass(frozen=True)
class Outcome:
    """What a run produced; ``converged`` decides the exit code."""

    folder: Path
    review: Review
    converged: bool
    seconds: float


def prepare_folder(folder: Path, *, force: bool, resume: bool) -> None:
    """Make the run folder, or refuse: an existing run is never overwritten silently.

    ``resume`` wins over ``force``, so the command that began a run goes on with it once
    ``--resume`` is added. What killed writes left behind counts as nothing, and is removed; so does
    a run that ended before its first checkpoint: it holds no draws. Only what runs write is ever
    removed (:data:`WRITTEN`), a user's own files beside it stay.

    Raises
    ------
    InputError
        The run exists and neither ``--force`` nor ``--resume`` was given; ``--resume`` without a
        run; ``--force`` on a folder that is not a run's; a place that cannot be written.
    """
    is_run = (folder / "resolved.toml").exists()
    if resume:
        if not is_run:
            raise InputError(
                str(folder), "a run to resume", "none there", "start it without --resume"
            )
        remove_leftovers(folder)
        return
    if folder.exists() and not folder.is_dir():
        raise InputError(str(folder), "a folder for the run", "a file", "choose another --out")
    if folder.is_dir() and not all(map(is_leftover, folder.iterdir())):
        if not is_run:
            raise InputError(
                str(folder),
                "a new folder, or an earlier run of this package (with resolved.toml)",
                "a folder that holds something else",
                "--force only replaces runs: choose another --out",
            )
        if not force and _holds_draws(folder):
            raise InputError(
                str(folder),
                "a new folder",
                "an existing run",
                "use --resume to go on with it, --force to start anew, or another --out",
            )
        for entry in (folder / name for name in WRITTEN):
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry)
            else:
                entry.unlink(missing_ok=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
    except OSError as error:
        raise InputError(
            str(folder), "a place that can be written", str(error.strerror), "choose another --out"
        ) from error


def _holds_draws(folder: Path) -> bool:
    """Whether a run has got as far as its first checkpoint."""
    return (folder / "fit.nc").exists() or any((folder / "checkpoint").glob("*.npz"))


def execute(
    run: RunFile,
    base: Path,
    folder: Path,
    *,
    name: str,
    command: Sequence[str],
    reporter: Reporter,
    force: bool = False,
    resume: bool = False,
) -> Outcome:
    """Run everything a run file asks for and write it to ``folder``.

    Parameters
    ----------
    run, base
        The run file and the folder its paths are relative to.
    command
        The command line, for the record.

    Raises
    ------
    InputError
        Anything wrong with the inputs or the folder; nothing is sampled then.
    """
    began = time.monotonic()
    inputs = read_inputs(run, base, folder, reporter.say)
    settings = run.sampler.settings()
    settings.walkers_for(len(inputs.model.space.names))
    provenance = provenance_of(run, inputs.digests, inputs.priors.spacecraft.digest, command)
    if resume:
        refuse_other_run(folder / "provenance.json", provenance.identity)
    if isinstance(inputs.model, JointModel):
        for sentence in observability(inputs.model).sentences:
            reporter.say(sentence)
    prepare_folder(folder, force=force, resume=resume)
    write_text(folder / "resolved.toml", tomli_w.dumps(run.model_dump()))
    if not (folder / "provenance.json").exists():
        write_text(folder / "provenance.json", provenance.as_json() + "\n")
    inputs.store(folder)
    sampled = fit_model(
        inputs.model,
        settings,
        events=inputs.telemetry,
        draws_per_ensemble=run.output.draws_per_ensemble,
        prior_draws=run.output.prior_draws,
        store=CheckpointStore(folder / "checkpoint", provenance.identity),
        say=reporter.say,
        progress=reporter.progress,
        threads=cores(),
    )
    save_fit(sampled.fit, folder / "fit.nc")
    reporter.say("tables")
    review = _review(name, run, inputs, sampled, provenance)
    converged = _converged(review, sampled)
    _write_tables(review, folder)
    if run.output.report:
        from cassini_bayes.report import write_report
        from cassini_bayes.report.plots import make_figures, save_figures

        reporter.say("figures and report")
        figures = make_figures(review)
        save_figures(figures, folder / "figures")
        write_report(review, figures, folder / "report.html")
    seconds = time.monotonic() - began
    reporter.say(f"{'converged' if converged else 'NOT CONVERGED'} in {seconds:.0f} s: {folder}")
    return Outcome(folder, review, converged, seconds)


def _review(
    name: str, run: RunFile, inputs: Inputs, sampled: Sampled, provenance: Provenance
) -> Review:
    """Every table of the run, for either kind of model."""
    if isinstance(inputs.model, JointModel):
        return assemble_joint_review(
            name,
            inputs.model,
            inputs.telemetry,
            inputs.priors,
            sampled.fit,
            sampled.flat_z,
            convergence=convergence_table(sampled),
            facts=_facts(run, sampled, provenance),
            warnings=sampled.warnings,
            rng=np.random.default_rng(np.random.SeedSequence((run.sampler.seed, SERIES_STREAM))),
        )
    return assemble_review(
        name,
        inputs.model,
        inputs.priors,
        sampled.fit,
        sampled.flat_z,
        variants=_variants(run, inputs, sampled.fit) if run.output.report else [],
        convergence=convergence_table(sampled),
        facts=_facts(run, sampled, provenance),
        warnings=sampled.warnings,
    )


def _variants(run: RunFile, inputs: Inputs, fit: Fit) -> list[pd.DataFrame]:
    """Thrust posteriors with ΔV left out, as declared, and as if measured.

    The declared use is the fit itself; the others are importance draws, with k̂ in the name of the
    variant where it is too large to trust.
    """
    assert inputs.totals is not None  # asked for with totals rows only
    if not inputs.totals.stack.has_delta_v.any():
        return []
    tables = []
    rng = np.random.default_rng(np.random.SeedSequence((run.sampler.seed, VARIANT_STREAM)))
    for use, label in VARIANTS.items():
        if use == run.model.delta_v:
            values = fit.posterior["thrust_n"].values
            tables.append(
                thrust_variant(label, inputs.totals, values.reshape(-1, *values.shape[2:]))
            )
            continue
        model = build_model(
            inputs.events, inputs.priors, pulse_shape=run.model.pulse_shape, delta_v=use
        )
        warm = warm_start(partial(log_posterior, model), len(model.space.names), rng)
        z = warm.draws.resample(rng, len(warm.draws.z))
        _, draws = draws_of(model, z, rng)
        trusted = warm.draws.pareto_k < 0.7
        note = (
            "" if trusted else f" (importance draws, k̂ = {warm.draws.pareto_k:.2f}: not reliable)"
        )
        tables.append(thrust_variant(label + note, model, draws.thrust_n))
    return tables


def _converged(review: Review, sampled: Sampled) -> bool:
    rhat, bulk, tail = worst_convergence(review.summary)
    target = sampled.settings.target_ess
    done = sampled.chains.convergence.done
    return done and rhat < MAX_RHAT and bulk >= target and tail >= target


def _facts(run: RunFile, sampled: Sampled, provenance: Provenance) -> dict[str, str]:
    fit, warm, chains = sampled.fit, sampled.warm, sampled.chains
    convergence = chains.convergence
    stats = fit.groups["sample_stats"]
    expansion = {}
    if "jacobian_expansion_error" in stats:
        error = stats["jacobian_expansion_error"].values
        expansion["Jacobian expansion"] = (
            f"error {error.mean():+.4f} ± {error.std():.4f} nats (mean ± sd)"
        )
    return {
        "Stop rule": (
            f"{'met' if convergence.done else 'NOT met'} at step {convergence.step}: steps after "
            f"burn-in > 50 τ (largest τ {convergence.autocorrelation_time.max():.1f} steps), τ "
            f"changed < 5 % (changed {convergence.tau_change:.1%}), R-hat between ensembles < 1.01 "
            f"({convergence.rhat.max():.4f}), bulk and tail ESS ≥ {run.sampler.target_ess} "
            f"({convergence.ess.min():.0f})"
        ),
        "Sampler": (
            f"{run.sampler.ensembles} independent ensembles of {chains.z.shape[2]} walkers, "
            f"acceptance {chains.acceptance.mean():.0%}, seed {run.sampler.seed}"
        ),
        "Draws": (
            f"{fit.posterior.sizes['chain']} × {fit.posterior.sizes['draw']} stored, after "
            f"{chains.burn_in} burn-in steps"
        ),
        "Log evidence": (
            f"{warm.draws.log_evidence:.3f} ± {warm.draws.log_evidence_se:.3f} (importance draws, "
            f"Pareto k̂ {warm.draws.pareto_k:.2f}, efficiency {warm.draws.efficiency:.0%}; Laplace "
            f"{warm.laplace_log_evidence:.3f})"
        ),
        **expansion,
        "Pulse shape": run.model.pulse_shape,
        "ΔV": run.model.delta_v,
        "Data rows": _data_rows(run, sampled),
        "Versions": ", ".join(f"{name} {version}" for name, version in provenance.versions.items()),
        "Package": f"cassini_bayes {__version__}",
        "SHA-256 of the inputs": "; ".join(
            f"{name} {value}" for name, value in provenance.digests.items()
        ),
        "Identity": provenance.identity,
        "Command": " ".join(provenance.command),
        "Started (UTC)": provenance.started_utc,
    }


def _data_rows(run: RunFile, sampled: Sampled) -> str:
    """Where the data came from; the source chooses rows of totals files only."""
    named = ", ".join(run.events)
    if isinstance(sampled.model, JointModel):
        totals = f"; totals rows of source “{run.source}”" if sampled.model.totals else ""
        return f"telemetry{totals}: {named}"
    return f"source “{run.source}” of {named}"


def _write_tables(review: Review, folder: Path) -> None:
    write_text(folder / "summary.csv", review.summary.to_csv(index=False))
    names = ["nuisances", "budget", "baseline", "predictive", "balance", "delta_v", "variants"]
    if review.telemetry is not None:
        for name, table in review.telemetry.tables().items():
            write_text(folder / "tables" / f"{name}.csv", table.to_csv(index=False))
    for name in names:
        table = getattr(review, name)
        write_text(folder / "tables" / f"{name}.csv", table.to_csv(index=False))
