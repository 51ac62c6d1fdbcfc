"""Single cells that do not fit: found by their neighbours, confirmed by the balance of momentum.

A cell is compared with the mean of the middle two of its four neighbours, which one more bad cell
among them does not move, in units of the robust spread of all such differences. A real jerk of a
wheel or of the body is answered by another carrier of momentum; a bad cell is not: it shows in the
total, by its own column's weight. A bad cell is set to what its neighbours predict, and the search
goes on, so that large bad cells do not mask small ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.plausibility.departures import Nominal
from cassini_bayes.events.telemetry import Chunk
from cassini_bayes.spacecraft.attitude import direction_cosines
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

LEAST_ROWS: Final = 20  # the robust spread of fewer is off by a quarter (1.17/√n): none is asked
CELL_SIGMAS: Final = 10.0
"""Robust spreads that a cell lies off (docs/topics/plausibility.md, single cells): by trial. A
smaller error is left in the data."""
CONFIRMED: Final = 0.3
"""Of the square of the total's jump: what the cell leaves of it, if it is the cause (the same
page): by trial."""
TAIL_S: Final = 0.15
"""Of thrust that may be counted and not yet delivered when a row is taken: no bad cell."""
MOST_PASSES: Final = 20  # each finds what larger cells hid; the search ends sooner without any


@dataclass(frozen=True)
class BadCell:
    """One cell: its row by time, its column, its value, what neighbours say, how far off in σ."""

    time_s: float
    column: str
    value: float
    expected: float
    sigmas: float

    def __str__(self) -> str:
        return (
            f"time_s = {self.time_s:.10g}, column {self.column} = {self.value:.6g} (its neighbours"
            f" say {self.expected:.6g}: {self.sigmas:+.3g} σ)"
        )


@dataclass(frozen=True, eq=False)
class CellSearch:
    """What the search knows of an event."""

    nominal: Nominal

    def find(self, chunk: Chunk) -> list[BadCell]:
        """Bad cells of a chunk's wheel and body rates."""
        fires = chunk.on_time_s.shape[1] > 0
        needed = (chunk.attitude, chunk.rate_rad_s, chunk.wheel_rpm)
        if not chunk.rate_rad_s.shape[1] or not chunk.wheel_rpm.shape[1]:
            return []
        whole = ~np.isnan(np.concatenate(needed, axis=1)).any(axis=1)
        rows = np.flatnonzero(whole)
        if len(rows) < LEAST_ROWS:
            return []
        cells = np.concatenate([chunk.rate_rad_s[rows], chunk.wheel_rpm[rows]], axis=1)
        spins = self.nominal.spins * RAD_S_PER_RPM
        weights = np.concatenate([self.nominal.inertia, spins], axis=1)  # (3, 3 + W)
        turn = direction_cosines(chunk.attitude[rows]).transpose(0, 2, 1)
        slack = np.zeros(len(rows))
        impulse = np.zeros((len(rows), 3))
        if fires:
            on_time, steps, is_long = _between(chunk, rows)
            middle = 0.5 * (turn[1:] + turn[:-1])
            gained = np.einsum("nij,jk,nk->ni", middle, self.nominal.torques, on_time)
            impulse[1:] = np.cumsum(gained, axis=0)
            fired, torques = steps + TAIL_S * (steps > 0.0), self.nominal.torques
            counted = fired @ torques.T
            # of firings to and fro between two readings a row may have the one and not the other
            ways = np.maximum(np.stack([torques, -torques]), 0.0)
            either = (fired @ ways.swapaxes(1, 2)).max(axis=0)
            counted = np.where(is_long[:, None], either, counted)
            # also between neighbours it may lack the tail of the last of them
            tails = (TAIL_S * (steps > 0.0) @ ways.swapaxes(1, 2)).max(axis=0)
            sizes = np.linalg.norm(counted, axis=1), np.linalg.norm(tails, axis=1)
            size = np.append(0.0, np.maximum(*sizes))
            slack = np.max([np.roll(size, shift) for shift in (-2, -1, 0, 1)], axis=0)
        total = np.einsum("nij,jc,nc->ni", turn, weights, cells) - impulse
        return self._search(chunk.time_s[rows], cells, total, turn, weights, slack)

    def _search(
        self, time_s: Array, cells: Array, total: Array, turn: Array, weights: Array, slack: Array
    ) -> list[BadCell]:
        cells, found = cells.copy(), {}
        recorded = cells.copy()
        names = [f"rate_{axis}_rad_s" for axis in "xyz"]
        names += [f"{name}_rpm" for name in self.nominal.wheel_names]
        of_rates = np.arange(cells.shape[1]) < 3
        for _ in range(MOST_PASSES):
            jumps, spread = _jumps(cells)
            totals, total_spread = _jumps(total)
            size = np.linalg.norm(totals, axis=1)
            level = CELL_SIGMAS * float(np.linalg.norm(total_spread)) + slack[:, None] * of_rates
            columns = np.einsum("nij,jc->nic", turn, weights)
            explained = columns * jumps[:, None, :]
            left = np.sum((totals[:, :, None] - explained) ** 2, axis=1)
            # firings make rates jump, never wheels: they need not stand out against a firing
            bad = (np.abs(jumps) > CELL_SIGMAS * spread) & (size[:, None] > level)
            bad &= left < CONFIRMED * (size**2)[:, None]
            # of neighbouring rows only the worst: it makes the others look bad
            worst = np.maximum.reduce([np.roll(size, shift) for shift in (-2, -1, 0, 1, 2)])
            bad &= (size >= worst)[:, None]
            bad &= left == left.min(axis=1, keepdims=True)
            new = np.argwhere(bad)
            if not len(new):
                break
            for i, c in new.tolist():
                expected = float(cells[i, c] - jumps[i, c])
                sigmas = float((recorded[i, c] - expected) / spread[c])
                found[i, c] = BadCell(
                    float(time_s[i]), names[c], float(recorded[i, c]), expected, sigmas
                )
                total[i] -= columns[i, :, c] * (cells[i, c] - expected)
                cells[i, c] = expected
        return [found[key] for key in sorted(found)]


