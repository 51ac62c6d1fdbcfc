"""What can be told of an effect in a flight that was recorded elsewhere, its truth known.

The same σ and the same groups as of trials over conditions, where nothing is simulated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import FARTHEST, compact, none_hypothesis
from cassini_bayes.diagnosis.modes import highest_mode
from cassini_bayes.files.checks import check_known
from cassini_bayes.studies.blind.likelihood_oracle import likelihood_classifier
from cassini_bayes.studies.blind.oracle import sizes_of
from cassini_bayes.studies.blind.sizes import path_to, size_on

LATE: Final = "time_offset"
"""Its size needs the flight without noise (:mod:`cassini_bayes.studies.blind.shift`)."""
NEAR: Final = 0.9
"""Of the farthest that a baseline goes: nearer to that it is no mode to be linear about."""
LEAK: Final = "thruster_leak"
STEADY: Final = "external_torque"


@dataclass(frozen=True)
class Told:
    """Size of a hidden effect in σ, and its group.

    ``sigma``: None of late records, of what has to be searched for, and of leaks where nothing
    fires.
    ``group``: the effect, and up to three causes that are as likely on the data that it has on
    average. Itself alone of an oscillation, and where the baseline without it goes as far as it
    may: nothing is told from there.
    """

    sigma: float | None
    group: tuple[str, ...]


def what_can_be_told(
    events: Events, name: str, values: Mapping[str, float], truth: Mapping[str, float]
) -> Told:
    """Size and group of a hidden effect.

    Parameters
    ----------
    events
        The recorded events that have it.
    name, values
        The effect and its parameters by key, as they were flown.
    truth
        Parameters of the baseline as they were flown, by name, in its units.

    Raises
    ------
    InputError
        No cause of these events is called that.
    """
    kind = name.partition(":")[0]
    check_known(name, name, events.catalogue.names)
    if kind == LEAK and not any(event.fires for event in events.telemetry):
        # what knows no thrusters sees the torque of a leak, which is steady in body axes
        return Told(None, (name, STEADY))
    effect = events.catalogue.effect(name)
    if effect.needs_search:
        return Told(None, (name,))
    none = compact(none_hypothesis(events))
    base = highest_mode(none.log_density, none.model.starts)
    group: tuple[str, ...] = (name,)
    if np.abs(base.point).max() < NEAR * FARTHEST:
        size = sizes_of(effect, values, truth)
        group = likelihood_classifier(events, base, values).group(name, size)
    if kind == LATE:
        return Told(None, group)
    return Told(size_on(events, path_to(effect, values, truth), 1.0), group)
