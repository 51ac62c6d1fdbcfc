"""A fit as its user holds it: sampled or read back; its tables, figures, and ArviZ data."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeGuard

import numpy as np
import pandas as pd

from cassini_bayes.computing.cached import cached_property
from cassini_bayes.computing.workers import cores
from cassini_bayes.effects.effect import Effect
from cassini_bayes.effects.registry import read_kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import Policy
from cassini_bayes.events.telemetry.event import DESCRIPTION
from cassini_bayes.files.checks import check_known, check_seed
from cassini_bayes.files.reading import exists
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.files.validated import validated
from cassini_bayes.model.draws import event_log_marginal
from cassini_bayes.model.gather import EventLike, PathLike, each_event
from cassini_bayes.model.posterior import Model
from cassini_bayes.model.totals import DeltaVUse
from cassini_bayes.pipeline.inputs import EVENTS, PRIORS, Inputs, paths_of, read_inputs
from cassini_bayes.pipeline.models import PriorsLike, read_model
from cassini_bayes.pipeline.provenance import changed_inputs, in_words, read_provenance
from cassini_bayes.pipeline.run import Quiet, Reporter, execute, facts_of, write_results
from cassini_bayes.pipeline.run_file import (
    OutputTable,
    RunFile,
    SamplerTable,
    check_run,
    read_run_file,
)
from cassini_bayes.prediction.sources import PROVENANCE, RESOLVED, locate
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.report.plots.scalars import headlines, scalar_corner, trace_figure
from cassini_bayes.report.shown import html_of, names_shown, value_with_unit, with_interval
from cassini_bayes.results import record
from cassini_bayes.results.exchange import inference_data
from cassini_bayes.results.fitting import (
    convergence_table,
    fit_model,
    fit_warnings,
    stop_rule_held,
)
from cassini_bayes.results.record import FIT_FILE, Fit, save_fit
from cassini_bayes.results.review import Review
from cassini_bayes.results.tables import hdi, summarise
from cassini_bayes.sampling.ensembles import SamplerSettings
from cassini_bayes.spacecraft.parameters import SOFTWARE
from cassini_bayes.sweep.models import chosen_names, units_of, values_of, walked_values

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure

INTERVAL: Final = "90 % highest density"
KEPT: Final = (OutputTable().draws_per_ensemble, OutputTable().prior_draws, OutputTable().report)
"""Draws of an ensemble, draws of the prior, and whether there is a report, where none is said."""


@dataclass(frozen=True, eq=False, repr=False)
class FitResult(Fit):
    """Draws of a fit, and what is asked of them.

    ``posterior``, ``prior`` and ``groups`` are xarray datasets with units; :meth:`summary` is one
    row per scalar, ``plot_…`` are figures of matplotlib, :meth:`to_arviz` is ArviZ's view. What
    needs the model (thrust figure, report, leave-one-out) asks :attr:`review`, which reads the
    run's events and priors when first used.
    """

    name: str
    make_review: Callable[[], Review]
    path: Path | None = None  # of fit.nc, where it is in a run's folder

    @cached_property
    def review(self) -> Review:
        """The fit with its model and priors, and every table of the report.

        Raises
        ------
        InputError
            The events or priors of a fit read back are not where its run found them.
        """
        return self.make_review()

    @property
    def model(self) -> Model:
        """The model that was fitted."""
        return self.review.model

    @property
    def events(self) -> tuple[str, ...]:
        """Ids of its events."""
        return tuple(map(str, self.posterior["event"].values))

    @property
    def converged(self) -> bool:
        """Whether the stop rule held while sampling."""
        return stop_rule_held(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about anything that makes the draws doubtful."""
        return tuple(fit_warnings(self))

    def summary(self, quantities: str | Sequence[str] | None = None) -> pd.DataFrame:
        """One row per scalar: unit, mean, sd, median, 90 % HDI, prior, ESS, R-hat.

        Parameters
        ----------
        quantities
            Names or patterns with ``*``, as in the column ``name`` (``thrust_level_n``,
            ``inertia_*``); all by default.

        Returns
        -------
        DataFrame with ``attrs["interval"]``: 90 % highest density.

        Raises
        ------
        InputError
            A pattern that names nothing, with the nearest name.
        """
        table = self._summary
        if quantities is not None:
            names = self._named(quantities)
            table = table[table["name"].isin(names)].reset_index(drop=True)
        return with_interval(table, INTERVAL)

    @cached_property
    def _summary(self) -> pd.DataFrame:
        return summarise(self)

    def _named(self, quantities: str | Sequence[str] | None) -> tuple[str, ...]:
        if quantities is None:
            return headlines(self.posterior)
        patterns = [quantities] if isinstance(quantities, str) else list(quantities)
        return chosen_names(self.posterior, patterns, "quantities")

    def plot_corner(self, quantities: str | Sequence[str] | None = None) -> Figure | None:
        """Corner plot with the priors drawn in; None with fewer than two scalars that vary."""
        return self._drawn("corner", partial(scalar_corner, self, self._named(quantities)))

    def plot_trace(self, quantities: str | Sequence[str] | None = None) -> Figure | None:
        """Draws in their order, one colour an ensemble."""
        return self._drawn("trace", partial(trace_figure, self, self._named(quantities)))

    def plot_thrusts(self) -> Figure | None:
        """Thrust of every thruster in every event, beside prior and the methods replaced."""
        return self.plot("thrusts")

    def plot_priors(self) -> Figure | None:
        """Prior against posterior of every walked parameter."""
        return self.plot("nuisances")

    def plot(self, name: str) -> Figure:
        """Any figure of the report by its name, as :attr:`figures` lists them.

        Raises
        ------
        InputError
            No such figure of this fit.
        """
        figure = None if name not in self._drawings else self._drawn(name, self._drawings[name])
        if figure is None:
            raise InputError("figure", f"one of {', '.join(self.figures)}", name, "choose one")
        return figure

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the report's figures."""
        return tuple(self._drawings)

    @cached_property
    def _drawings(self) -> Mapping[str, Callable[[], Figure | None]]:
        from cassini_bayes.report.sections import sections_of

        sections = sections_of(self.review)
        return {drawing.name: drawing.draw for section in sections for drawing in section.drawings}

    def _drawn(self, name: str, make: Callable[[], Figure | None]) -> Figure | None:
        from cassini_bayes.report.plots import draw

        return draw({name: make}).get(name)

    def to_arviz(self, *, marginal: bool = True) -> Any:  # ArviZ carries no types
        """The fit as ``arviz.InferenceData``.

        ``az.summary``, ``az.plot_trace``, ``az.plot_ppc``, ``az.loo`` and ``az.psens`` take it.

        Parameters
        ----------
        marginal
            ``log_likelihood`` is log p(data of an event | what all events share), its own
            departures of thrust, torque and momentum integrated out under their priors: the event
            is then the unit of ``az.loo``. That needs the model; without it (``False``) the density
            given everything, the event's own unknowns too, as ``fit.nc`` has it.
        """
        return inference_data(self, self._event_density() if marginal else None)

    def _event_density(self) -> Any:
        review, posterior = self.review, self.posterior
        size = posterior.sizes["chain"] * posterior.sizes["draw"]

        def flat(name: str) -> Any:
            values = np.asarray(posterior[name].values, dtype=np.float64)
            return values.reshape(size, *values.shape[2:])

        levels = flat("thrust_level_n") if "thrust_level_n" in posterior else np.zeros((size, 0))
        has_software = all(name in posterior for name in SOFTWARE)
        software = np.stack([flat(name) for name in SOFTWARE], axis=-1) if has_software else None
        return event_log_marginal(review.model, review.z, levels, software)

    def save(self, path: PathLike) -> None:
        """Write the draws as NetCDF 4, atomically; :func:`read_fit` and ArviZ read them."""
        save_fit(Fit(self.groups, self.attributes), Path(path))

    def _headlines(self) -> pd.DataFrame:
        """A few scalars with their intervals beside their priors, without sampling diagnostics."""
        names = headlines(self.posterior)
        after, before = values_of(self.posterior, names), values_of(self.prior, names)
        low, high = hdi(after)
        table = pd.DataFrame(
            {
                "name": names,
                "unit": units_of(self.posterior, names),
                "mean": after.mean(0),
                "sd": after.std(0, ddof=1),
                "hdi_90_low": low,
                "hdi_90_high": high,
                "prior_mean": before.mean(0),
                "prior_sd": before.std(0, ddof=1),
            }
        )
        return with_interval(table, INTERVAL)

    def _state(self) -> str:
        sizes = self.posterior.sizes
        state = "converged" if self.converged else f"NOT CONVERGED ({self.attributes['stop_rule']})"
        return (
            f"{state}; {sizes['chain']} × {sizes['draw']} draws; events {names_shown(self.events)}"
        )

    def __repr__(self) -> str:
        lines = [f"FitResult {self.name}: {self._state()}"]
        for row in self._headlines().to_dict(orient="records"):
            posterior = value_with_unit(row["mean"], row["sd"], row["unit"])
            prior = value_with_unit(row["prior_mean"], row["prior_sd"], row["unit"])
            lines.append(f"  {row['name']}: {posterior} (prior {prior})")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return html_of(f"Fit {self.name}", [self._state(), *self.warnings], self._headlines())


