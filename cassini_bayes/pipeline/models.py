"""The model of events and priors as a caller gives them, paths or objects alike."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.effects.catalogue import named_effects
from cassini_bayes.effects.effect import Effect
from cassini_bayes.effects.registry import Kinds, read_kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import Policy
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model import posterior
from cassini_bayes.model.gather import EventLike, PathLike, gather
from cassini_bayes.model.order import in_order_of_time
from cassini_bayes.model.posterior import Event, Model
from cassini_bayes.model.totals import DeltaVUse
from cassini_bayes.priors.reader import Priors, read_priors

PriorsLike = PathLike | Priors


def priors_of(priors: PriorsLike | None) -> Priors:
    """Priors, read where a file is named.

    Raises
    ------
    InputError
        None were given, or the file is bad.
    """
    if priors is None:
        raise InputError("priors", "a priors file", "none", 'add priors="priors/….toml"')
    return priors if isinstance(priors, Priors) else read_priors(Path(priors))


def build_model(
    events: EventLike | Iterable[EventLike],
    priors: PriorsLike,
    *,
    pulse_shape: str = "first_order",
    delta_v: DeltaVUse = "as-declared",
    effects: Sequence[str | Effect] = (),
    effect_files: Sequence[PathLike] = (),
    source: str = "flight",
    accept: Sequence[str] = (),
    leave_out: bool = False,
) -> Model:
    """Assemble the model of any mix of totals rows and telemetry events of one thruster branch.

    Parameters
    ----------
    events
        Event folders, totals files, ``file.csv:ID``, or events that were read; one or several.
    priors
        A priors file, or what :func:`read_priors` made of it.
    pulse_shape
        ``first_order``, ``rectangular``, ``published_2005`` or ``published_2012``.
    delta_v
        Of totals rows. ``as-declared``: each row's ``delta_v_source`` decides; ``ignore``; or
        ``as-measured``, every ΔV taken as a measurement of thrust (a what-if).
    effects
        Names of effects to fit beyond the standard physics, e.g. ``"thruster_leak:z3"``
        (:func:`causes` lists them).
    effect_files
        Files of effects that are not of this package.
    source
        Which rows of totals files.
    accept, leave_out
        Mistakes in the data that are none; whether single bad cells are left out.

    Returns
    -------
    Model
        Log density, walked parameters (``model.space``) and what is integrated out.

    Raises
    ------
    InputError
        Bad data or priors, with file, place, and how to mend it.
    """
    policy = Policy.of(accept, leave_out=leave_out)
    read = read_model(events, priors, effects, effect_files, pulse_shape, delta_v, source, policy)
    return read.model


@dataclass(frozen=True)
class ReadModel:
    """A model with its events as they were given, and what was found in them."""

    model: Model
    events: tuple[Event, ...]
    findings: tuple[str, ...] = ()


def read_model(
    events: EventLike | Iterable[EventLike] | Model,
    priors: PriorsLike | None,
    effects: Sequence[str | Effect],
    effect_files: Sequence[PathLike],
    pulse_shape: str,
    delta_v: DeltaVUse,
    source: str,
    policy: Policy,
    log: Log = silent,
) -> ReadModel:
    """As :func:`build_model`, with what was read and found; a model is taken as it is.

    Raises
    ------
    InputError
        As :func:`build_model`; anything but the defaults beside a model, which has its own.
    """
    if isinstance(events, Model):
        given = {
            "priors": priors is not None,
            "effects": bool(effects),
            "effect_files": bool(effect_files),
            "pulse_shape": pulse_shape != "first_order",
            "delta_v": delta_v != "as-declared",
            "source": source != "flight",
            "accept": bool(policy.accepted),
            "leave_out": policy.leave_out,
        }
        names = ", ".join(name for name, is_given in given.items() if is_given)
        if names:
            raise InputError(
                names,
                "a model alone",
                f"{names} beside it",
                "give what it is made of to build_model",
            )
        return ReadModel(events, events.sources)
    known = priors_of(priors)
    read, findings = gather(
        events, known, pulse_shape=pulse_shape, source=source, policy=policy, log=log
    )
    kinds = read_kinds([Path(path) for path in effect_files])
    model = model_of(read, known, pulse_shape, delta_v, effects, kinds)
    return ReadModel(model, read, findings)


def model_of(
    events: Sequence[Event],
    priors: Priors,
    pulse_shape: str,
    delta_v: DeltaVUse,
    effects: Sequence[str | Effect],
    kinds: Kinds | None = None,
    where: str = "effects",
) -> Model:
    """The model of events that are ready, its effects as they are or by name, given ``where``.

    Raises
    ------
    InputError
        As :func:`build_model`; nothing is walked, so that there is nothing to sample.
    """
    names = [effect for effect in effects if isinstance(effect, str)]
    given = [effect for effect in effects if not isinstance(effect, str)]
    wheels = sorted({number for event in events for number in event.wheels})
    inputs = ["totals" if isinstance(event, TotalsEvent) else "telemetry" for event in events]
    shown, order = tuple(dict.fromkeys(inputs)), in_order_of_time(events)
    named = named_effects(names, priors, wheels, shown, kinds, where, order)
    model = posterior.build_model(
        events, priors, pulse_shape=pulse_shape, delta_v=delta_v, effects=(*given, *named)
    )
    model.require_walked()
    return model
