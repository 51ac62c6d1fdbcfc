"""Places of a model's unknowns in one vector, by name.

All of them in standard coordinates: what is walked, the shared thrust levels, then event by event
its thrust departures and its own unknowns (initial momentum, torque and cut tails of telemetry; the
torque of a totals row).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cassini_bayes.computing.arrays import Places


@dataclass(frozen=True)
class EventSlices:
    """Where the unknowns stand that one event depends on, beside the walked ones."""

    levels: slice  # shared by all events; empty where nothing fires
    departures: slice  # of its thrusts, the same
    nuisances: slice


@dataclass(frozen=True)
class Unknowns:
    """Where a model's unknowns stand."""

    walked: slice
    levels: slice
    events: tuple[EventSlices, ...]

    @classmethod
    def of(
        cls, walked: int, levels: int, departures: int, events: Iterable[tuple[bool, int]]
    ) -> Unknowns:
        """Places of so many unknowns; of every event, whether it fires and how many it has."""
        at = walked + levels
        shared, places = slice(walked, at), []
        for fires, own in events:
            first = at + departures * fires
            level = shared if fires else slice(at, at)
            places.append(EventSlices(level, slice(at, first), slice(first, first + own)))
            at = first + own
        return cls(slice(0, walked), shared, tuple(places))

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.events[-1].nuisances.stop)

    def of_event(self, event: int) -> Places:
        """Places of all that one event depends on."""
        slices = self.events[event]
        parts = (self.walked, slices.levels, slices.departures, slices.nuisances)
        return np.concatenate([np.arange(part.start, part.stop) for part in parts])