def fit(
    events: PathLike | EventLike | Iterable[EventLike] | Model,
    priors: PriorsLike | None = None,
    *,
    effects: Sequence[str | Effect] = (),
    effect_files: Sequence[PathLike] = (),
    pulse_shape: str = "first_order",
    delta_v: DeltaVUse = "as-declared",
    source: str = "flight",
    accept: Sequence[str] = (),
    leave_out: bool = False,
    sampler: SamplerSettings | Mapping[str, Any] | None = None,
    seed: int | None = None,
    draws_per_ensemble: int = KEPT[0],
    prior_draws: int = KEPT[1],
    folder: PathLike | None = None,
    report: bool = KEPT[2],
    force: bool = False,
    resume: bool = False,
    reporter: Reporter | None = None,
) -> FitResult:
    """Posterior of thrusts, inertia and all that is not known besides, sampled with emcee.

    Parameters
    ----------
    events
        Event folders, totals files, ``file.csv:ID`` or events that were read, one or several; or a
        model (:func:`build_model`); or a run file (``.toml``), which says all the rest.
    priors
        A priors file, or what :func:`read_priors` made of it; a model or run file has its own.
    effects, effect_files, pulse_shape, delta_v, source, accept, leave_out
        As for :func:`build_model`.
    sampler
        :class:`SamplerSettings`, or some of its fields as a mapping.
    seed
        Same seed and inputs, same draws; overrides that of ``sampler``.
    draws_per_ensemble, prior_draws
        How many draws are kept.
    folder
        Where to write a run (settings, ``fit.nc``, tables, figures, ``report.html``), as the
        command line does; then events and priors are named by path. Nothing is written without it.
    report, force, resume
        With ``folder``: whether to draw figures and write the page; replace an earlier run; go on
        with one.
    reporter
        Called with stages and progress; by default nothing is.

    Returns
    -------
    FitResult
        Draws with units, tables, figures.

    Raises
    ------
    InputError
        Bad data, priors or settings, before anything is sampled.
    """
    given = _given(sampler, seed)
    settings = validated(SamplerTable, given, "sampler").settings()
    told = reporter or Quiet()
    if _is_run_file(events):
        path = Path(events)
        said = (priors, *effects, pulse_shape, delta_v, source, *accept, leave_out)
        kept = (draws_per_ensemble, prior_draws, report)
        if (*said, *kept) != (None, "first_order", "as-declared", "flight", False, *KEPT):
            raise InputError(
                "fit", "a run file alone", "priors or settings beside it", "write them into it"
            )
        run = read_run_file(path, given)
        target = folder or path.parent / (run.output.folder or path.stem)
        return _written(run, path, target, effect_files, force, resume, told)
    if folder is not None:
        named = events if isinstance(events, Model) else each_event(events)
        table = {
            "events": paths_of(named, *EVENTS),
            "priors": paths_of(priors, *PRIORS)[0],
            "source": source,
            "accept": list(accept),
            "leave_out": leave_out,
            "model": {
                "pulse_shape": pulse_shape,
                "delta_v": delta_v,
                "effects": [str(effect) for effect in effects],
            },
            "sampler": given,
            "output": {
                "draws_per_ensemble": draws_per_ensemble,
                "prior_draws": prior_draws,
                "report": report,
            },
        }
        run = check_run(table, "fit")
        return _written(run, Path("fit"), folder, effect_files, force, resume, told)
    policy = Policy.of(accept, leave_out=leave_out)
    reading = (effects, effect_files, pulse_shape, delta_v, source, policy, told.log)
    read = read_model(events, priors, *reading)
    model = read.model
    sampled = fit_model(
        model,
        settings,
        draws_per_ensemble=draws_per_ensemble,
        prior_draws=prior_draws,
        log=told.log,
        progress=told.progress,
        threads=cores(),
    )
    review = Review(
        name="fit",
        model=model,
        priors=model.priors,
        fit=sampled.fit,
        z=sampled.flat_z,
        convergence=convergence_table(sampled),
        facts={},
        notes=(*read.findings, *sampled.warnings),
        seed=settings.seed,
    )
    return result_of(review)


