"""A diagnosis as its user holds it: what the simulation gets wrong, named, sized and measured."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
import xarray as xr

from cassini_bayes.computing.cached import cached_property
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.computing.workers import cores
from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.case import Case
from cassini_bayes.diagnosis.diagnosis import Diagnosis
from cassini_bayes.diagnosis.diagnosis import diagnose as diagnose_case
from cassini_bayes.diagnosis.estimates import is_estimates
from cassini_bayes.diagnosis.read import read_estimate_case, read_events
from cassini_bayes.diagnosis.stages import Progress, StageRunner, no_progress
from cassini_bayes.effects.registry import Kinds, read_kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import Policy
from cassini_bayes.events.totals import split_reference
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.checks import DEFAULT_SEED, check_seed
from cassini_bayes.files.code import code_digest
from cassini_bayes.files.storage import digest
from cassini_bayes.model.event_reduction import is_event_folder
from cassini_bayes.model.gather import READ, EventLike, PathLike, each_event
from cassini_bayes.pipeline.inputs import EVENTS, PRIORS, paths_of
from cassini_bayes.pipeline.models import PriorsLike, priors_of
from cassini_bayes.pipeline.provenance import library_versions, read_provenance, recorded
from cassini_bayes.pipeline.run import CHECKPOINT, open_folder, refuse_own_earlier
from cassini_bayes.prediction.sources import DIAGNOSED, EXTENDED, PROVENANCE, RESOLVED
from cassini_bayes.priors.reader import Priors, spacecraft_file_of
from cassini_bayes.report.shown import html_of, names_shown, with_interval
from cassini_bayes.results.exchange import draws_as_inference_data

if TYPE_CHECKING:
    from cassini_bayes.diagnosis.case import Discrepancies
    from cassini_bayes.diagnosis.discrepancy import Curve
    from cassini_bayes.report.plots import Figure

INTERVAL: Final = "shortest 90 %"
WRITTEN: Final = (
    PROVENANCE,
    CHECKPOINT,
    DIAGNOSED,
    "discrepancy.csv",
    "correlation.csv",
    "figures",
    "drafts",
    EXTENDED,
    "report.html",
    RESOLVED,
)
"""What a diagnosis writes into its folder: all that ``force`` removes, what makes it one last."""
OWN_KEY: Final = "gain"
"""Key of the settings of every diagnosis, which those of a run do not have."""
DIAGNOSED_BY: Final = ("diagnosis.read", "diagnosis.diagnosis")
"""Modules whose code, with all that they import, a diagnosis depends on."""
_MOST_SHOWN: Final = 5


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult:
    """A verdict with its record.

    ``record`` is what ``diagnosis.json`` says; :meth:`summary` is one row per cause and size.
    """

    diagnosis: Diagnosis[Any]
    seed: int
    folder: Path | None = None  # where it is written and keeps what it has finished

    @property
    def record(self) -> dict[str, Any]:
        """All that was found, as plain numbers and strings."""
        return self.diagnosis.record

    @property
    def cause(self) -> str:
        """The most probable hypothesis: a cause, ``none`` or ``unknown``."""
        return str(self.record["causes"][0]["name"])

    @property
    def probability(self) -> float:
        """Posterior probability of :attr:`cause`."""
        return float(self.record["causes"][0]["probability"])

    @cached_property
    def sentences(self) -> tuple[str, ...]:
        """The verdict and the gain in words."""
        from cassini_bayes.report.diagnosis_verdict import verdict_sentences

        return tuple(verdict_sentences(self.record))

    def summary(self) -> pd.DataFrame:
        """One row per hypothesis and size: probability, log Bayes factor (nats), size, interval.

        Returns
        -------
        DataFrame, most probable first, with ``attrs["interval"]``: shortest 90 %. Columns
        ``name``, ``probability``, ``log_bayes_factor_nats``, ``parameter``, ``unit``, ``mean``,
        ``sd``, ``low_90``, ``high_90``, ``confounded_with``.
        """
        rows, unsized = [], {"mean": np.nan, "sd": np.nan, "hdi_90": (np.nan, np.nan)}
        for cause in self.record["causes"]:
            weights = (cause["name"], cause["probability"], cause["log_bayes_factor"])
            confounded = ", ".join(cause["confounded_with"])
            units = self._units(cause["name"])
            for key, size in (cause["parameters"] or {"": unsized}).items():
                values = (size["mean"], size["sd"], *size["hdi_90"])
                rows.append((*weights, key, units.get(key, ""), *values, confounded))
        columns = ["name", "probability", "log_bayes_factor_nats", "parameter", "unit", "mean"]
        columns += ["sd", "low_90", "high_90", "confounded_with"]
        return with_interval(pd.DataFrame(rows, columns=columns), INTERVAL)

    def _units(self, name: str) -> Mapping[str, str]:
        """Units of a cause's sizes, as far as it has parameters of those names."""
        hypotheses = (w.hypothesis for w in self.diagnosis.verdict.weighed if w.name == name)
        effects = (e for h in hypotheses for e in getattr(h, "effects", ()))
        return {p.key: p.unit for effect in effects for p in effect.parameters}

    def plot_causes(self) -> Figure:
        """Probability and log Bayes factor of the most probable hypotheses."""
        from cassini_bayes.report.plots import draw
        from cassini_bayes.report.plots.criticism import cause_figure

        return draw({"causes": partial(cause_figure, self.record["causes"])})["causes"]

    def plot_discrepancy(self) -> Figure | None:
        """Torque that the baseline lacks, integrated, about body axes; None without telemetry."""
        return _drawn(self.diagnosis.curves, "discrepancy")

    def plot_innovations(self) -> Figure | None:
        """Measured less predicted momentum, before and after; None without telemetry."""
        return _drawn(self.diagnosis.shown, "innovations")

    def to_arviz(self, draws: int = 1_000) -> Any:  # ArviZ carries no types
        """Sizes of the extended model's causes as the posterior of ``arviz.InferenceData``.

        Raises
        ------
        InputError
            The verdict names no cause: there is no size.
        """
        case, weighed = self.diagnosis.case, self.diagnosis.extended
        if not weighed.is_cause:
            raise InputError(
                "to_arviz", "a verdict that names a cause", repr(weighed.name), "see summary()"
            )
        rng = np.random.default_rng(self.seed)
        values, weights = case.size_draws(weighed, rng)
        chosen = rng.choice(len(weights), draws, p=weights / weights.sum())
        units = self._units(weighed.name)
        variables = {
            key: xr.DataArray(
                value[chosen][None], dims=("chain", "draw"), attrs={"units": units.get(key, "")}
            )
            for key, value in values.items()
        }
        return draws_as_inference_data(variables, "posterior")

    def fit(
        self, folder: PathLike | None = None, seed: int | None = None, log: Log = silent
    ) -> pd.DataFrame:
        """Sample the extended model with emcee; writes ``fit.nc`` and ``summary.csv``.

        Returns the summary; its ``attrs["stop_rule"]`` says whether the chains have converged.

        Without a ``folder`` it goes into ``extended`` of the diagnosis's own, where a killed fit
        goes on from its last block of draws; :func:`predict` takes it there.

        Raises
        ------
        InputError
            Printed estimates have no model to sample; the folder cannot be written.
        """
        number = self.seed if seed is None else seed
        store = None
        if folder is None:
            if self.folder is None:
                raise InputError("folder", "where to write", "nothing", 'add folder="…"')
            folder = self.folder / EXTENDED
            identity = read_provenance(self.folder / PROVENANCE).identity
            store = CheckpointStore(folder / CHECKPOINT, f"{identity} seed {number}")
        found = self.diagnosis
        return found.case.refit(found.extended, Path(folder), number, log, store)

    def report(self, folder: PathLike) -> Path:
        """Write ``diagnosis.json``, tables, figures and ``report.html``; returns its path."""
        from cassini_bayes.report.diagnosis import write_diagnosis

        place = Path(folder)
        write_diagnosis(self.diagnosis, place, place.name, cores())
        return place / "report.html"

    def __repr__(self) -> str:
        events = names_shown(tuple(self.record["events"]))
        return "\n  ".join([f"DiagnosisResult of {events}:", *self.sentences])

    def _repr_html_(self) -> str:
        title = f"Diagnosis: {self.cause} (probability {self.probability:.2f})"
        return html_of(title, self.sentences, self.summary().head(_MOST_SHOWN))


