"""Where a fit came from: the events, priors and model settings behind a ``fit.nc``."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from cassini_bayes.balance.totals_system import NOISE
from cassini_bayes.effects.catalogue import read_catalogue
from cassini_bayes.effects.effect import Effect
from cassini_bayes.effects.registry import Kinds, read_kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import Policy, content_of_totals, refuse_duplicates
from cassini_bayes.events.recorded_totals import is_bias, recorded_totals
from cassini_bayes.events.telemetry import TelemetryEvent, read_event
from cassini_bayes.events.telemetry.event import DESCRIPTION, event_path
from cassini_bayes.events.totals import TotalsEvent, read_totals, split_reference
from cassini_bayes.files.json_file import read_json
from cassini_bayes.files.netcdf import read_groups
from cassini_bayes.files.reading import exists
from cassini_bayes.files.storage import digest
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.model.event_reduction import is_event_folder
from cassini_bayes.model.nominal import check_rows
from cassini_bayes.model.posterior import Model, build_model
from cassini_bayes.model.totals import DeltaVUse
from cassini_bayes.prediction.beliefs import read_beliefs
from cassini_bayes.prediction.demand import pair_layout
from cassini_bayes.prediction.learning import Learned, learn
from cassini_bayes.prediction.physics import check_one_branch, physics_of_fit
from cassini_bayes.priors.reader import Priors, read_priors, spacecraft_file_of
from cassini_bayes.results.record import Fit

FIT_DRAWS = 2_000
RESOLVED: Final = "resolved.toml"
"""What a run or a diagnosis was resolved to, in its folder."""
PROVENANCE: Final = "provenance.json"
"""What a run, a diagnosis or a trend was made of and by, in its folder."""
DIAGNOSED: Final = "diagnosis.json"
"""In the folder above the fit of a diagnosis's extended model."""
EXTENDED: Final = "extended"
"""Where that fit is, in the diagnosis's folder."""


@dataclass(frozen=True)
class Sources:
    """Wheel biases of a fit as totals, its priors, and the model of those totals.

    ``within`` are effects of the fit that act within an event: totals do not have them.
    """

    events: tuple[TotalsEvent, ...]
    priors: Priors
    model: Model
    within: tuple[str, ...] = ()

    @property
    def wheels(self) -> tuple[int, ...]:
        """Wheels that were prime in an event: of others nothing was learned, not even a ramp."""
        return tuple(sorted({number for event in self.events for number in event.wheels}))


def read_sources(
    fit: Path,
    events: str | None = None,
    priors: Path | None = None,
    source: str | None = None,
    accept: Sequence[str] = (),
    effect_files: Sequence[Path] = (),
) -> Sources:
    """Read what a fit was made of.

    A run folder says it itself (``resolved.toml``, with digests in ``provenance.json``), and that
    of a diagnosis for the fit of its extended model; for a ``fit.nc`` that stands alone, or whose
    files have moved, name them. Effects that were fitted by name are in the model; files of effects
    are code, and only those that are given are read, whatever the record names.

    Raises
    ------
    InputError
        The fit is missing, or is that of a mission; its events, its priors, the earlier fit that
        these begin with or its files of effects cannot be found unchanged; an effect of its that no
        file given has; a layout of thrusters that prediction does not know; priors without what the
        totals of a planned bias need.
    """
    if not exists(fit):
        raise InputError(
            str(fit),
            "a fit.nc of this package",
            "no such file",
            "make one: cassini-bayes run RUN.toml",
        )
    home = record_folder(fit)
    resolved = _resolved(home)
    if not resolved:  # as beside a fit of a mission, which no --events or --priors make another
        posterior = read_groups(fit, {"posterior": ()}, "a fit.nc of this package")[0]["posterior"]
        check_one_branch(fit, posterior)
    record = str(home / RESOLVED)
    model_table = resolved.get("model", {})
    if not isinstance(model_table, dict):
        raise InputError(f"{record}: model", "a table", repr(model_table), "run the fit again")
    is_run = home == fit.parent and bool(resolved)
    names = _names(model_table, "effects", f"{record}: model") if is_run else extended_by(fit)
    digests, _ = _recorded(home)
    kinds = read_kinds(effect_files)
    _check_effects(fit, _names(resolved, "own_effects", record) if names else (), kinds, digests)
    priors_path = priors or locate(fit, resolved.get("priors"), "--priors")
    read = read_priors(priors_path)
    if is_run:
        _check_earlier(fit, read, digests)
    references = (
        [event_path(events)]
        if events
        else [str(locate(fit, n, "--events", read)) for n in _names(resolved, "events", record)]
    )
    if not references:
        raise InputError(
            str(fit), "the events it was made of", "no resolved.toml beside it", "name --events"
        )
    rows = source or str(resolved.get("source", "flight"))
    policy = Policy.of([*_names(resolved, "accept", record), *accept])
    tables = {
        name: read_totals(name, read.spacecraft, rows)
        for name in references
        if not is_event_folder(Path(name))
    }
    for name, table in tables.items():
        check_rows(table, read, name, policy)
    printed = tuple(event for table in tables.values() for event in table)
    refuse_duplicates([(event.id, content_of_totals(event)) for event in printed], policy)
    folders = (Path(name) for name in references if is_event_folder(Path(name)))
    recordings = [read_event(folder, read.spacecraft) for folder in folders]
    if events:
        _check_unchanged(fit, references[0], _names(resolved, "events", record), recordings)
    wheels = {n for event in printed for n in event.wheels}
    wheels |= {n for event in recordings for n in event.wheels}
    effects = fitted_effects(names, read, wheels, kinds)
    pulse_shape = str(model_table.get("pulse_shape", "first_order"))
    delta_v = model_table.get("delta_v", "as-declared")
    return _of_biases(str(fit), printed, recordings, read, effects, pulse_shape, delta_v)


