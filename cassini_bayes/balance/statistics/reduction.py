"""One streaming pass over an event's telemetry to its Gram matrices.

For white channel noise the telemetry enters the likelihood only through inner products of its
columns. They add over chunks, files and machines; after the pass the cost of a likelihood call does
not depend on the number of samples (``docs/topics/telemetry-likelihood.md`` §6).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.statistics.columns import Carry, settle
from cassini_bayes.balance.statistics.counter_reduction import counter_statistics, long_levels_of
from cassini_bayes.balance.statistics.event_statistics import EventStatistics, ShownWheels
from cassini_bayes.balance.statistics.first_look import Preparation
from cassini_bayes.balance.statistics.inner_products import (
    MODES,
    Inner,
    by_axes,
    inner_products,
    mixed_by_axes,
)
from cassini_bayes.balance.statistics.layout import Layout
from cassini_bayes.balance.statistics.rounded_counters import Rounding
from cassini_bayes.balance.statistics.rows import Samples
from cassini_bayes.balance.statistics.sampling import Sampling
from cassini_bayes.balance.statistics.thinned import Thinned
from cassini_bayes.balance.statistics.turn_reduction import GatheredTurns
from cassini_bayes.computing.arrays import joined
from cassini_bayes.errors import InputError

BLOCK_ROWS: Final = 4_096  # some 10 MB of columns at a time


def reduce_chunks(
    event_id: str,
    kind: str,
    chunks: Iterable[Samples],
    layout: Layout,
    sampling: Sampling,
    block_rows: int = BLOCK_ROWS,
    prepared: Preparation | None = None,
) -> EventStatistics:
    """Reduce telemetry that comes in chunks, in memory for one and for what was fired.

    Parameters
    ----------
    chunks
        Rows in order of time, as :class:`Samples`.
    block_rows
        Most rows whose columns are made at once: what extra columns see of an event.
    prepared
        What a first look found; without it no channel is rounded.

    Raises
    ------
    InputError
        Fewer than five rows can be used, or a counter's steps are longer than the pulses.
    """
    prepared = prepared or Preparation()
    _require_readable(event_id, layout, prepared.rounding)
    sampling = replace(
        sampling,
        widths_s=prepared.widths_s,
        unsure_s=prepared.unsure_s,
        gaps_s=prepared.gaps_s or (sampling.control_cycle_s,),
        paired_s=prepared.paired_s or sampling.paired_s,
        block_s=prepared.late.block_s,
        block_rows=prepared.late.block_rows,
    )
    sampling = replace(sampling, levels=long_levels_of(prepared, layout, sampling))
    layout = replace(layout, levels=sampling.levels.couples)
    carry, used, at_readings, interval = Carry.start(layout), 0, 0, 0.0
    size = 3 * len(layout.vector) + len(layout.scalar)
    inner = Inner(np.zeros((size, size)), np.zeros((MODES, size)), np.zeros((MODES, MODES)))
    turns, times, wheels = GatheredTurns(layout, sampling), Thinned(), Thinned()
    wheel = slice(layout.wheel.start - len(layout.vector), layout.wheel.stop - len(layout.vector))
    extra_end = np.zeros(len(layout.extra))
    extra = slice(layout.extra_place.start - len(layout.vector), None)
    moving = (chunk for chunk in chunks if chunk.has_motion)
    for chunk, final in _with_end(_in_blocks(moving, block_rows)):
        rows, carry = settle(chunk, carry, layout, sampling, final)
        if len(rows.time_s) > 0:
            inner.gather(inner_products(rows, layout, sampling.duration_s))
            turns.add(rows)
            times.add(rows.time_s)
            wheels.add(rows.scalar[:, wheel])
            extra_end = rows.scalar[-1, extra]
            used += len(rows.time_s)
        at_readings += int((chunk.has_state & chunk.has_counters).sum())
        interval = interval or counter_interval(chunk)
    if used < LEAST_ROWS:
        blocks = ""
        if sampling.block_s > 0.0:
            blocks = f" means over {sampling.block_s:g} s, of {at_readings} rows at readings"
        raise InputError(
            f"event {event_id}: telemetry",
            f"at least {LEAST_ROWS} rows with attitude, body rates and wheel rates at one time, "
            f"none within {sampling.guard_s:.2f} s of a firing, "
            "or as many means over rows at readings of the counters",
            f"{used}{blocks}",
            "give more telemetry, or both counters at a faster rate, in the same rows",
        )
    averaged = at_readings / used if sampling.block_s > 0.0 else 1.0
    return EventStatistics(
        event_id=event_id,
        kind=kind,
        layout=layout,
        duration_s=sampling.duration_s,
        rows=used,
        gram=by_axes(inner.columns, layout),
        projection=mixed_by_axes(inner.mixed, layout),
        mode_gram=inner.modes,
        cuts=carry.cuts,
        counter_interval_s=interval,
        turns=turns.statistics(),
        counters=counter_statistics(
            joined(carry.pairs), times, sampling, prepared, layout, averaged
        ),
        steps=prepared.steps,
        noise=prepared.noise,
        shown=ShownWheels(wheels.values),
        extra_end=extra_end,
    )


def _require_readable(event_id: str, layout: Layout, rounding: Sequence[Rounding]) -> None:
    """Refuse counters whose steps hide the pulses: what was fired cannot be read from them.

    The widths' scatter, which would then be noise, is not known well enough from such readings:
    overstated noise makes the inertia several standard deviations too large.
    """
    for name, own in zip(layout.thrusters, rounding, strict=False):
        if own.step_s > own.width_s:
            raise InputError(
                f"event {event_id}: on_time_{name}_s",
                f"a counter in finer steps than its pulses, {own.width_s:.3f} s on average",
                f"steps of {own.step_s:g} s",
                "give the counter in finer steps, or the sums of the bias as a totals row; if "
                "pulses are whole numbers of control cycles, say so by control_cycle_s in the "
                "spacecraft file",
            )


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


LEAST_ROWS: Final = 5  # judgement: initial momentum and torque take two of them
