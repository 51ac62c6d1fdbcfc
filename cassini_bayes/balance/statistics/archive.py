"""Statistics of an event in a file, for the cache of reductions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from cassini_bayes.balance.statistics.channel_noise import ChannelNoise
from cassini_bayes.balance.statistics.event_statistics import (
    ChannelSteps,
    CounterStatistics,
    EventStatistics,
    ShownWheels,
    TurnStatistics,
)
from cassini_bayes.balance.statistics.layout import Layout, couple_of, couples_from
from cassini_bayes.balance.statistics.walk import walk_cosines
from cassini_bayes.errors import InputError
from cassini_bayes.files.arrays import read_arrays, write_arrays

_FORMAT: Final = 24  # raised with every change of what is stored
_PARTS: Final[Mapping[str, Any]] = {
    "turns": TurnStatistics,
    "counters": CounterStatistics,
    "steps": ChannelSteps,
    "noise": ChannelNoise,
    "shown": ShownWheels,
}


def save_statistics(path: Path, statistics: EventStatistics) -> None:
    """Write statistics as a plain array archive, atomically."""
    layout = statistics.layout
    arrays = {
        "format": np.array(_FORMAT),
        "event_id": np.array(statistics.event_id),
        "kind": np.array(statistics.kind),
        "wheels": np.array(layout.wheels),
        "thrusters": np.array(layout.thrusters, dtype=np.str_),
        "duration_s": np.array(statistics.duration_s),
        "rows": np.array(statistics.rows),
        "gram": statistics.gram,
        "projection": statistics.projection,
        "mode_gram": statistics.mode_gram,
        "couples": np.array([couple_of(i, layout) for i in range(len(layout.thrusters))]),
        "cuts": statistics.cuts,
        "counter_interval_s": np.array(statistics.counter_interval_s),
    }
    for name, kind in _PARTS.items():
        own = getattr(statistics, name)
        arrays |= {f"{name}.{f.name}": np.asarray(getattr(own, f.name)) for f in fields(kind)}
    write_arrays(path, arrays)


def load_statistics(path: Path) -> EventStatistics | None:
    """Statistics written by :func:`save_statistics`; None if the file is missing or damaged.

    A cache: what cannot be read is computed again.
    """
    try:
        stored: dict[str, Any] = read_arrays(path, "the statistics of an event")
        if int(stored["format"]) != _FORMAT:
            return None
        layout = Layout(
            tuple(int(number) for number in stored["wheels"]),
            tuple(str(name) for name in stored["thrusters"]),
            couples_from(stored["couples"]),
            walk_cosines(float(stored["duration_s"])),
            tuple(int(couple) for couple in stored["counters.level_couple"]),
        )
        return EventStatistics(
            str(stored["event_id"]),
            str(stored["kind"]),
            layout,
            float(stored["duration_s"]),
            int(stored["rows"]),
            stored["gram"],
            stored["projection"],
            stored["mode_gram"],
            stored["cuts"],
            float(stored["counter_interval_s"]),
            extra_end=np.zeros(0),
            **{name: _part(kind, name, stored) for name, kind in _PARTS.items()},
        )
    except (InputError, ValueError, TypeError, KeyError):
        return None


def _part(kind: type[Any], name: str, stored: Mapping[str, Any]) -> Any:
    """One part of the statistics, its numbers as plain ones."""
    values = (stored[f"{name}.{field.name}"] for field in fields(kind))
    return kind(*(value.item() if value.ndim == 0 else value for value in values))