def _drawn(shown: Discrepancies | Sequence[Curve], name: str) -> Figure | None:
    """The picture of that name as a figure in the house style; None where nothing is shown."""
    from cassini_bayes.report.diagnosis_pictures import pictures_of
    from cassini_bayes.report.plots import draw

    return draw({p.name: p.draw for p in pictures_of(shown) if p.name == name}).get(name)


def diagnose(
    events: EventLike | Iterable[EventLike],
    priors: PriorsLike,
    *,
    effect_files: Sequence[PathLike] = (),
    source: str = "flight",
    gain: bool = True,
    accept: Sequence[str] = (),
    leave_out: bool = False,
    seed: int = DEFAULT_SEED,
    folder: PathLike | None = None,
    force: bool = False,
    resume: bool = False,
    log: Log = silent,
    progress: Progress = no_progress,
    workers: int | None = None,
    command: Sequence[str] = ("cassini_bayes.diagnose",),
) -> DiagnosisResult:
    """Show what the simulation gets wrong, name the cause, measure what it gains.

    Every catalogued cause gets its evidence; ``none`` is the baseline, ``unknown`` the baseline
    with a discrepancy of its own. P(cause | data) is proportional to its evidence times its prior
    probability (:func:`causes` has it).

    Parameters
    ----------
    events
        Event folders, totals files, ``file.csv:ID``, events that were read; or files of printed
        estimates, on their own.
    priors
        A priors file, or what :func:`read_priors` made of it.
    effect_files
        Files of causes beyond those of the package.
    source, accept, leave_out
        As for :func:`build_model`.
    gain
        Whether to hold events out; that takes as many more fits as there are events, twice.
    seed
        Same seed and inputs, same verdict.
    folder
        Where to write the record, tables, figures and page, and to keep every search, lot of
        draws, fit without an event and measure as soon as it is finished; then events and priors
        are named by path. Nothing is written without it.
    force, resume
        With ``folder``: replace an earlier diagnosis; go on with one that was stopped. What it
        finds is bit by bit what it would have found without the stop.
    log, progress
        Told of stages; told of a stage's name, how much of it is done, of how much.
    workers
        Processes; one for each core by default. The result does not depend on it.
    command
        What goes into the record.

    Raises
    ------
    InputError
        Bad data or priors; a folder that holds something else; a diagnosis to resume that began
        with other inputs, settings, code or libraries.
    """
    seed = check_seed(seed)
    given = each_event(events)
    names = [] if folder is None else [*paths_of(given, *EVENTS), *paths_of(priors, *PRIORS)]
    kinds = read_kinds([Path(path) for path in effect_files])
    policy = Policy.of(accept, leave_out=leave_out)
    processes = cores() if workers is None else workers
    known = priors_of(priors)
    place = None if folder is None else Path(folder)
    if place is not None:
        refuse_own_earlier(known, place)
    case = _case(given, priors, known, kinds, source, policy, log, processes)
    digests = _digests(given, priors, case)
    store = None
    if place is not None:
        settings = {
            "events": names[:-1],
            "priors": names[-1],
            "own_effects": [os.fspath(path) for path in effect_files],
            "source": source,
            "accept": sorted(accept),
            "leave_out": leave_out,
            OWN_KEY: gain,
            "seed": seed,
        }
        read = {**digests, **kinds.files}
        store = _opened(place, settings, read, command, force=force, resume=resume)
    results: Diagnosis[Any] = diagnose_case(
        case,
        np.random.default_rng(seed),
        measure_gain=gain,
        log=log,
        workers=StageRunner(processes, store, progress),
    )
    results.record.update(
        {
            "seed": seed,
            "command": list(command),
            "effects": dict(kinds.files),
            "sha256": digests,
            "versions": library_versions(),
        }
    )
    result = DiagnosisResult(results, seed, place)
    if place is not None:
        log("figures and report")
        result.report(place)
    return result