def _between(chunk: Chunk, rows: NDArray[np.int64]) -> tuple[Array, Array, NDArray[np.bool_]]:
    """On-time gained from row to row (n − 1, K), and in the whole bracket that a step lies in.

    Counters sampled more seldom than the rest are taken to grow evenly between two samples; which
    steps (n − 1,) are shorter than their bracket is told, too.
    """
    sampled = np.flatnonzero(~np.isnan(chunk.on_time_s).any(axis=1))
    time, known = chunk.time_s[rows], chunk.time_s[sampled]
    if len(sampled) < 2:
        nothing = np.zeros((len(rows) - 1, chunk.on_time_s.shape[1]))
        return nothing, nothing, np.zeros(len(rows) - 1, dtype=np.bool_)
    counts = chunk.on_time_s[sampled]
    even = np.stack([np.interp(time, known, column) for column in counts.T], axis=1)
    bracket = np.clip(np.searchsorted(known, time[1:]) - 1, 0, len(known) - 2)
    is_long = np.diff(known)[bracket] > 1.5 * np.diff(time)
    return np.diff(even, axis=0), np.diff(counts, axis=0)[bracket], is_long


def _jumps(values: Array) -> tuple[Array, Array]:
    """Each row less the mean of the middle two of its four neighbours, and its robust spread."""
    around = np.stack([values[:-4], values[1:-3], values[3:-1], values[4:]])
    jumps = np.zeros_like(values)
    jumps[2:-2] = values[2:-2] - np.sort(around, axis=0)[1:3].mean(axis=0)
    inner = jumps[2:-2]
    spread = 1.4826 * np.median(np.abs(inner - np.median(inner, axis=0)), axis=0)
    steps = np.abs(np.diff(values, axis=0))
    smallest = np.min(np.where(steps > 0.0, steps, np.inf), axis=0)
    return jumps, np.maximum(spread, np.where(np.isfinite(smallest), 0.3 * smallest, 1e-300))


def without_cells(chunk: Chunk, cells: Sequence[BadCell]) -> Chunk:
    """The chunk with channels that hold a bad cell taken as not sampled in its row."""
    if not cells:
        return chunk
    rate, wheel = chunk.rate_rad_s.copy(), chunk.wheel_rpm.copy()
    for cell in cells:
        row = int(np.searchsorted(chunk.time_s, cell.time_s))
        (rate if cell.column.startswith("rate") else wheel)[row] = np.nan
    return replace(chunk, rate_rad_s=rate, wheel_rpm=wheel)
