"""What the model calls an oscillation that a trial hides: its line, its starts, its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cassini_bayes.diagnosis.events import Events
from cassini_bayes.effects.line_directions import BODY_AXES
from cassini_bayes.effects.oscillation import BalancedRates, Oscillation
from cassini_bayes.studies.blind.flights import PHASE_STEP, Hidden, Scene


def hidden_line(scene: Scene, events: Events, hidden: Hidden) -> Oscillation:
    """The line of a hidden oscillation in the events of a flight that has it, their starts known.

    Over conditions it has the true motion of its flight, which no noise of rates drives.
    """
    seen = true = [event.samples.rate_rad_s for event in events.telemetry]
    if scene.condition is not None:
        quiet = scene.fly_quietly((hidden,)).telemetry
        true = [own.samples.rate_rad_s for own in quiet]
    balanced = [
        BalancedRates.instead(rates, own if own.shape == rates.shape else rates, 1.0)
        for rates, own in zip(seen, true, strict=True)
    ]
    line = replace(hidden_oscillation(hidden.parameters)[0], balanced=tuple(balanced))
    if PHASE_STEP not in hidden.parameters:
        return line
    phases = hidden.phases_rad(scene.event_ids)
    turns = [np.exp(-1j * phases[event.id]) for event in events.telemetry]
    return replace(line, turns=tuple((float(z.real), float(z.imag)) for z in turns))


def hidden_oscillation(values: Mapping[str, float]) -> tuple[Oscillation, dict[str, float]]:
    """What the model calls an oscillation that the simulation hides: its line, its parameters.

    The simulation is told the frequency of the free spacecraft and how fast the body swings.
    """
    clamped = float(np.sqrt(1.0 - values["inertia_fraction"]))
    line = Oscillation(
        values["frequency_hz"] * clamped,
        values["damping"] * clamped,
        BODY_AXES[int(values["axis"])],
    )
    result = {
        "cosine_rad_s": -values["amplitude_rad_s"],
        "sine_rad_s": 0.0,
        "inertia_fraction": values["inertia_fraction"],
        "frequency_shift": 0.0,
        "damping_shift": 0.0,
    }
    return line, result
