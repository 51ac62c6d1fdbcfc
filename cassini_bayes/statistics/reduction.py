"""One streaming pass over an event's telemetry to its Gram matrices.

For white channel noise the telemetry enters the likelihood only through inner products of its
columns. They add over chunks, files and machines; after the pass the cost of a likelihood call does
not depend on the number of samples (``docs/telemetry-likelihood.md`` §5).
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.errors import InputError
from cassini_bayes.statistics.columns import Carry, Layout, Rows, Sampling, settle
from cassini_bayes.statistics.rows import Samples
from cassini_bayes.storage import write_bytes

Array = NDArray[np.float64]
MODES: Final = 128
_FORMAT: Final = 1
_BLOCK_ROWS: Final = 4_096


@dataclass(frozen=True)
class EventStatistics:
    """Sufficient statistics of one telemetry event.

    ``gram[c, d]`` (3, 3, A, A) holds Σ_t a_c(t) b_d(t) for all pairs of columns and axes;
    ``projection`` (M, 3, A) = Σ_t φ_m(t) a_c(t) and ``mode_gram`` (M, M) = Σ_t φ_m φ_l belong to
    the cosines φ_m(t) = cos(m π t / T), m = 1 … M, of the torque noise.
    """

    event_id: str
    kind: str
    layout: Layout
    duration_s: float
    rows: int
    gram: Array
    projection: Array
    mode_gram: Array
    close_pairs: Array  # (S,) counts per couple and part of the event
    counter_interval_s: float  # usual time between two readings of the counters, 0 without

    def __add__(self, other: EventStatistics) -> EventStatistics:
        """Statistics of two stretches of one event together."""
        if (self.layout, self.duration_s) != (other.layout, other.duration_s):
            raise ValueError("statistics of different layouts or events do not add")
        return replace(
            self,
            rows=self.rows + other.rows,
            gram=self.gram + other.gram,
            projection=self.projection + other.projection,
            mode_gram=self.mode_gram + other.mode_gram,
            close_pairs=self.close_pairs + other.close_pairs,
        )


def empty_statistics(
    event_id: str, kind: str, layout: Layout, duration_s: float
) -> EventStatistics:
    """Statistics of no rows."""
    a = layout.size
    return EventStatistics(
        event_id,
        kind,
        layout,
        duration_s,
        0,
        np.zeros((3, 3, a, a)),
        np.zeros((MODES, 3, a)),
        np.zeros((MODES, MODES)),
        np.zeros(layout.cut.stop - layout.cut.start),
        0.0,
    )


def gram_of(rows: Rows, statistics: EventStatistics) -> EventStatistics:
    """Statistics of some rows alone, on the time scale of ``statistics``."""
    n, vectors, scalars = len(rows.time_s), rows.vector.shape[2], rows.scalar.shape[1]
    phase = np.pi * rows.time_s[:, None] / statistics.duration_s
    modes = np.cos(phase * np.arange(1, MODES + 1))
    # one symmetric product: half the work of a product per pair of axes, scalars only once
    everything = np.concatenate([rows.vector.reshape(n, 3 * vectors), rows.scalar, modes], axis=1)
    inner = everything.T @ everything
    start = 3 * vectors
    places = [np.r_[c * vectors : (c + 1) * vectors, start : start + scalars] for c in range(3)]
    gram = np.empty_like(statistics.gram)
    for c in range(3):
        for d in range(3):
            gram[c, d] = inner[places[c][:, None], places[d]]
    mode = slice(start + scalars, None)
    projection = np.stack([inner[mode, place] for place in places], axis=1)
    return replace(
        statistics,
        rows=len(rows.time_s),
        gram=gram,
        projection=projection,
        mode_gram=inner[mode, mode],
        close_pairs=np.zeros_like(statistics.close_pairs),
    )


def reduce_chunks(
    event_id: str,
    kind: str,
    chunks: Iterable[Samples],
    layout: Layout,
    sampling: Sampling,
) -> EventStatistics:
    """Reduce telemetry that comes in chunks, in constant memory.

    Parameters
    ----------
    chunks
        Rows in order of time, as :class:`Samples`.

    Raises
    ------
    InputError
        Fewer than ten rows can be used.
    """
    total = empty_statistics(event_id, kind, layout, sampling.duration_s)
    carry = Carry.start(layout)
    interval = 0.0
    previous: Samples | None = None
    for chunk in _in_blocks(chunks):
        if previous is not None:
            rows, carry = settle(previous, carry, layout, sampling, final=False)
            total = total + gram_of(rows, total)
            interval = interval or counter_interval(previous)
        previous = chunk
    if previous is not None:
        rows, carry = settle(previous, carry, layout, sampling, final=True)
        total = total + gram_of(rows, total)
        interval = interval or counter_interval(previous)
    if total.rows < LEAST_ROWS:
        raise InputError(
            f"event {event_id}: telemetry",
            f"at least {LEAST_ROWS} rows with attitude, body rates and wheel rates at one time, "
            f"none within {sampling.guard_s:.2f} s of a firing",
            str(total.rows),
            "give more telemetry, or the counters at a faster rate",
        )
    return replace(total, close_pairs=carry.cuts, counter_interval_s=interval)


def _in_blocks(chunks: Iterable[Samples]) -> Iterator[Samples]:
    """The same rows in blocks whose columns stay in the processor's cache."""
    for chunk in chunks:
        if len(chunk) <= _BLOCK_ROWS:
            yield chunk
        else:
            for start in range(0, len(chunk), _BLOCK_ROWS):
                yield chunk.part(start, start + _BLOCK_ROWS)


