"""Totals of a wheel bias from its telemetry: what a flight table would print of the recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry import TelemetryEvent, read_chunks
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.spacecraft import Spacecraft


def is_bias(event: TelemetryEvent) -> bool:
    """Whether a recording is of a wheel bias with thruster counters."""
    return event.kind == "bias" and bool(event.thrusters)


def recorded_totals(event: TelemetryEvent, spacecraft: Spacecraft) -> TotalsEvent:
    """The totals row of a recorded wheel bias.

    On-times and pulses are what the counters gained, wheel rates those of the first and the last
    row that has them, the duration is the whole recording, settling included. There is no printed
    velocity change, hydrazine, mass or thrust.

    Raises
    ------
    InputError
        Bad telemetry; no bias; fewer than two rows of counters or of wheel rates.
    """
    if not is_bias(event):
        raise InputError(
            str(event.folder), "a wheel bias with thruster counters", f"a {event.kind}", "leave out"
        )
    chunks = list(read_chunks(event, spacecraft))
    start_rpm, end_rpm = _ends(event, "wheel rates", [chunk.wheel_rpm for chunk in chunks])
    gained = []
    for name in ("on_time_s", "pulses"):
        first, last = _ends(event, name, [getattr(chunk, name) for chunk in chunks])
        gained.append(last - first)
    return TotalsEvent(
        id=event.id,
        epoch=event.epoch,
        branch=event.branch,
        wheels=event.wheels,
        rwa_start_rpm=start_rpm,
        rwa_end_rpm=end_rpm,
        duration_s=float(chunks[-1].time_s[-1] - chunks[0].time_s[0]),
        thrusters=event.thrusters,
        on_time_s=gained[0],
        pulses=gained[1],
        source="telemetry",
    )


def _ends(event: TelemetryEvent, what: str, parts: Sequence[Array]) -> tuple[Array, Array]:
    """The first and the last row (width,) that was sampled."""
    values = np.concatenate(parts)
    sampled = values[np.isfinite(values).all(axis=1)]
    if len(sampled) < 2:
        raise InputError(
            str(event.telemetry), f"at least two rows of {what}", str(len(sampled)), "add them"
        )
    return sampled[0], sampled[-1]
