"""Event folders to Gram matrices, with a cache: telemetry is read once however often it is fitted.

The cache is a folder of ``<key>.npz`` (the Gram matrices) and ``<key>.json`` (what was read), the
key being the hash of the telemetry, of how it is reduced and of the code that reduces it.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import TypeAdapter, ValidationError

from cassini_bayes.balance.accelerometer import AccelerometerStatistics, accelerometer_statistics
from cassini_bayes.balance.measured_delta_v import DeltaVStatistics, delta_v_statistics
from cassini_bayes.balance.physics import PULSE_PARAMETERS
from cassini_bayes.balance.statistics import (
    EventStatistics,
    ExtraColumn,
    Samples,
    Sampling,
    layout_of,
    load_statistics,
    reduce_chunks,
    save_statistics,
)
from cassini_bayes.balance.statistics.columns import Carry, Rows, settle
from cassini_bayes.balance.statistics.preparation import Prepared, prepare
from cassini_bayes.computing.arrays import Array, Places, joined
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.errors import InputError
from cassini_bayes.events.branches import require_branch
from cassini_bayes.events.plausibility import (
    STRICT,
    CellSearch,
    Nominal,
    Plausibility,
    Policy,
    TelemetryCheck,
    without_cells,
)
from cassini_bayes.events.telemetry import (
    ChannelMap,
    Chunk,
    Mends,
    TelemetryEvent,
    read_chunks,
    read_event,
)
from cassini_bayes.events.telemetry.tail import last_time
from cassini_bayes.files.code import code_digest
from cassini_bayes.files.json_file import read_json
from cassini_bayes.files.reading import exists
from cassini_bayes.files.storage import write_text
from cassini_bayes.model.nominal import nominal_values
from cassini_bayes.priors.reader import Priors
from cassini_bayes.spacecraft import Spacecraft, couples
from cassini_bayes.spacecraft.parameters import NOISE_LEVELS
from cassini_bayes.spacecraft.pulses import shape_named
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

WITH_DELTA_V: Final = ("bias", "delta_v")  # kinds of event whose measured velocity change is used
REDUCED_BY: Final = (
    "events.telemetry", "events.plausibility", "balance.statistics", "model.event_reduction",
)  # fmt: skip
"""Packages whose code, with all that they import, checks telemetry and reduces it."""
_LOG_EVERY_S: Final = 5.0  # between lines of progress
_TAIL_SPAN: Final = 5.0  # τ_fall after which 0.7 % of a tail is still to come
_PRIOR_SPAN: Final = 2.0  # prior standard deviations that τ_fall may exceed its mean by
_CORNER: Final = 0.5  # of the attitude's noise
_CORNER_NOISE: Final = 5.0  # standard deviations of a second difference
MOST_EARLY: Final = 0.01  # of an event, that its first row may lie before its epoch
MOST_LATE_S: Final = 3e9
"""A century: a later first row is a count in another unit, no date."""
MOST_KEPT: Final = 200_000
"""Rows of an event that stay in memory once they are read, some 50 MB."""


@dataclass(frozen=True)
class ReadingRecord:
    """What reading an event found: rows, times, counters gone through, repairs in words."""

    rows: int
    start_s: float
    end_s: float
    on_time_s: tuple[float, ...]  # (K,) gained from the first to the last reading
    pulses: tuple[float, ...]  # (K,)
    mends: tuple[str, ...]
    findings: tuple[str, ...] = ()  # what was accepted, or fits nothing known
    content: str = field(default="", compare=False)  # digest of the numbers, not of their names


@dataclass(frozen=True, eq=False)
class ReducedEvent:
    """A telemetry event ready for a model, how it was reduced, and its rows."""

    statistics: EventStatistics
    sampling: Sampling
    reading: ReadingRecord
    rows: PreparedRows
    source: str
    digest: str = ""  # of the files; none of telemetry that was never in one
    key: str = ""  # of the reduction in the cache
    delta_v: DeltaVStatistics | None = None  # of a measured velocity change
    accelerometer: AccelerometerStatistics | None = None
    channels: ChannelMap | None = None  # of telemetry whose columns are not ours
    epoch: datetime | None = None  # of the first row, where it is known
    recording: TelemetryEvent | None = None  # that was reduced

    @property
    def id(self) -> str:
        """Id of the event."""
        return self.statistics.event_id

    @property
    def kind(self) -> str:
        """Kind of the event."""
        return self.statistics.kind

    @property
    def wheels(self) -> tuple[int, ...]:
        """Numbers of its wheels."""
        return self.statistics.layout.wheels

    @property
    def thrusters(self) -> tuple[str, ...]:
        """Names of its thrusters; none without counters."""
        return self.statistics.layout.thrusters

    @property
    def fires(self) -> bool:
        """Whether the event has thruster counters."""
        return bool(self.thrusters)

    @cached_property
    def samples(self) -> Samples:
        """All rows at once."""
        return joined(list(self.rows))

    @cached_property
    def usable_rows(self) -> Rows:
        """The columns of all rows that enter the balance."""
        layout = self.statistics.layout
        return settle(self.samples, Carry.start(layout), layout, self.sampling, final=True)[0]

    @property
    def usable_places(self) -> Places:
        """Places (n,) of the usable rows among all samples."""
        return np.searchsorted(self.samples.time_s, self.usable_rows.time_s)

    def with_columns(self, extra: Sequence[ExtraColumn]) -> ReducedEvent:
        """The event reduced with columns that effects need, which see all of it at once."""
        sampling = replace(self.sampling, extra=tuple(extra))
        layout = replace(self.statistics.layout, extra=tuple(column.name for column in extra))
        samples, result = self.samples, self.rows.prepared.found
        statistics = reduce_chunks(
            self.id, self.kind, [samples], layout, sampling, len(samples), result
        )
        return replace(self, statistics=statistics, sampling=sampling, key="")


class EventRows:
    """The telemetry of an event folder: parsed once, and kept if it is not long.

    Up to :data:`MOST_KEPT` rows stay in memory for whoever asks next. A longer file is streamed
    anew each time, in constant memory. ``leave_out`` finds bad cells that are to be left out.
    """

    def __init__(
        self, event: TelemetryEvent, spacecraft: Spacecraft, leave_out: CellSearch | None = None
    ) -> None:
        self._event, self._spacecraft, self._leave_out = event, spacecraft, leave_out
        self._kept: tuple[Chunk, ...] | None = None
        self.mends = Mends()

    def __reduce__(self) -> tuple[object, ...]:
        # Another process reads the file itself: rows need not travel.
        return EventRows, (self._event, self._spacecraft, self._leave_out)

    def __iter__(self) -> Iterator[Samples]:
        search = self._leave_out
        for chunk in self.chunks():
            yield samples_of(chunk if search is None else without_cells(chunk, search.find(chunk)))

    def chunks(self) -> Iterator[Chunk]:
        """The rows as they are in the file, checked and mended."""
        if self._kept is not None:
            yield from self._kept
            return
        kept: list[Chunk] = []
        rows, mends = 0, Mends()
        for chunk in read_chunks(self._event, self._spacecraft, mends=mends):
            rows += chunk.rows
            kept = [*kept, chunk] if rows <= MOST_KEPT else []
            yield chunk
        self.mends = mends
        if rows <= MOST_KEPT:
            self._kept = tuple(kept)


class PreparedRows:
    """Rows of an event with what a first look at them found: expected on-times, least steps."""

    def __init__(self, rows: Iterable[Samples], control_cycle_s: float, guard_s: float) -> None:
        self._rows, self._control_cycle_s, self._guard_s = rows, control_cycle_s, guard_s

    def __reduce__(self) -> tuple[object, ...]:
        return PreparedRows, (self._rows, self._control_cycle_s, self._guard_s)

    def __iter__(self) -> Iterator[Samples]:
        return self.prepared.samples(self._rows)

    @cached_property
    def prepared(self) -> Prepared:
        """The first look, made once."""
        return prepare(self._rows, self._control_cycle_s, self._guard_s)


def is_event_folder(path: Path) -> bool:
    """Whether a path given as an event is a folder of telemetry, not a totals file."""
    return exists(path) and path.is_dir()


def samples_of(chunk: Chunk) -> Samples:
    """A checked chunk of telemetry as rows of the balance, wheel rates in rad/s."""
    return Samples(
        chunk.time_s,
        chunk.attitude,
        chunk.rate_rad_s,
        chunk.wheel_rpm * RAD_S_PER_RPM,
        chunk.on_time_s,
        chunk.pulses,
    )


def sampling_of(
    priors: Priors,
    thrusters: Sequence[str],
    duration_s: float,
    pulse_shape: str,
) -> Sampling:
    """How an event's telemetry is reduced, from the priors of the pulse parameters.

    The guard time is the valve delay and five of the longest likely tail-off times: what a pulse
    delivers later is below a percent of its tail. Wheels that change their acceleration between
    rows end a piece where the trapezoid would miss half the attitude's noise (I_w Δ²ρ Δt/8 against
    I σ_θ) and where that is no noise of the wheel rates (five standard deviations).

    Raises
    ------
    InputError
        The priors are those of totals: a parameter that telemetry needs is missing.
    """
    moments = [f"inertia_{axis}{axis}_kg_m2" for axis in "xyz"]
    wheels = [w.inertia_parameter for w in priors.spacecraft.wheels if w.number in priors.wheels]
    priors.require((*moments, *wheels, *NOISE_LEVELS), "telemetry")
    means = priors.means()
    attitude_noise, wheel_noise = means["attitude_noise_rad"], means["wheel_noise_rpm"]
    missed = _CORNER * min(means[name] for name in moments) * attitude_noise
    wheel = max(means[name] for name in wheels)
    noise = wheel_noise * RAD_S_PER_RPM
    groups = couples(priors.spacecraft, priors.branch) if thrusters else ()
    reference, guard = (0.0, 0.0, 0.0), 0.0
    if thrusters:
        priors.require(PULSE_PARAMETERS, "telemetry with thrusters")
        delay, rise, fall = (priors.parameters[name] for name in PULSE_PARAMETERS)
        reference = (delay.mean, rise.mean, fall.mean)
        guard = delay.mean + _TAIL_SPAN * (fall.mean + _PRIOR_SPAN * fall.sd)
    return Sampling(
        shape_named(pulse_shape, "pulse_shape"),
        reference,
        guard,
        tuple(tuple(list(thrusters).index(name) for name in group) for group in groups),
        duration_s,
        control_cycle_s=priors.spacecraft.control_cycle_s,
        corner_rad=8.0 * missed / wheel,
        corner_rad_s=_CORNER_NOISE * np.sqrt(6.0) * noise,
        reference_noise=tuple(priors.medians(NOISE_LEVELS).items()),
        noise_to_see=tuple(name for name in NOISE_LEVELS if priors.parameters[name].sd > 0.0),
    )


def reduce_samples(
    event_id: str,
    kind: str,
    wheels: Sequence[int],
    thrusters: Sequence[str],
    samples: Samples,
    sampling: Sampling,
    epoch: datetime | None = None,
) -> ReducedEvent:
    """Reduce telemetry that is in memory, as from a simulation."""
    layout = layout_of(wheels, thrusters, sampling)
    rows = PreparedRows((samples,), sampling.control_cycle_s, sampling.guard_s)
    result = rows.prepared.found
    statistics = reduce_chunks(event_id, kind, rows, layout, sampling, prepared=result)
    gone = _Counters(len(thrusters))
    gone.take(samples.on_time_s, samples.pulses)
    start, end = samples.time_s[[0, -1]].tolist()
    reading = ReadingRecord(len(samples), start, end, *gone.gained, mends=())
    sampling = statistics.seen_by(sampling)
    return ReducedEvent(statistics, sampling, reading, rows, "memory", epoch=epoch)


def reduce_event(
    given: str | Path | TelemetryEvent,
    priors: Priors,
    pulse_shape: str,
    cache: Path | None = None,
    log: Log = silent,
    policy: Policy = STRICT,
) -> ReducedEvent:
    """Read an event's telemetry and reduce it, or take the reduction from the cache.

    Parameters
    ----------
    given
        An event folder (``event.toml`` and telemetry), or an event from :func:`read_event` or
        :func:`event_from_frame`.
    priors
        Their spacecraft, branch and pulse parameters decide how rows become columns.
    pulse_shape
        Key of :data:`cassini_bayes.spacecraft.pulses.PULSE_SHAPES`.
    cache
        Folder of earlier reductions; nothing is written there (:func:`store_reduction` does).
    log
        Told what was read.
    policy
        Mistakes in the telemetry that the user accepts.

    Raises
    ------
    InputError
        Bad telemetry (file, row and column named), a mistake that explains what no fault of a
        spacecraft does (it is named), another thruster
        branch than the priors', or too few rows that can be used.
    """
    event = given if isinstance(given, TelemetryEvent) else read_event(given, priors.spacecraft)
    require_branch(event.where, event.branch, priors.branch)
    nominal = Nominal.of(
        priors.spacecraft,
        event.branch,
        event.wheels,
        nominal_values(priors),
        fires=bool(event.thrusters),
    )
    search = CellSearch(nominal) if policy.leave_out else None
    rows = EventRows(event, priors.spacecraft, search)
    likely = sampling_of(priors, event.thrusters, last_time(event), pulse_shape)
    looked = PreparedRows(rows, likely.control_cycle_s, likely.guard_s)
    key = reduction_key(event, likely, priors, policy)
    cached = _cached(cache, key)
    statistics, reading = cached or _reduced(
        event, rows, looked.prepared, priors, likely, log, policy
    )
    sampling = statistics.seen_by(replace(likely, duration_s=statistics.duration_s))
    source = "from the cache" if cached is not None else "reduced"
    blocks = f" (means over {sampling.block_s:g} s: hardly a row is without firing)"
    log(
        f"{event.id} ({event.kind}): {reading.rows:,} rows of telemetry, {statistics.rows:,} in "
        f"the balance{blocks if sampling.block_s > 0.0 else ''}, {source}"
    )
    for line in (*(f"mended: {mend}" for mend in reading.mends), *reading.findings):
        log(f"{event.id}: {line}")
    return ReducedEvent(
        statistics,
        sampling,
        reading,
        looked,
        event.source,
        event.digest,
        key,
        _delta_v(event, rows, sampling),
        _accelerometer(event, rows, sampling),
        event.channels,
        event.epoch,
        event,
    )


def _delta_v(event: TelemetryEvent, rows: EventRows, sampling: Sampling) -> DeltaVStatistics | None:
    """The measured velocity change of a burn or a wheel bias; None for any other event.

    One computed on board repeats the flight software's constants and says nothing of thrust.
    """
    if event.kind not in WITH_DELTA_V or event.delta_v_source != "measured" or not event.thrusters:
        return None
    parts = ((samples_of(chunk), chunk.delta_v_m_s) for chunk in rows.chunks())
    return delta_v_statistics(event.id, parts, sampling)


def _accelerometer(
    event: TelemetryEvent, rows: EventRows, sampling: Sampling
) -> AccelerometerStatistics | None:
    """The accelerometer's counts in a burn or a wheel bias; None without them."""
    if event.kind not in WITH_DELTA_V or not event.has_accelerometer:
        return None
    parts = ((samples_of(chunk), chunk.accelerometer_counts) for chunk in rows.chunks())
    return accelerometer_statistics(event.id, parts, sampling)