def _is_run_file(events: object) -> TypeGuard[PathLike]:
    """Whether it is the path of a run file, and no event named by its ``event.toml``."""
    if not isinstance(events, str | os.PathLike):
        return False
    return Path(events).suffix == ".toml" and Path(events).name != DESCRIPTION


def _given(sampler: SamplerSettings | Mapping[str, Any] | None, seed: int | None) -> dict[str, Any]:
    """The sampler's settings that the caller gives, all of them where they are a record."""
    given = dict(vars(sampler) if isinstance(sampler, SamplerSettings) else sampler or {})
    known = tuple(vars(SamplerSettings()))
    for key in given:
        check_known(f"sampler: {key}", key, known, f"some of {', '.join(known)}")
    if seed is not None:
        given["seed"] = seed
    if "seed" in given:
        given["seed"] = check_seed(given["seed"])
    return given


def _written(
    run: RunFile,
    file: Path,
    folder: PathLike,
    effect_files: Sequence[PathLike],
    force: bool,
    resume: bool,
    reporter: Reporter,
) -> FitResult:
    """A run of a file, or of what stands for one, written to its folder."""
    target = Path(folder)
    outcome = execute(
        run,
        file.parent,
        target,
        where=str(file),
        name=target.name,
        command=["cassini_bayes.fit"],
        reporter=reporter,
        force=force,
        resume=resume,
        kinds=read_kinds([Path(path) for path in effect_files]),
    )
    return result_of(outcome.review, target / FIT_FILE)