def sources_of(model: Model) -> Sources:
    """What a fit in memory was made of, from its model.

    Raises
    ------
    InputError
        No wheel bias among its events; layout or priors as for :func:`read_sources`.
    """
    rows = tuple(row for term in model.totals for row in term.rows)
    recordings = [term.event.recording for term in model.telemetry if term.event.recording]
    delta_v: DeltaVUse = model.totals[0].delta_v if model.totals else "as-declared"
    shapes = [term.pulse_shape for term in model.totals]
    shapes += [term.event.sampling.pulse_shape for term in model.telemetry]
    name = shapes[0].name
    return _of_biases("fit", rows, recordings, model.priors, model.effects, name, delta_v)


def _of_biases(
    fit: str,
    rows: Sequence[TotalsEvent],
    recordings: Sequence[TelemetryEvent],
    priors: Priors,
    effects: Sequence[Effect],
    pulse_shape: str,
    delta_v: DeltaVUse,
) -> Sources:
    """Totals rows and recorded wheel biases; slews and burns teach no firing logic."""
    recorded = (
        recorded_totals(recording, priors.spacecraft)
        for recording in recordings
        if is_bias(recording)
    )
    result = (*rows, *recorded)
    if not result:
        raise InputError(
            fit,
            "a fit with wheel biases among its events",
            f"none of {', '.join(recording.id for recording in recordings)} is one",
            "predict from a fit of wheel biases: they show how thrusters are fired",
        )
    # first what no file can mend, then at once all that telemetry did not need
    pair_layout(priors.spacecraft, priors.branch)
    priors.require(NOISE, "a prediction: put all of them into a copy, and name it with --priors")
    model = build_model(
        result,
        priors,
        pulse_shape=pulse_shape,
        delta_v=delta_v,
        effects=[effect for effect in effects if not effect.needs_search],
    )
    within = tuple(effect.name for effect in effects if is_within(effect))
    return Sources(result, priors, model, within)


def record_folder(fit: Path) -> Path:
    """The folder that says what a ``fit.nc`` was made of: its own, or that of its diagnosis."""
    above = fit.parent.parent
    is_extended = not exists(fit.parent / RESOLVED) and exists(above / DIAGNOSED)
    return above if is_extended else fit.parent


def extended_by(fit: Path) -> list[str]:
    """Causes that a diagnosis has extended the model of a fit by; none of any other fit."""
    causes = str(read_groups(fit, {}, "a fit.nc of this package")[1].get("causes", ""))
    return [name for name in causes.split("+") if name not in ("", "none", "unknown")]


def fitted_effects(
    names: Sequence[str], priors: Priors, wheels: Collection[int], kinds: Kinds
) -> tuple[Effect, ...]:
    """The effects of a fit by name, whatever data showed them.

    Raises
    ------
    InputError
        A name that no kind of effect has.
    """
    catalogue = read_catalogue(priors, sorted(wheels), ("telemetry", "totals"), kinds)
    return tuple(catalogue.effect(name).as_fitted() for name in names)


def is_within(effect: Effect) -> bool:
    """Whether an effect acts on the rows of an event, so that totals do not have it."""
    return effect.kind.columns is not None or effect.kind.search is not None


def learn_from_fit(
    fit: Path | Fit,
    sources: Sources,
    seed: int,
    beliefs: Path | None = None,
) -> Learned:
    """Condition prediction on a fit and the events behind it.

    ``beliefs`` is a file of priors of prediction, in place of those of the package.
    """
    rng = np.random.default_rng(np.random.SeedSequence((seed, 0)))
    physics = physics_of_fit(sources.model, fit, rng, FIT_DRAWS)
    believed = read_beliefs(beliefs, sources.model.spacecraft.control_cycle_s)
    return learn(sources.model, sources.events, physics, believed, rng, FIT_DRAWS)