def counter_interval(samples: Samples) -> float:
    """Median time between two readings of the counters, 0 where there are none."""
    time = samples.time_s[samples.has_counters]
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


LEAST_ROWS: Final = 10


def save_statistics(path: Path, statistics: EventStatistics) -> None:
    """Write statistics as a plain array archive, atomically."""
    buffer = io.BytesIO()
    np.savez(
        buffer,
        format=np.array(_FORMAT),
        event_id=np.array(statistics.event_id),
        kind=np.array(statistics.kind),
        wheels=np.array(statistics.layout.wheels),
        thrusters=np.array(statistics.layout.thrusters, dtype=np.str_),
        duration_s=np.array(statistics.duration_s),
        rows=np.array(statistics.rows),
        gram=statistics.gram,
        projection=statistics.projection,
        mode_gram=statistics.mode_gram,
        couples=np.array(
            [couple_of(i, statistics.layout) for i in range(len(statistics.layout.thrusters))]
        ),
        close_pairs=statistics.close_pairs,
        counter_interval_s=np.array(statistics.counter_interval_s),
    )
    write_bytes(path, buffer.getvalue())


def couple_of(place: int, layout: Layout) -> int:
    """Number of the couple that a thruster belongs to."""
    return next(g for g, couple in enumerate(layout.couples) if place in couple)


def couples_from(numbers: NDArray[np.int64]) -> tuple[tuple[int, ...], ...]:
    """Couples from the number of each thruster's couple: the inverse of :func:`couple_of`."""
    return tuple(
        tuple(int(place) for place in np.flatnonzero(numbers == g))
        for g in range(int(numbers.max(initial=-1)) + 1)
    )


def load_statistics(path: Path) -> EventStatistics | None:
    """Statistics written by :func:`save_statistics`; None if the file is missing or damaged.

    A cache: what cannot be read is computed again.
    """
    try:
        # opened here: numpy leaves the file open when it is no archive
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            if int(stored["format"]) != _FORMAT:
                return None
            layout = Layout(
                tuple(int(number) for number in stored["wheels"]),
                tuple(str(name) for name in stored["thrusters"]),
                couples_from(stored["couples"]),
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
                stored["close_pairs"],
                float(stored["counter_interval_s"]),
            )
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None