def store_reduction(reduced: ReducedEvent, cache: Path) -> None:
    """Write a reduction to the cache, unless it is there."""
    archive, record = cache / f"{reduced.key}.npz", cache / f"{reduced.key}.json"
    if not archive.exists() or not record.exists():
        save_statistics(archive, reduced.statistics)
        write_text(record, json.dumps(asdict(reduced.reading), indent=1) + "\n")


def reduction_key(
    event: TelemetryEvent, sampling: Sampling, priors: Priors, policy: Policy = STRICT
) -> str:
    """Hash of all that a reduction and its findings depend on.

    Data, mistakes accepted, columns, pulses, spacecraft, the values that mistakes are judged by,
    and code.
    """
    depends_on = {
        "telemetry": event.digest,
        "accepted": sorted(policy.accepted),
        "leave_out": policy.leave_out,
        "pulse_shape": sampling.pulse_shape.name,
        "reference": sampling.pulse_reference_s,
        "guard_s": sampling.guard_s,
        "couples": sampling.couples,
        "duration_s": sampling.duration_s,
        "extra": [column.name for column in sampling.extra],
        "control_cycle_s": sampling.control_cycle_s,
        "corner": [sampling.corner_rad, sampling.corner_rad_s],
        "thrusters": event.thrusters,
        "spacecraft": priors.spacecraft.digest,
        "nominal": nominal_values(priors),
        "code": code_digest(*REDUCED_BY),
    }
    return hashlib.sha256(json.dumps(depends_on, sort_keys=True).encode()).hexdigest()[:32]