def _opened(
    folder: Path,
    settings: Mapping[str, Any],
    digests: Mapping[str, str],
    command: Sequence[str],
    *,
    force: bool,
    resume: bool,
) -> CheckpointStore:
    """Where a diagnosis keeps what it has finished, in a folder that says what it is of."""
    depends_on = {"settings": settings, "data": digests, "code": code_digest(*DIAGNOSED_BY)}
    provenance = recorded(depends_on, digests, int(settings["seed"]), command)
    provenance = provenance.relative_to(Path(), folder)
    return open_folder(
        folder,
        settings,
        provenance,
        force=force,
        resume=resume,
        what="diagnosis",
        result=DIAGNOSED,
        written=WRITTEN,
        own_key=OWN_KEY,
    )


def _digests(events: Sequence[EventLike], priors: PriorsLike, case: Case[Any]) -> dict[str, str]:
    """SHA-256 of the files that were read, of every telemetry event and its channel map.

    A spacecraft file is named beside the priors that name it.
    """
    given = [event for event in events if not isinstance(event, READ)]
    references = [str(name) for name in given if not is_event_folder(Path(name))]
    tables = [split_reference(reference)[0] for reference in references]
    files = [str(path) for path in (priors, *tables) if not isinstance(path, Priors)]
    result = {path: digest(Path(path)) for path in files} | dict(case.digests)
    own = None if isinstance(priors, Priors) else spacecraft_file_of(str(priors), Path(priors))
    return result if own is None else {**result, own[0]: digest(own[1])}


def _case(
    given: Sequence[EventLike],
    priors: PriorsLike,
    known: Priors,
    kinds: Kinds,
    source: str,
    policy: Policy,
    log: Log,
    processes: int,
) -> Case[Any]:
    paths = [Path(event) for event in given if not isinstance(event, READ)]
    if any(map(is_estimates, paths)):
        if len(paths) < len(given) or isinstance(priors, Priors):
            raise InputError(
                "events", "estimates alone, and a priors file", "others", "diagnose them by path"
            )
        return read_estimate_case([str(path) for path in paths], Path(priors), kinds)
    return BalanceCase(read_events(given, known, source, log, kinds, policy, processes))