def result_of(review: Review, path: Path | None = None) -> FitResult:
    """The fit of a review as its user holds it."""
    fit = review.fit
    return FitResult(fit.groups, fit.attributes, review.name, lambda: review, path)


def read_fit(
    path: PathLike, *, base: PathLike | None = None, effect_files: Sequence[PathLike] = ()
) -> FitResult:
    """Read a fit back: a run's folder, or its ``fit.nc``.

    Parameters
    ----------
    path
        Folder of a run, or a ``fit.nc``.
    base
        Folder that the run's paths of events and priors are relative to, where they have moved.
    effect_files
        Files of effects that the run was given.

    Raises
    ------
    InputError
        Missing, truncated or changed file; no fit of this package. Events, priors, the earlier fit
        that these begin with or files of effects that are not those of the run are refused once
        they are asked for.
    """
    place = Path(path)
    file = place / FIT_FILE if place.is_dir() else place
    stored = record.read_fit(file)
    name = file.parent.name or file.stem
    make = partial(_review_of, file, stored, name, base, tuple(effect_files))
    return FitResult(stored.groups, stored.attributes, name, make, file)


def _review_of(
    file: Path, stored: Fit, name: str, base: PathLike | None, effect_files: Sequence[PathLike]
) -> Review:
    """The review of a fit that was stored, its model built again."""
    folder = file.parent
    resolved = folder / RESOLVED
    if not exists(resolved):
        raise InputError(
            str(file),
            "the run that it is of, with resolved.toml beside it",
            "a fit that stands alone",
            "name the run's folder; summary, corner and trace need the fit alone",
        )
    run = check_run(read_toml(resolved, "what a run was resolved to"), str(resolved))
    if base is None:
        priors_path = locate(file, run.priors, "--base")
        priors = read_priors(priors_path)
        events = [str(locate(file, event, "--base", priors)) for event in run.events]
        run = run.model_copy(update={"events": events, "priors": str(priors_path)})
    kinds = read_kinds([Path(path) for path in effect_files])
    place = Path() if base is None else Path(base)
    inputs = read_inputs(run, place, folder, kinds=kinds, where=str(resolved))
    _refuse_changed(file, inputs)
    model = inputs.model
    z = model.space.to_standard(
        walked_values(stored.posterior, model.space.names, model.spacecraft)
    )
    kept = folder / PROVENANCE
    provenance = read_provenance(kept) if exists(kept) else None
    return Review(
        name=name,
        model=model,
        priors=inputs.priors,
        fit=stored,
        z=z,
        convergence=convergence_table(stored),
        facts=facts_of(run, model, stored, provenance),
        notes=(*inputs.findings, *fit_warnings(stored)),
        seed=run.sampler.seed,
        what_if=True,
    )


