"""How fast telemetry is reduced, and how much memory that takes."""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cassini_bayes.balance.statistics import Samples, reduce_chunks
from cassini_bayes.computing.arrays import joined
from cassini_bayes.events.telemetry import read_chunks, read_event
from cassini_bayes.model.event_reduction import reduce_event
from speed.problem import PULSE_SHAPE, priors_of, reduced_events

Row = dict[str, Any]
CHUNK = 100_000
MIB = 1024.0
GAP_S = 100


def reduce_row(folder: Path, rows: int) -> Row:
    """Rows per second of the reduction alone, and the peak memory of a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_reduce, (folder, rows))


def _reduce(folder: Path, rows: int) -> Row:
    event = reduced_events([folder])[0]
    samples = joined(tuple(event.rows))
    per_chunk = CHUNK // len(samples)
    usable = Samples(*(_tiled(samples, per_chunk)))
    passes = max(round(rows / len(usable)), 1)
    chunks = _passes(usable, passes)
    duration = passes * (float(usable.time_s[-1]) + 1.0)
    sampling = replace(event.sampling, duration_s=duration)
    reduce_chunks("bias", "bias", [usable], event.statistics.layout, sampling)  # code and memory
    began = time.process_time(), time.perf_counter()
    statistics = reduce_chunks("bias", "bias", chunks, event.statistics.layout, sampling)
    processor, wall = time.process_time() - began[0], time.perf_counter() - began[1]
    total = passes * len(usable)
    return {
        "step": "columns and Gram matrices",
        "rows": total,
        "used_rows": statistics.rows,
        "processor_s": processor,
        "wall_s": wall,
        "rows_per_s": total / processor,
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB,
    }


def _tiled(samples: Samples, times: int) -> tuple[Any, ...]:
    turn = np.repeat(np.arange(times), len(samples))
    period = float(samples.time_s[-1] - samples.time_s[0]) + 1.0
    place = np.tile(np.arange(len(samples)), times)
    return (
        samples.time_s[place] + turn * period,
        samples.attitude[place],
        samples.rate_rad_s[place],
        samples.wheel_rad_s[place],
        samples.on_time_s[place] + turn[:, None] * samples.on_time_s[-1],
        samples.pulses[place] + turn[:, None] * samples.pulses[-1],
    )


def _passes(block: Samples, passes: int) -> Iterator[Samples]:
    """A block again and again, time and counters going on."""
    period = float(block.time_s[-1]) + 1.0
    on_time, pulses = block.on_time_s[-1].copy(), block.pulses[-1].copy()
    for i in range(passes):
        yield replace(
            block,
            time_s=block.time_s + i * period,
            on_time_s=block.on_time_s + i * on_time,
            pulses=block.pulses + i * pulses,
        )


def file_row(folder: Path, size: float, scratch: Path) -> Row:
    """From one large CSV file of slews (bytes) to Gram matrices: the way that ``fit`` takes it."""
    scratch.mkdir(parents=True, exist_ok=True)
    write_slews(folder, size, scratch)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        row: Row = pool.apply(_reduce_file, (scratch,))
    (scratch / "telemetry.csv").unlink()
    return row


def write_slews(folder: Path, size: float, scratch: Path) -> None:
    """The telemetry of a slew set again and again, time going on, until there are enough bytes.

    Slews have no counters, and one momentum: rows fit each other at any time, with a gap for the
    way back to the first attitude.
    """
    lines = (folder / "telemetry.csv").read_text().splitlines()
    assert lines[0].startswith("time_s,")
    body = [line.partition(",")[2] for line in lines[1:]]
    written = turns = 0
    with (scratch / "telemetry.csv").open("w", encoding="utf-8") as stream_out:
        stream_out.write(lines[0] + "\n")
        while written < size:
            first = turns * (len(body) + GAP_S)
            block = "".join([f"{first + i},{cells}\n" for i, cells in enumerate(body)])
            stream_out.write(block)
            written, turns = written + len(block), turns + 1
    (scratch / "event.toml").write_text((folder / "event.toml").read_text())


def _reduce_file(folder: Path) -> Row:
    began = time.process_time(), time.perf_counter()
    reduced = reduce_event(folder, priors_of(), PULSE_SHAPE)
    processor, wall = time.process_time() - began[0], time.perf_counter() - began[1]
    size = (folder / "telemetry.csv").stat().st_size
    return {
        "step": f"a CSV file of {size / 1e9:.2g} GB, from disk to Gram matrices",
        "rows": reduced.reading.rows,
        "bytes": size,
        "processor_s": processor,
        "wall_s": wall,
        "rows_per_s": reduced.reading.rows / processor,
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB,
    }


def reading_row(folder: Path, rows: int, scratch: Path) -> Row:
    """Rows per second of reading and checking a CSV file of some size."""
    scratch.mkdir(parents=True, exist_ok=True)
    spacecraft = priors_of().spacecraft
    lines = (folder / "telemetry.csv").read_text().splitlines()
    place = lines[0].split(",").index("time_s")
    body = [line.split(",") for line in lines[1:]]
    growing = [i for i, n in enumerate(lines[0].split(",")) if n.startswith(("on_time", "pulses"))]
    last = [float(body[-1][i] or 0.0) for i in growing]
    step = float(body[-1][place]) - float(body[0][place]) + 1.0
    with (scratch / "telemetry.csv").open("w", encoding="utf-8") as stream_out:
        stream_out.write(lines[0] + "\n")
        for turn in range(max(rows // len(body), 1)):
            for cells in body:
                row = list(cells)
                row[place] = f"{float(cells[place]) + turn * step:.3f}"
                for i, gained in zip(growing, last, strict=True):
                    if row[i]:
                        row[i] = f"{float(row[i]) + turn * gained:.3f}"
                stream_out.write(",".join(row) + "\n")
    (scratch / "event.toml").write_text((folder / "event.toml").read_text())
    event = read_event(scratch, spacecraft)
    for _ in read_chunks(read_event(folder, spacecraft), spacecraft):
        pass  # compiled before the clock runs
    began = time.process_time()
    read = sum(chunk.rows for chunk in read_chunks(event, spacecraft))
    processor = time.process_time() - began
    (scratch / "telemetry.csv").unlink()
    return {
        "step": "reading CSV",
        "rows": read,
        "processor_s": processor,
        "rows_per_s": read / processor,
    }
