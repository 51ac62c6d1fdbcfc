"""One streaming pass over an event's telemetry to its Gram matrices.

For white channel noise the telemetry enters the likelihood only through inner products of its
columns. They add over chunks, files and machines; after the pass the cost of a likelihood call does
not depend on the number of samples (``docs/telemetry-likelihood.md`` §5).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics.columns import (
    PULSE_COLUMNS,
    Carry,
    Layout,
    Rows,
    Sampling,
    settle,
)
from cassini_bayes.balance.statistics.rows import Samples
from cassini_bayes.errors import InputError
from cassini_bayes.files.arrays import read_arrays, write_arrays

Array = NDArray[np.float64]
MODES: Final = 512
_FORMAT: Final = 1
BLOCK_ROWS: Final = 4_096


@dataclass(frozen=True, eq=False)
class EventStatistics:
    """Sufficient statistics of one telemetry event; equal to nothing but itself.

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


@dataclass(frozen=True)
class _Inner:
    """Inner products over rows of vector columns (their axis first), scalar columns and cosines."""

    columns: Array  # (3 V + S, 3 V + S)
    mixed: Array  # (M, 3 V + S)
    modes: Array  # (M, M)

    def gather(self, other: _Inner) -> None:
        """Add those of other rows in place."""
        for own, more in zip(
            (self.columns, self.mixed, self.modes),
            (other.columns, other.mixed, other.modes),
            strict=True,
        ):
            own += more


def _inner_products(rows: Rows, layout: Layout, duration_s: float) -> _Inner:
    """Inner products over some rows, by symmetric products: scalars and twins only once."""
    n, scalars = len(rows.time_s), rows.scalar.shape[1]
    source = _twins(rows.vector, layout)
    own = np.flatnonzero(source == np.arange(len(source)))
    vector = rows.vector if len(own) == len(source) else rows.vector[:, :, own]
    vector = vector.reshape(n, -1)
    waves, to_modes = local_waves(rows.time_s / duration_s)
    rest = np.concatenate([rows.scalar, waves], axis=1)
    mixed, inner = vector.T @ rest, rest.T @ rest
    on_waves = np.concatenate([mixed[:, scalars:], inner[:scalars, scalars:]]).T
    mixed, scalar = mixed[:, :scalars], inner[:scalars, :scalars]
    every = np.r_[
        (np.arange(3)[:, None] * len(own) + np.searchsorted(own, source)).reshape(-1),
        3 * len(own) + np.arange(scalars),
    ]
    columns = np.block([[vector.T @ vector, mixed], [mixed.T, scalar]])
    modes = inner[scalars:, scalars:]
    if to_modes is not None:
        on_waves, modes = to_modes @ on_waves, to_modes @ modes @ to_modes.T
    return _Inner(columns[every[:, None], every], on_waves[:, every], modes)


def _sorted_out(inner: _Inner, rows: int, statistics: EventStatistics) -> EventStatistics:
    """Statistics with one Gram matrix per pair of axes."""
    vectors, scalars = len(statistics.layout.vector), len(statistics.layout.scalar)
    scalar = range(3 * vectors, 3 * vectors + scalars)
    places = [np.r_[c * vectors : (c + 1) * vectors, scalar] for c in range(3)]
    gram = np.empty_like(statistics.gram)
    for c in range(3):
        for d in range(3):
            gram[c, d] = inner.columns[places[c][:, None], places[d]]
    return replace(
        statistics,
        rows=rows,
        gram=gram,
        projection=np.stack([inner.mixed[:, place] for place in places], axis=1),
        mode_gram=inner.modes,
        close_pairs=np.zeros_like(statistics.close_pairs),
    )


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


def local_waves(turn: Array) -> tuple[Array, Array | None]:
    """Functions (n, D) of places x = t/T (n,) that the cosines cos(m π x) are made of, and how.

    Returns also the (M, D) matrix that makes the cosines of them, None if they are the cosines.
    Where many rows span a small part of the event, all cosines are sums of few Chebyshev
    polynomials, to rounding: with phases of up to ±φ about the middle, polynomial d has a weight of
    the size of the Bessel function J_d(φ).
    """
    middle, half = 0.5 * (turn.min() + turn.max()), 0.5 * (turn.max() - turn.min())
    phase = np.pi * MODES * half
    count = int(phase + 9.0 * np.cbrt(phase) + 16.0)
    order = np.arange(1, MODES + 1)
    if count >= min(MODES, len(turn)):
        return np.cos(np.pi * turn[:, None] * order), None
    node = np.pi * (np.arange(count) + 0.5) / count
    at_nodes = np.cos(np.pi * order[:, None] * (middle + half * np.cos(node)))
    weights = 2.0 / count * at_nodes @ np.cos(node[:, None] * np.arange(count))
    weights[:, 0] *= 0.5
    x = (turn - middle) / max(half, np.finfo(float).tiny)
    waves = np.empty((count, len(turn)))
    waves[0], waves[1] = 1.0, x
    for d in range(2, count):
        waves[d] = 2.0 * x * waves[d - 1] - waves[d - 2]
    return waves.T, weights


def reduce_chunks(
    event_id: str,
    kind: str,
    chunks: Iterable[Samples],
    layout: Layout,
    sampling: Sampling,
    block_rows: int = BLOCK_ROWS,
) -> EventStatistics:
    """Reduce telemetry that comes in chunks, in constant memory.

    Parameters
    ----------
    chunks
        Rows in order of time, as :class:`Samples`.
    block_rows
        Most rows whose columns are made at once: what extra columns see of an event.

    Raises
    ------
    InputError
        Fewer than ten rows can be used.
    """
    total = empty_statistics(event_id, kind, layout, sampling.duration_s)
    carry, used, interval = Carry.start(layout), 0, 0.0
    size = 3 * len(layout.vector) + len(layout.scalar)
    inner = _Inner(np.zeros((size, size)), np.zeros((MODES, size)), np.zeros((MODES, MODES)))
    for chunk, final in _with_end(_in_blocks(chunks, block_rows)):
        rows, carry = settle(chunk, carry, layout, sampling, final)
        if len(rows.time_s) > 0:
            inner.gather(_inner_products(rows, layout, sampling.duration_s))
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


def _in_blocks(chunks: Iterable[Samples], rows: int) -> Iterator[Samples]:
    """The same rows in blocks whose columns stay in the processor's cache."""
    for chunk in chunks:
        if len(chunk) <= rows:
            yield chunk
        else:
            for start in range(0, len(chunk), rows):
                yield chunk.part(start, start + rows)


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
        "close_pairs": statistics.close_pairs,
        "counter_interval_s": np.array(statistics.counter_interval_s),
    }
    write_arrays(path, arrays)


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
        stored: dict[str, Any] = read_arrays(path, "the statistics of an event")
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
    except (InputError, ValueError, TypeError, KeyError):
        return None
