"""The pipeline of one run: settings first, then sampling, then tables, figures and report.

A run folder holds ``resolved.toml`` and ``provenance.json`` (written before sampling starts),
``checkpoint/``, then ``fit.nc``, ``summary.csv``, ``tables/``, ``figures/`` and ``report.html``.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import pandas as pd
import tomli_w
from numpy.typing import NDArray

import cassini_bayes
from cassini_bayes.checkpoint import CheckpointStore
from cassini_bayes.configuration import RunFile
from cassini_bayes.errors import InputError
from cassini_bayes.events import TotalsEvent, read_totals
from cassini_bayes.model import DeltaVUse, TotalsModel, build_model
from cassini_bayes.posterior import log_posterior
from cassini_bayes.priors import Priors, read_priors
from cassini_bayes.result import Fit, build_fit, draws_of, save_fit
from cassini_bayes.review import Review, assemble_review, thrust_variant, worst_convergence
from cassini_bayes.sampling import Chains, ProgressReport, sample
from cassini_bayes.storage import digest, is_leftover, remove_leftovers, write_text
from cassini_bayes.warmstart import ImportanceDraws, Proposal, WarmStart, warm_start

Array = NDArray[np.float64]

LIBRARIES: Final = ("numpy", "scipy", "emcee", "arviz", "xarray", "h5netcdf", "pandas", "corner")
VARIANTS: Final[Mapping[DeltaVUse, str]] = {
    "ignore": "ΔV left out",
    "as-declared": "ΔV as declared (computed)",
    "as-measured": "ΔV as if measured",
}
WARM_START_STREAM, LINEAR_STREAM, VARIANT_STREAM = 1, 2, 3


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


@dataclass(frozen=True)
class Inputs:
    """Data and priors of a run, read and checked."""

    events: tuple[TotalsEvent, ...]
    priors: Priors
    model: TotalsModel
    digests: Mapping[str, str]


def read_inputs(run: RunFile, base: Path) -> Inputs:
    """Read the events and priors a run file names, relative to ``base``, and build the model."""
    priors_path = base / run.priors
    priors = read_priors(priors_path)
    events: list[TotalsEvent] = []
    digests = {run.priors: digest(priors_path)}
    given: dict[str, str] = {}
    for reference in run.events:
        found = read_totals(str(base / reference), priors.spacecraft, run.source)
        for event in found:
            if event.id in given:
                raise InputError(
                    f"{base / reference}: event {event.id}",
                    "each event once in a fit",
                    f"the id that {base / given[event.id]} has given",
                    "leave one of the two out, or rename one of them",
                )
        given |= {event.id: reference for event in found}
        events.extend(found)
        file = _file_of(base, reference)
        digests[file] = digest(base / file)
    model = build_model(
        tuple(events), priors, pulse_shape=run.model.pulse_shape, delta_v=run.model.delta_v
    )
    return Inputs(tuple(events), priors, model, digests)


def _file_of(base: Path, reference: str) -> str:
    """The file that ``file.csv`` or ``file.csv:ID`` names; names and ids may hold colons."""
    file = reference
    while not (base / file).is_file() and ":" in file:
        file = file.rpartition(":")[0]
    return file


def prepare_folder(folder: Path, *, force: bool, resume: bool) -> None:
    """Make the run folder, or refuse: an existing run is never overwritten silently.

    ``resume`` wins over ``force``, so the command that began a run goes on with it once
    ``--resume`` is added. What killed writes left behind counts as nothing, and is removed.

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
        if not force:
            raise InputError(
                str(folder),
                "a new folder",
                "an existing run",
                "use --resume to go on with it, --force to start anew, or another --out",
            )
        # The file that makes it a run goes last, so that a removal cut short can be done again.
        for entry in sorted(folder.iterdir(), key=lambda path: path.name == "resolved.toml"):
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry)
            else:
                entry.unlink()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
    except OSError as error:
        raise InputError(
            str(folder), "a place that can be written", str(error.strerror), "choose another --out"
        ) from error


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
    inputs = read_inputs(run, base)
    model = inputs.model
    settings = run.sampler.settings()
    settings.walkers_for(len(model.space.names))
    identity = _identity(run, inputs)
    provenance = _provenance(run, inputs, identity, command)
    if resume:
        _refuse_other_run(folder / "provenance.json", identity)
    prepare_folder(folder, force=force, resume=resume)
    write_text(folder / "resolved.toml", tomli_w.dumps(run.model_dump()))
    if not (folder / "provenance.json").exists():
        write_text(folder / "provenance.json", json.dumps(provenance, indent=2) + "\n")
    store = CheckpointStore(folder / "checkpoint", identity)
    reporter.say(
        f"{len(inputs.events)} events, {len(model.space.names)} walked and "
        f"{_linear_size(model)} collapsed parameters"
    )
    warm = _stored_warm_start(model, run.sampler.seed, store)
    draws = warm.draws
    reporter.say(
        f"warm start: log evidence {draws.log_evidence:.2f} ± {draws.log_evidence_se:.2f}, "
        f"Pareto k̂ {draws.pareto_k:.2f}, efficiency {draws.efficiency:.0%}"
    )
    target = run.sampler.target_ess

    def wants_more(chains: Chains) -> bool:
        z, _ = chains.thinned(run.output.draws_per_ensemble)
        return _derived_ess(model, z, run.sampler.seed) < target

    chains = sample(
        partial(log_posterior, model),
        warm.proposal,
        settings,
        store=store,
        progress=reporter.progress,
        more=wants_more,
    )
    z, log_density = chains.thinned(run.output.draws_per_ensemble)
    reporter.say(f"drawing thrusts back, {z.shape[0] * z.shape[1]} draws")
    attributes = _attributes(run, warm, chains)
    fit = build_fit(
        model, z, log_density, _stream(run, LINEAR_STREAM), attributes, run.output.prior_draws
    )
    save_fit(fit, folder / "fit.nc")
    reporter.say("tables")
    flat = z.reshape(-1, z.shape[-1])
    review = assemble_review(
        name,
        model,
        inputs.priors,
        fit,
        flat,
        variants=_variants(run, inputs, fit) if run.output.report else [],
        convergence=_convergence_table(model, chains),
        facts=_facts(run, warm, chains, fit, provenance),
        warnings=_warnings(warm, chains, fit),
    )
    converged = _converged(review, chains, target)
    _write_tables(review, folder)
    if run.output.report:
        from cassini_bayes.plots import make_figures, save_figures
        from cassini_bayes.report import write_report

        reporter.say("figures and report")
        figures = make_figures(review)
        save_figures(figures, folder / "figures")
        write_report(review, figures, folder / "report.html")
    seconds = time.monotonic() - began
    reporter.say(f"{'converged' if converged else 'NOT CONVERGED'} in {seconds:.0f} s: {folder}")
    return Outcome(folder, review, converged, seconds)