def _refuse_changed(file: Path, inputs: Inputs) -> None:
    """Refuse to show a fit beside inputs that it is not of, wherever they were found."""
    changed = changed_inputs(file.parent / PROVENANCE, inputs.digests)
    if changed:
        raise InputError(
            str(file),
            "the inputs as they were when the fit was made",
            f"others: {in_words(changed)}",
            "restore them, name an unchanged copy with --base, or run the fit again",
        )


def report(
    fit: FitResult | PathLike,
    folder: PathLike | None = None,
    *,
    base: PathLike | None = None,
    effect_files: Sequence[PathLike] = (),
    reporter: Reporter | None = None,
) -> Path:
    """Write tables, figures and the page of a fit: what a run writes of it.

    Parameters
    ----------
    fit
        A fit, or the folder of a finished run.
    folder
        Where to write; by default the run's own folder. A fit in memory has none.
    base, effect_files
        As for :func:`read_fit`.
    reporter
        Told of stages.

    Returns
    -------
    Path of ``report.html``.

    Raises
    ------
    InputError
        No fit there; its events or priors are not where the run found them, or are not as they
        were; a folder of another run.
    """
    result = (
        fit if isinstance(fit, FitResult) else read_fit(fit, base=base, effect_files=effect_files)
    )
    own = None if result.path is None else result.path.parent
    target = own if folder is None else Path(folder)
    if target is None:
        raise InputError("folder", "where to write", "nothing", 'add folder="…"')
    if exists(target / RESOLVED) and (own is None or target.resolve() != own.resolve()):
        raise InputError(
            str(target),
            "a new folder, or that of the fit itself",
            f"another run or diagnosis (with {RESOLVED})",
            "choose another --out",
        )
    review = result.review
    if not review.what_if:
        review = replace(review, what_if=True)
    write_results(review, target, (reporter or Quiet()).log, report=True)
    return target / "report.html"