def _resolved(folder: Path) -> dict[str, Any]:
    path = folder / RESOLVED
    return read_toml(path, "what a run was resolved to") if path.exists() else {}


def _names(table: Mapping[str, Any], key: str, where: str) -> list[str]:
    """Names under a key of the record; none where it has no such key."""
    names = table.get(key, [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{where}, key {key}", "a list of names", repr(names), "run the fit again")
    return names


def locate(fit: Path, name: object, option: str, priors: Priors | None = None) -> Path:
    """The file or event folder that a run names, looked for from the run file's folder on.

    Where that has moved, from the folder that holds the run, from the current one, and from the
    run's own. It has the digest that the run wrote down, and so has the spacecraft file that a
    priors file names. ``priors`` say of which spacecraft an event folder is.

    Raises
    ------
    InputError
        It is nowhere, or has changed; ``option`` is how to name it.
    """
    if not isinstance(name, str):
        raise InputError(
            str(fit), f"{option}, as no resolved.toml lies beside it", "none", f"name {option}"
        )
    folder = record_folder(fit)
    digests, first = _recorded(folder)
    changed: list[tuple[str, Path]] = []
    for base in (*(folder / own for own in first), fit.parent.parent, Path(), fit.parent):
        path = Path(event_path(os.path.normpath(base / name)))
        if priors is not None and exists(path / DESCRIPTION):
            known, found = digests.get(name), read_event(path, priors.spacecraft).digest
        else:
            table, _ = split_reference(name, base)
            file = base / table
            if not exists(file) or not file.is_file():
                continue
            known, found = digests.get(table), digest(file)
        if known not in (None, found):
            changed.append((name, path))
            continue
        own = spacecraft_file_of(name, path) if priors is None else None
        if own is None or digests.get(own[0]) in (None, digest(own[1])):
            return path
        changed.append(own)
    what, place = changed[0] if changed else (name, None)
    raise InputError(
        str(fit),
        f"{what} as it was when the fit was made",
        "no such file" if place is None else f"{place}, which has changed",
        f"name it with {option}, or run the fit again"
        if place is None
        else f"restore it, name an unchanged copy with {option}, or run the fit again",
    )


def _check_effects(
    fit: Path, named: Sequence[str], kinds: Kinds, digests: Mapping[str, str]
) -> None:
    """Files of effects that the fit's record names: all of them given, and as they were."""
    given = {Path(path).name for path in kinds.files}
    missing = [name for name in named if Path(name).name not in given]
    if missing:
        asked = " ".join(f"--effects {name}" for name in missing)
        raise InputError(
            str(fit),
            "the files of effects that the fit was given",
            f"none named {', '.join(Path(name).name for name in missing)}",
            f"look at what they do, and add {asked} (effect_files in Python)",
        )
    for path, own in kinds.files.items():
        before = {value for name, value in digests.items() if Path(name).name == Path(path).name}
        if before and own not in before:
            raise InputError(
                path,
                f"the file as it was when {fit} was made",
                "other content",
                "restore it, or run the fit again",
            )


def _check_earlier(fit: Path, priors: Priors, digests: Mapping[str, str]) -> None:
    """The fit that the priors begin with: one that the record of a run has, if it has any."""
    earlier = priors.earlier
    if earlier is not None and digests and earlier.digest not in digests.values():
        raise InputError(
            str(fit),
            f"{earlier.path}, which its priors begin with, as it was when the fit was made",
            "another fit",
            "restore it, or run the fit again",
        )


def _check_unchanged(
    fit: Path, reference: str, recorded: Sequence[str], recordings: Sequence[TelemetryEvent]
) -> None:
    """Events named by hand: of those that the fit's record names one has the same content."""
    digests, _ = _recorded(record_folder(fit))
    names = {split_reference(name)[0] for name in recorded}
    known = {digests[name] for name in names if name in digests}
    table = Path(split_reference(reference)[0])
    found = {own.digest for own in recordings} or {digest(table)}
    if known and not found <= known:
        raise InputError(
            f"--events {reference}",
            "the events as they were when the fit was made",
            "other content",
            "name what the fit was made of, or run it again",
        )


def _recorded(folder: Path) -> tuple[dict[str, str], tuple[str, ...]]:
    """Digests by name, and the folder that names are relative to, if a record says so."""
    path = folder / PROVENANCE
    if not path.exists():
        return {}, ()
    record = read_json(path, "the record of a run")
    result, base = record.get("sha256"), record.get("base")
    if not isinstance(result, dict):
        raise InputError(
            f"{path}: sha256", "digests by file name", repr(result), "run the fit again"
        )
    digests = {str(key): str(value) for key, value in result.items()}
    return digests, (base,) if isinstance(base, str) and base else ()