def _stream(run: RunFile, which: int) -> np.random.Generator:
    """A random stream of its own for each stage, all from the one seed."""
    return np.random.default_rng(np.random.SeedSequence((run.sampler.seed, which)))


def _linear_size(model: TotalsModel) -> int:
    """Numbers of thrusts and torques integrated out: shared levels, and those of each event."""
    torques = int(np.count_nonzero(model.linear.torque_sd_n_m))
    own = int(model.linear.own.shape[1]) + torques
    return int(model.linear.shared.shape[1]) + own * len(model.stack.event_ids)


def _stored_warm_start(model: TotalsModel, seed: int, store: CheckpointStore) -> WarmStart:
    """The warm start of this run: from its checkpoint, or computed and stored."""
    stored = store.load("warmstart")
    if stored is not None:
        values = {key: np.asarray(array, dtype=np.float64) for key, array in stored.items()}
        return WarmStart(
            mode=values["mode"],
            proposal=Proposal(values["location"], values["factor"], float(values["dof"])),
            laplace_log_evidence=float(values["laplace_log_evidence"]),
            draws=ImportanceDraws(
                z=values["z"],
                log_weights=values["log_weights"],
                log_evidence=float(values["log_evidence"]),
                log_evidence_se=float(values["log_evidence_se"]),
                pareto_k=float(values["pareto_k"]),
                efficiency=float(values["efficiency"]),
            ),
        )
    rng = np.random.default_rng(np.random.SeedSequence((seed, WARM_START_STREAM)))
    warm = warm_start(partial(log_posterior, model), len(model.space.names), rng)
    draws = warm.draws
    store.save(
        "warmstart",
        {
            "mode": warm.mode,
            "location": warm.proposal.location,
            "factor": warm.proposal.factor,
            "dof": np.array(warm.proposal.dof),
            "laplace_log_evidence": np.array(warm.laplace_log_evidence),
            "z": draws.z,
            "log_weights": draws.log_weights,
            "log_evidence": np.array(draws.log_evidence),
            "log_evidence_se": np.array(draws.log_evidence_se),
            "pareto_k": np.array(draws.pareto_k),
            "efficiency": np.array(draws.efficiency),
        },
    )
    return warm