def _cached(cache: Path | None, key: str) -> tuple[EventStatistics, ReadingRecord] | None:
    if cache is None:
        return None
    statistics = load_statistics(cache / f"{key}.npz")
    try:
        record = read_json(cache / f"{key}.json", "the record of a reduction")
        reading = TypeAdapter(ReadingRecord).validate_python(record)
    except (InputError, ValidationError):
        return None
    return None if statistics is None else (statistics, reading)


def _require_start(event: TelemetryEvent, start_s: float, end_s: float) -> None:
    """Refuse an event that begins before 0, or later than it lasts: torques are laid over [0, end].

    A first row some minutes late does no harm. With a clock's count for time, or another event's
    epoch, nearly all that the torque noise may do would lie before the first row.
    """
    lasts_s = end_s - start_s
    if -MOST_EARLY * lasts_s <= start_s <= lasts_s:
        return
    fix = (
        "count times from the first row, or say in a channel map what they are: channels.time has "
        "time_system, unit and epoch"
    )
    if abs(start_s) < MOST_LATE_S:
        first = (event.epoch + timedelta(seconds=start_s)).isoformat()
        fix = f"where times are dates give epoch = {first}; where they are counts {fix}"
    raise InputError(
        f"{event.where}: epoch",
        "the time of the first row, from which times are counted",
        f"a first row at {start_s:.10g} s, of {lasts_s:.10g} s of telemetry",
        fix,
    )


