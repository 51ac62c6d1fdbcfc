"""Events and priors that a run names, read, checked and made into a model."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import Policy
from cassini_bayes.events.totals import split_reference
from cassini_bayes.files.storage import digest
from cassini_bayes.model.event_reduction import ReducedEvent, store_reduction
from cassini_bayes.model.gather import read_reference, together
from cassini_bayes.model.posterior import Event, Model
from cassini_bayes.pipeline.models import model_of
from cassini_bayes.pipeline.run_file import RunFile
from cassini_bayes.priors.reader import Priors, read_priors, spacecraft_file_of

STATISTICS: Final = "statistics"
"""Folder of a run that keeps its reduced telemetry."""
EVENTS: Final = ("events", "the folder of an event")
PRIORS: Final = ("priors", 'priors="priors/….toml"')
"""What :func:`paths_of` is asked for, and an example of it."""


@dataclass(frozen=True)
class Inputs:
    """Data and priors of a run, read and checked, and the model of them."""

    events: tuple[Event, ...]
    priors: Priors
    model: Model
    digests: Mapping[str, str]
    findings: tuple[str, ...] = ()  # mistakes that were accepted, and what fits nothing known

    def store(self, folder: Path) -> None:
        """Keep the reduced telemetry beside the run."""
        for event in self.events:
            if isinstance(event, ReducedEvent):
                store_reduction(event, folder / STATISTICS)


def read_inputs(
    run: RunFile,
    base: Path,
    folder: Path | None = None,
    log: Log = silent,
    kinds: Kinds | None = None,
    where: str = "run",
) -> Inputs:
    """Read the events and priors a run file names, relative to ``base``, and build the model.

    An event is a folder of telemetry, a totals CSV (all its rows) or ``file.csv:ID``.

    Parameters
    ----------
    folder
        The run's folder: telemetry that an earlier run there reduced is taken from it.
    log
        Told what was read of the telemetry.
    kinds
        The effects that a run file may name; those of the package by default.
    where
        The run file for messages.

    Raises
    ------
    InputError
        Bad data or priors, an unknown mistake or effect, an event that is there twice.
    """
    priors_path = base / run.priors
    priors = read_priors(priors_path)
    digests = {run.priors: digest(priors_path)}
    if (own := spacecraft_file_of(run.priors, priors_path)) is not None:
        digests[own[0]] = priors.spacecraft.digest
    if priors.earlier is not None:
        digests[priors.earlier.path] = priors.earlier.digest
    given: dict[str, str] = {}
    reads = []
    policy = Policy.of(run.accept, leave_out=run.leave_out, where=f"{where}: accept")
    cache = None if folder is None else folder / STATISTICS
    for reference in run.events:
        read = read_reference(
            base / reference,
            priors,
            pulse_shape=run.model.pulse_shape,
            source=run.source,
            policy=policy,
            log=log,
            cache=cache,
        )
        reads.append(read)
        file, _ = split_reference(reference, base)
        for event in read.events:
            if event.id in given:
                raise InputError(
                    f"{base / reference}: event {event.id}",
                    "each event once in a fit",
                    f"the id that {base / given[event.id]} has given",
                    "leave one of the two out, or rename one of them",
                )
            if isinstance(event, ReducedEvent):
                digests[reference] = event.digest
                if event.channels is not None:
                    digests[f"channels of {reference}"] = event.channels.digest
            elif file not in digests:
                digests[file] = digest(base / file)
        given |= dict.fromkeys((event.id for event in read.events), reference)
    events, findings = together(reads, priors, policy)
    if kinds is not None:
        digests |= kinds.files
    asked = run.model
    named = f"{where}: model.effects"
    model = model_of(events, priors, asked.pulse_shape, asked.delta_v, asked.effects, kinds, named)
    return Inputs(events, priors, model, digests, findings)


def paths_of(given: Any, what: str, example: str) -> list[str]:
    """Paths as the record of a run names them; ``what`` they are of, and an example.

    Raises
    ------
    InputError
        Something that is no path: the folder could not say what it was made of.
    """
    several = list(given) if isinstance(given, list | tuple) else [] if given is None else [given]
    for one in several:
        if not isinstance(one, str | os.PathLike):
            raise InputError(
                "folder",
                "events and priors named by their paths, so that it says what it is of",
                type(one).__name__,
                "give paths, or leave folder out and save the result",
            )
    if not several:
        raise InputError(what, "at least one path", "none", f"give e.g. {example}")
    return [os.fspath(one) for one in several]