def _derived_ess(model: TotalsModel, z: Array, seed: int) -> float:
    """Smallest bulk or tail effective sample size over the thrusts drawn for these points."""
    from arviz import ess  # two seconds to import: only where it is needed

    m, n, d = z.shape
    rng = np.random.default_rng(np.random.SeedSequence((seed, LINEAR_STREAM)))
    _, draws = draws_of(model, z.reshape(-1, d), rng)
    thrust = draws.thrust_n.reshape(m, n, -1)
    varying = thrust[..., thrust.std((0, 1)) > 0]
    sizes = [
        float(ess(varying[:, :, j], method=method))
        for j in range(varying.shape[-1])
        for method in ("bulk", "tail")
    ]
    return min(sizes, default=np.inf)


def _variants(run: RunFile, inputs: Inputs, fit: Fit) -> list[pd.DataFrame]:
    """Thrust posteriors with ΔV left out, as declared, and as if measured.

    The declared use is the fit itself; the others are importance draws, with k̂ in the name of the
    variant where it is too large to trust.
    """
    if not inputs.model.stack.has_delta_v.any():
        return []
    tables = []
    rng = _stream(run, VARIANT_STREAM)
    for use, label in VARIANTS.items():
        if use == run.model.delta_v:
            values = fit.posterior["thrust_n"].values
            tables.append(
                thrust_variant(label, inputs.model, values.reshape(-1, *values.shape[2:]))
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


def _identity(run: RunFile, inputs: Inputs) -> str:
    """Hash of all that the draws depend on: data, priors, model and sampler settings, code."""
    parts = {
        "data": dict(inputs.digests),
        "spacecraft": inputs.priors.spacecraft.digest,
        "source": run.source,
        "events": list(run.events),
        "model": run.model.model_dump(),
        "sampler": run.sampler.model_dump(),
        "code": _code_digest(),
        "libraries": _versions(),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _refuse_other_run(provenance: Path, identity: str) -> None:
    """Refuse to resume what began with other inputs; without a readable record, blocks decide."""
    try:
        earlier = json.loads(provenance.read_bytes())["identity"]
    except (OSError, ValueError, KeyError, TypeError):
        return
    if earlier != identity:
        raise InputError(
            str(provenance),
            "the events, priors, settings and versions that this run began with",
            "others",
            "undo the change and use --resume, or start anew with --force",
        )


def _code_digest() -> str:
    folder = Path(cassini_bayes.__file__).parent
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        total.update(str(path.relative_to(folder)).encode())
        total.update(path.read_bytes())
    return total.hexdigest()


def _versions() -> dict[str, str]:
    return {
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in LIBRARIES},
    }


def _provenance(
    run: RunFile, inputs: Inputs, identity: str, command: Sequence[str]
) -> dict[str, object]:
    return {
        "format": 1,
        "package": {"cassini_bayes": cassini_bayes.__version__, "code_sha256": _code_digest()},
        "versions": _versions(),
        "sha256": dict(inputs.digests),
        "identity": identity,
        "seed": run.sampler.seed,
        "command": [os.fspath(part) for part in command],
        "started_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "events": [event.id for event in inputs.events],
        "walked": list(inputs.model.space.names),
    }


def _attributes(run: RunFile, warm: WarmStart, chains: Chains) -> dict[str, str | float | int]:
    return {
        "package": f"cassini_bayes {cassini_bayes.__version__}",
        "seed": run.sampler.seed,
        "log_evidence": warm.draws.log_evidence,
        "log_evidence_se": warm.draws.log_evidence_se,
        "pareto_k": warm.draws.pareto_k,
        "laplace_log_evidence": warm.laplace_log_evidence,
        "steps": chains.convergence.step,
        "burn_in_steps": chains.burn_in,
        "acceptance": float(chains.acceptance.mean()),
        "stop_rule": "; ".join(chains.convergence.failed) or "all criteria met",
    }


def _convergence_table(model: TotalsModel, chains: Chains) -> pd.DataFrame:
    convergence = chains.convergence
    return pd.DataFrame(
        {
            "name": model.space.names,
            "tau_steps": convergence.autocorrelation_time,
            "rhat": convergence.rhat,
            "ess": convergence.ess,
        }
    )


def _converged(review: Review, chains: Chains, target: int) -> bool:
    rhat, bulk, tail = worst_convergence(review.summary)
    return chains.convergence.done and rhat < 1.01 and bulk >= target and tail >= target


def _warnings(warm: WarmStart, chains: Chains, fit: Fit) -> list[str]:
    found = []
    if not chains.convergence.done:
        found.append(
            "Sampling stopped at its limit before the stop rule held: "
            + "; ".join(chains.convergence.failed)
        )
    if warm.draws.pareto_k > 0.7:
        found.append(
            f"The importance draws behind the evidence are not reliable (Pareto k̂ = "
            f"{warm.draws.pareto_k:.2f} > 0.7)."
        )
    error = fit.groups["sample_stats"]["jacobian_expansion_error"].values
    if error.std() > 0.1:
        found.append(
            f"The expansion of the response Jacobian is off by {error.std():.2f} nats (standard "
            "deviation over the posterior; 0.1 is tolerable)."
        )
    return found


def _facts(
    run: RunFile,
    warm: WarmStart,
    chains: Chains,
    fit: Fit,
    provenance: Mapping[str, object],
) -> dict[str, str]:
    convergence = chains.convergence
    error = fit.groups["sample_stats"]["jacobian_expansion_error"].values
    versions = provenance["versions"]
    assert isinstance(versions, dict)  # built above
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
        "Jacobian expansion": f"error {error.mean():+.4f} ± {error.std():.4f} nats (mean ± sd)",
        "Pulse shape": run.model.pulse_shape,
        "ΔV": run.model.delta_v,
        "Data rows": f"source “{run.source}” of {', '.join(run.events)}",
        "Versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
        "Package": f"cassini_bayes {cassini_bayes.__version__}",
        "Identity": str(provenance["identity"]),
        "Command": " ".join(str(part) for part in _as_list(provenance["command"])),
        "Started (UTC)": str(provenance["started_utc"]),
    }


def _as_list(value: object) -> list[object]:
    return list(value) if isinstance(value, list) else [value]


def _write_tables(review: Review, folder: Path) -> None:
    write_text(folder / "summary.csv", review.summary.to_csv(index=False))
    for name in ("nuisances", "budget", "baseline", "predictive", "balance", "delta_v", "variants"):
        table: pd.DataFrame = getattr(review, name)
        write_text(folder / "tables" / f"{name}.csv", table.to_csv(index=False))
