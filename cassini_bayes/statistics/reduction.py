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
from cassini_bayes.statistics.columns import (
    PULSE_COLUMNS,
    Carry,
    Layout,
    Rows,
    Sampling,
    settle,
)
from cassini_bayes.statistics.rows import Samples
from cassini_bayes.storage import write_bytes

Array = NDArray[np.float64]
MODES: Final = 512
_FORMAT: Final = 1
_BLOCK_ROWS: Final = 4096


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


def inner_products(rows: Rows, layout: Layout, duration_s: float) -> Array:
    """Inner products over some rows of all there is: vector columns, scalar columns, cosines.

    Returns (3 V + S + M, 3 V + S + M), the vector columns with their axis first. One symmetric
    product per kind: half the work of one per pair of axes, scalars and twins only once.
    """
    n, scalars = len(rows.time_s), rows.scalar.shape[1]
    source = _twins(rows.vector, layout)
    own = np.flatnonzero(source == np.arange(len(source)))
    vector = rows.vector if len(own) == len(source) else rows.vector[:, :, own]
    vector = vector.reshape(n, -1)
    rest = np.empty((n, scalars + MODES))
    rest[:, :scalars] = rows.scalar
    cosines(rows.time_s / duration_s, out=rest[:, scalars:])
    mixed = vector.T @ rest
    inner = np.block([[vector.T @ vector, mixed], [mixed.T, rest.T @ rest]])
    place = np.searchsorted(own, source)
    every = np.r_[
        (np.arange(3)[:, None] * len(own) + place).reshape(-1),
        3 * len(own) + np.arange(rest.shape[1]),
    ]
    return np.asarray(inner[every[:, None], every])


def _twins(vector: Array, layout: Layout) -> NDArray[np.intp]:
    """For every vector column (V,) the first that is the same: thrusters of a couple often are."""
    source = np.arange(len(layout.vector))
    fired = source[layout.fired].reshape(-1, 3 * len(PULSE_COLUMNS))
    for couple in layout.couples:
        first = fired[couple[0]]
        for other in (fired[k] for k in couple[1:]):
            if np.array_equal(vector[..., first], vector[..., other]):
                source[other] = first
    return source


def _sorted_out(inner: Array, rows: int, statistics: EventStatistics) -> EventStatistics:
    """Statistics from :func:`inner_products`, one Gram matrix per pair of axes."""
    layout = statistics.layout
    vectors, start = len(layout.vector), 3 * len(layout.vector)
    mode = slice(start + len(layout.scalar), None)
    scalar = range(start, mode.start)
    places = [np.r_[c * vectors : (c + 1) * vectors, scalar] for c in range(3)]
    gram = np.empty_like(statistics.gram)
    for c in range(3):
        for d in range(3):
            gram[c, d] = inner[places[c][:, None], places[d]]
    return replace(
        statistics,
        rows=rows,
        gram=gram,
        projection=np.stack([inner[mode, place] for place in places], axis=1),
        mode_gram=inner[mode, mode],
        close_pairs=np.zeros_like(statistics.close_pairs),
    )


def cosines(turn: Array, out: Array) -> None:
    """cos(m π x) at places x (n,) for m = 1 … M into ``out`` (n, M).

    Powers of e^(iπx), their number doubled again and again: the rounding of seven products, and a
    fraction of the time of as many cosines.
    """
    powers = np.empty((MODES, len(turn)), dtype=np.complex128)
    powers[0] = np.exp(1j * np.pi * turn)
    done = 1
    while done < MODES:
        more = min(done, MODES - done)
        np.multiply(powers[:more], powers[done - 1], out=powers[done : done + more])
        done += more
    out[:] = powers.real.T


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
    carry, used, interval = Carry.start(layout), 0, 0.0
    inner = np.zeros((2 * len(layout.vector) + layout.size + MODES,) * 2)
    for chunk, final in _with_end(_in_blocks(chunks)):
        rows, carry = settle(chunk, carry, layout, sampling, final)
        if len(rows.time_s) > 0:
            inner += inner_products(rows, layout, sampling.duration_s)
            used += len(rows.time_s)
        interval = interval or counter_interval(chunk)
    total = _sorted_out(inner, used, total)
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


def _with_end(blocks: Iterator[Samples]) -> Iterator[tuple[Samples, bool]]:
    """Every block, and whether it is the last."""
    previous: Samples | None = None
    for block in blocks:
        if previous is not None:
            yield previous, False
        previous = block
    if previous is not None:
        yield previous, True


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
