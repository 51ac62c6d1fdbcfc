"""The pipeline of one run: settings first, then sampling, then tables, figures and report.

A run folder holds ``resolved.toml`` and ``provenance.json`` (written before sampling starts),
``checkpoint/``, then ``fit.nc``, ``summary.csv``, ``tables/``, ``figures/`` and ``report.html``.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import tomli_w

from cassini_bayes import __version__
from cassini_bayes.computing.log import Log
from cassini_bayes.computing.workers import cores
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.errors import InputError
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.reading import exists
from cassini_bayes.files.storage import digest, is_leftover, remove_leftovers, write_text
from cassini_bayes.files.tables import frame_csv
from cassini_bayes.model.observability import observability
from cassini_bayes.model.posterior import Model
from cassini_bayes.pipeline.inputs import STATISTICS, read_inputs
from cassini_bayes.pipeline.provenance import Provenance, provenance_of, refuse_other_run
from cassini_bayes.pipeline.run_file import RunFile, is_resolved
from cassini_bayes.prediction.sources import PROVENANCE, RESOLVED
from cassini_bayes.priors.reader import Priors
from cassini_bayes.report.sections import pictures_of, sections_of, write_tables
from cassini_bayes.report.verdict import verdict
from cassini_bayes.results.fitting import ALL_MET, convergence_table, fit_model
from cassini_bayes.results.record import FIT_FILE, Fit, save_fit
from cassini_bayes.results.review import Review, is_converged
from cassini_bayes.sampling.ensembles import ProgressReport, steps_kept

CHECKPOINT: Final = "checkpoint"
SWEEP: Final = "sweep"
"""Folder of a run that keeps what a sweep made of its fit."""
FIGURES: Final = "figures"
REPORT: Final = "report.html"
WRITTEN: Final = (
    PROVENANCE,
    CHECKPOINT,
    STATISTICS,
    FIT_FILE,
    "summary.csv",
    "tables",
    FIGURES,
    REPORT,
    SWEEP,
    RESOLVED,  # last: it makes a folder a run, so a removal cut short can be done again
)
"""What a run and its sweep write into its folder: all that ``--force`` removes."""
OWN_KEY: Final = "sampler"
"""Key of the settings of every run, which those of a diagnosis do not have."""


class Reporter(Protocol):
    """How a run reports what it is doing."""

    def log(self, text: str) -> None:
        """One line about a stage that begins or has ended."""

    def progress(self, report: ProgressReport) -> None:
        """Where sampling stands, and the time left."""

    def count(self, what: str, done: int, total: int) -> None:
        """Pieces of a stage that are done, and the time left."""


class Quiet:
    """A reporter that does nothing: a library does not print."""

    def log(self, text: str) -> None:
        """Nothing."""

    def progress(self, report: ProgressReport) -> None:
        """Nothing."""

    def count(self, what: str, done: int, total: int) -> None:
        """Nothing."""


@dataclass(frozen=True)
class Outcome:
    """What a run produced; ``converged`` decides the exit code, ``verdict`` is the answer."""

    folder: Path
    review: Review
    converged: bool
    seconds: float
    verdict: tuple[str, ...] = ()


def prepare_folder(
    folder: Path,
    *,
    force: bool,
    resume: bool,
    what: str = "run",
    result: str = FIT_FILE,
    written: Sequence[str] = WRITTEN,
    own_key: str = OWN_KEY,
) -> None:
    """Make the folder of a run, or refuse: an existing run is never overwritten silently.

    ``resume`` wins over ``force``, so the command that began a run goes on with it once
    ``--resume`` is added. What killed writes left behind counts as nothing, and is removed; so does
    a run that ended before its first checkpoint: it holds no draws. Only what runs write is ever
    removed (``written``), a user's own files beside it stay. Settings of runs and of diagnoses have
    a file of the same name, and neither takes the folder of the other: a fit would be left beside
    settings that are not its own.

    Parameters
    ----------
    folder, force, resume
        The folder, and the options of these names.
    what, result, written
        What such a folder is of, the file that ends it, and all that is written there, the file
        that makes the folder one of these last.
    own_key
        A key that this file has in folders of this kind only.

    Raises
    ------
    InputError
        The run exists and neither ``--force`` nor ``--resume`` was given; ``--resume`` without a
        run; ``--force`` on a folder that is not a run's; a place that cannot be written.
    """
    is_run = is_resolved(folder / written[-1], own_key)
    if resume:
        if not is_run:
            raise InputError(
                str(folder), f"a {what} to resume", "none there", "start it without --resume"
            )
        remove_leftovers(folder)
        return
    if folder.exists() and not folder.is_dir():
        raise InputError(str(folder), f"a folder for the {what}", "a file", "choose another --out")
    if folder.is_dir() and not all(map(is_leftover, folder.iterdir())):
        if not is_run:
            raise InputError(
                str(folder),
                f"a new folder, or an earlier {what} of this package (with {written[-1]})",
                "a folder that holds something else",
                f"--force only replaces a {what}: choose another --out",
            )
        if not force and _has_begun(folder, result):
            raise InputError(
                str(folder),
                "a new folder",
                f"an existing {what}",
                "use --resume to go on with it, --force to start anew, or another --out",
            )
        _remove(folder, written)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
    except OSError as error:
        raise InputError(
            str(folder), "a place that can be written", str(error.strerror), "choose another --out"
        ) from error


def _remove(folder: Path, names: Sequence[str]) -> None:
    """Remove files and folders of these names, of a link the link."""
    for entry in (folder / name for name in names):
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink(missing_ok=True)


def open_folder(
    folder: Path,
    settings: Mapping[str, Any],
    provenance: Provenance,
    *,
    resume: bool,
    max_steps: int | None = None,
    **how: Any,
) -> CheckpointStore:
    """The checkpoints of a folder, which says what it is of; ``how`` as for :func:`prepare_folder`.

    Parameters
    ----------
    max_steps
        Steps after which a run gives up.

    Raises
    ------
    InputError
        As :func:`prepare_folder`; a run to resume that began with something else, or that has more
        steps than ``max_steps`` already.
    """
    kept = folder / PROVENANCE
    store = CheckpointStore(folder / CHECKPOINT, provenance.identity)
    if resume:
        refuse_other_run(kept, provenance, settings)
        if max_steps is not None:
            _refuse_fewer_steps(store, max_steps)
    prepare_folder(folder, resume=resume, **how)
    write_text(folder / RESOLVED, tomli_w.dumps(settings))
    if not kept.exists():
        write_text(kept, provenance.as_json() + "\n")
    return store


def _refuse_fewer_steps(store: CheckpointStore, max_steps: int) -> None:
    """A shorter fit would replace the one that these steps have made, perhaps a converged one."""
    kept = steps_kept(store)
    if max_steps < kept:
        raise InputError(
            str(store.folder),
            f"max_steps of at least {kept}, the steps kept there",
            str(max_steps),
            f"use --max-steps {kept} or more (max_steps of [sampler]), or start anew with --force",
        )


def refuse_own_earlier(priors: Priors, folder: Path) -> None:
    """Refuse a folder that holds the fit which priors begin with: ``--force`` would remove it."""
    earlier = priors.earlier
    if earlier is not None and Path(earlier.path).resolve().is_relative_to(folder.resolve()):
        raise InputError(
            str(folder),
            "another folder than that of the fit that the priors begin with",
            earlier.path,
            "choose another --out",
        )


def _has_begun(folder: Path, result: str) -> bool:
    """Whether a run has got as far as its first checkpoint."""
    return (folder / result).exists() or any((folder / CHECKPOINT).glob("*.npz"))


def execute(
    run: RunFile,
    base: Path,
    folder: Path,
    *,
    where: str = "run",
    name: str,
    command: Sequence[str],
    reporter: Reporter,
    force: bool = False,
    resume: bool = False,
    kinds: Kinds | None = None,
) -> Outcome:
    """Run everything a run file asks for and write it to ``folder``.

    Parameters
    ----------
    run, base
        The run file and the folder its paths are relative to.
    where
        The run file for messages.
    command
        The command line, for the record.
    kinds
        The effects that the run file may name; those of the package by default.

    Raises
    ------
    InputError
        Anything wrong with the inputs or the folder; nothing is sampled then, nor removed.
    """
    began = time.monotonic()
    inputs = read_inputs(run, base, folder, reporter.log, kinds, where)
    refuse_own_earlier(inputs.priors, folder)
    settings = run.sampler.settings()
    settings.walkers_for(len(inputs.model.space.names), f"{where}: sampler.walkers")
    provenance = provenance_of(run, inputs.digests, inputs.priors.spacecraft.digest, command)
    provenance = provenance.relative_to(base, folder)
    said, steps = run.model_dump(), settings.max_steps
    store = open_folder(folder, said, provenance, force=force, resume=resume, max_steps=steps)
    if inputs.model.telemetry or inputs.model.effects:
        for sentence in observability(inputs.model).sentences:
            reporter.log(sentence)
    inputs.store(folder)
    sampled = fit_model(
        inputs.model,
        settings,
        draws_per_ensemble=run.output.draws_per_ensemble,
        prior_draws=run.output.prior_draws,
        store=store,
        log=reporter.log,
        progress=reporter.progress,
        threads=cores(),
    )
    save_fit(sampled.fit, folder / FIT_FILE)
    review = Review(
        name=name,
        model=inputs.model,
        priors=inputs.priors,
        fit=sampled.fit,
        z=sampled.flat_z,
        convergence=convergence_table(sampled),
        facts=facts_of(run, inputs.model, sampled.fit, provenance),
        notes=(*inputs.findings, *sampled.warnings),
        seed=run.sampler.seed,
        what_if=run.output.report,
    )
    review.work_out(cores())
    converged = is_converged(review)
    write_results(review, folder, reporter.log, report=run.output.report)
    seconds = time.monotonic() - began
    reporter.log(f"{'converged' if converged else 'NOT CONVERGED'} in {seconds:.0f} s: {folder}")
    return Outcome(folder, review, converged, seconds, tuple(verdict(review)))


def write_results(review: Review, folder: Path, log: Log, *, report: bool) -> None:
    """Write what a run makes of its fit: ``summary.csv``, ``tables/``, figures and report.

    A page that is there already keeps the section of a sweep of the same fit.

    Parameters
    ----------
    report
        Whether to draw ``figures/`` and write ``report.html`` too. Without them, those that are
        there are removed: they may be of a shorter fit.
    """
    if not report:
        _remove(folder, (REPORT, FIGURES))
    log("tables")
    sections = sections_of(review)
    write_text(folder / "summary.csv", frame_csv(review.summary))
    write_tables(sections, folder / "tables")
    if report:
        from cassini_bayes.report import write_report
        from cassini_bayes.report.plots import save_pictures

        log("figures and report")
        pictures = pictures_of(sections, cores())
        save_pictures(pictures, folder / FIGURES)
        write_report(review, sections, pictures, folder / REPORT, _sweep_section(folder))


def _sweep_section(folder: Path) -> str:
    """What a sweep of the fit in a folder has added to the report there; empty where none has."""
    from cassini_bayes.report.sweep import section_in

    page, fit = folder / REPORT, folder / FIT_FILE
    if not (exists(page) and exists(fit)):
        return ""
    return section_in(page.read_text("utf-8", errors="replace"), digest(fit))


def facts_of(
    run: RunFile, model: Model, fit: Fit, provenance: Provenance | None = None
) -> dict[str, str]:
    """Statements about a run as a whole, by heading, from its settings and its fit."""
    kept = fit.attributes
    stats = fit.groups["sample_stats"]
    expansion = {}
    if "jacobian_expansion_error" in stats:
        error = stats["jacobian_expansion_error"].values
        expansion["Jacobian expansion"] = (
            f"error {error.mean():+.4f} ± {error.std():.4f} nats (mean ± sd)"
        )
    return {
        "Stop rule": _stop_rule(fit, run.sampler.target_ess),
        "Sampler": (
            f"{run.sampler.ensembles} independent ensembles of {kept['walkers']} walkers, "
            f"acceptance {kept['acceptance']:.0%}, seed {run.sampler.seed}"
        ),
        "Draws": (
            f"{fit.posterior.sizes['chain']} × {fit.posterior.sizes['draw']} stored, after "
            f"{kept['burn_in_steps']} burn-in steps"
        ),
        "Log evidence": (
            f"{kept['log_evidence']:.3f} ± {kept['log_evidence_se']:.3f} (importance draws, "
            f"Pareto k̂ {kept['pareto_k']:.2f}{_efficiency(fit)}; Laplace "
            f"{kept['laplace_log_evidence']:.3f})"
        ),
        **expansion,
        "Pulse shape": run.model.pulse_shape,
        "ΔV": run.model.delta_v,
        **({"Effects": ", ".join(run.model.effects)} if run.model.effects else {}),
        "Data rows": _data_rows(run, model),
        **({"Accepted mistakes": ", ".join(run.accept)} if run.accept else {}),
        **({} if provenance is None else _origin(provenance)),
    }


def _stop_rule(fit: Fit, target_ess: int) -> str:
    """The criteria with their figures, as far as the fit has them (earlier versions kept none)."""
    kept = fit.attributes
    if "largest_tau_steps" not in kept:
        return f"at step {kept['steps']}: {kept['stop_rule']}"
    return (
        f"{'met' if kept['stop_rule'] == ALL_MET else 'NOT met'} at step {kept['steps']}: steps "
        f"after burn-in > 50 τ (largest τ {kept['largest_tau_steps']:.1f} steps), τ changed < 5 % "
        f"(changed {kept['tau_change']:.1%}), R-hat between ensembles < 1.01 "
        f"({kept['worst_rhat']:.4f}), bulk and tail ESS ≥ {target_ess} ({kept['least_ess']:.0f})"
    )


def _efficiency(fit: Fit) -> str:
    share = fit.attributes.get("importance_efficiency")
    return "" if share is None else f", efficiency {share:.0%}"


def _origin(provenance: Provenance) -> dict[str, str]:
    return {
        "Versions": ", ".join(f"{name} {version}" for name, version in provenance.versions.items()),
        "Package": f"cassini_bayes {__version__}",
        "SHA-256 of the inputs": "; ".join(
            f"{name} {value}" for name, value in provenance.digests.items()
        ),
        "Identity": provenance.identity,
        "Command": " ".join(provenance.command),
        "Started (UTC)": provenance.started_utc,
    }


def _data_rows(run: RunFile, model: Model) -> str:
    """Where the data came from; the source chooses rows of totals files only."""
    named, rows = ", ".join(run.events), f"source “{run.source}”"
    if not model.telemetry:
        return f"{rows} of {named}"
    return f"telemetry{f'; totals rows of {rows}' if model.totals else ''}: {named}"