class _Counters:
    """What thruster counters have gone through, from their first reading to the last."""

    def __init__(self, thrusters: int) -> None:
        self._first: Array | None = None
        self._last = np.zeros((2, thrusters))

    def take(self, on_time_s: Array, pulses: Array) -> None:
        """Go on with rows (n, K) of the counters."""
        counters = np.stack([on_time_s, pulses])
        rows = np.flatnonzero(np.isfinite(counters).all((0, 2)))
        if counters.shape[2] and len(rows):
            self._first = counters[:, rows[0]] if self._first is None else self._first
            self._last = counters[:, rows[-1]]

    @property
    def gained(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """On-times and pulses (K,); none without a reading."""
        gained = self._last if self._first is None else self._last - self._first
        on_time_s, pulses = gained.tolist()
        return tuple(on_time_s), tuple(pulses)


class _Reading:
    """Streams an event's chunks and keeps what the record of the reading needs."""

    def __init__(
        self,
        event: TelemetryEvent,
        rows: EventRows,
        check: TelemetryCheck,
        until_s: float,
        log: Log,
    ) -> None:
        self._event, self._rows = event, rows
        self._until_s, self._log = until_s, log
        self._began = self._logged = time.monotonic()
        self._check = check
        self.rows = 0
        self.start_s, self.end_s = np.nan, np.nan
        self._counters = _Counters(len(event.thrusters))

    def samples(self) -> Iterator[Samples]:
        """The event's rows, chunk by chunk."""
        for chunk in self._rows.chunks():
            if self.rows == 0:
                self.start_s = float(chunk.time_s[0])
                _require_start(self._event, self.start_s, self._until_s)
            self.rows += chunk.rows
            self.end_s = float(chunk.time_s[-1])
            self._counters.take(chunk.on_time_s, chunk.pulses)
            yield samples_of(self._check.take(chunk))
            self._log_progress()

    def _log_progress(self) -> None:
        """A line every few seconds: how far it is, by the time that the file's tail has."""
        now = time.monotonic()
        if now - self._logged < _LOG_EVERY_S:
            return
        self._logged = now
        share = min((self.end_s - self.start_s) / max(self._until_s - self.start_s, 1e-9), 1.0)
        left = (now - self._began) * (1.0 / max(share, 1e-9) - 1.0)
        self._log(
            f"{self._event.id}: {self.rows:,} rows read, {share:.0%} of the time, {left:.0f} s left"
        )

    def record(self, plausible: Plausibility) -> ReadingRecord:
        """The record, once the last chunk has been taken."""
        return ReadingRecord(
            self.rows,
            self.start_s,
            self.end_s,
            *self._counters.gained,
            mends=self._rows.mends.lines(),
            findings=plausible.findings,
            content=plausible.content,
        )


def _reduced(
    event: TelemetryEvent,
    rows: EventRows,
    prepared: Prepared,
    priors: Priors,
    likely: Sampling,
    log: Log,
    policy: Policy,
) -> tuple[EventStatistics, ReadingRecord]:
    """The reduction of an event that lasts as long as a first look has found."""
    sampling = replace(likely, duration_s=prepared.end_s)
    layout = layout_of(event.wheels, event.thrusters, sampling)
    check = TelemetryCheck(event, priors.spacecraft, nominal_values(priors), policy)
    reading = _Reading(event, rows, check, sampling.duration_s, log)
    statistics = reduce_chunks(
        event.id,
        event.kind,
        prepared.samples(reading.samples()),
        layout,
        sampling,
        prepared=prepared.found,
    )
    return statistics, reading.record(check.verdict())
