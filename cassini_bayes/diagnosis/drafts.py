"""Effects drafted from what is left where no cause of the catalogue mends it, or not all of it.

A draft is a form of discrepancy with one or a few weights w: columns G of momentum in body axes
beside the baseline's own, y = X β + G w + noise, with w ~ N(0, a²). With β integrated out and
V⁻¹ = 1 − X (XᵀX + P)⁻¹ Xᵀ, M = Gᵀ V⁻¹ G, h = Gᵀ V⁻¹ y, it changes the log evidence by

    Δ(a) = ½ hᵀ (M + a⁻²)⁻¹ h − ½ log |1 + a² M|.

Forms are weighed on pieces held out: when and where, which frequency, and a are chosen on all
pieces but one, S, and the score of the other is Δ(all) − Δ(S). A piece is an event; with fewer than
three events a quarter of one. All of it is linear about the mode of ``unknown``, where nuisances
are not bent to explain what is missing, or about that of the cause that leaves something: a full
diagnosis with the draft's file is the last word.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from typing import Any, Final

import numpy as np

from cassini_bayes.balance.linearised import (
    Information,
    InnovationRows,
    Linear,
    change_of_evidence,
    diagonal,
    information,
    information_without_each,
    whitened,
)
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.discrepancy import baseline_at
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.innovations import left_by, thrust_columns
from cassini_bayes.diagnosis.score import LEAST_PIECES, STANDARD_ERRORS, summed
from cassini_bayes.diagnosis.spectrum import AXES, spectra
from cassini_bayes.effects.wording import decimals_of, rounded
from cassini_bayes.spacecraft.attitude import direction_cosines
from cassini_bayes.spacecraft.units import RPM_PER_RAD_S

TIMES: Final = 24
"""Places between the first row and the last at which something may begin or end: judgement, a
minute in half an hour, and what is drafted is refined by hand."""
QUARTERS: Final = 4  # of an event, where there are too few events to hold out
LINES: Final = 2  # frequencies for each axis that are looked at, those of most power
MOST: Final = 5  # drafts of a record: one of every form
_AMPLITUDES: Final = np.exp(np.linspace(np.log(0.1), np.log(1e4), 61))
"""Tried for a, in units of what the data tell one weight to: a weight that is not seen to one far
beyond doubt."""


@dataclass(frozen=True)
class Draft:
    """A form of discrepancy with its numbers.

    Attributes
    ----------
    form
        ``oscillation``, ``jump``, ``torque``, ``thrust`` or ``wheel``.
    target
        What of: a body axis, a thruster or ``all``, a wheel's number.
    numbers
        When (``start_s``, ``stop_s``), ``frequency_hz``, or ``power`` of a wheel's speed and the
        wheel's ``place`` among those of the events.
    sizes
        Posterior mean and standard deviation of the weights, by key with unit.
    gain, gain_se
        Log score of pieces held out over the baseline's, nats, with its standard error.
    pieces
        What was held out: ``event`` or ``quarter of an event``.
    """

    form: str
    target: str
    numbers: dict[str, float]
    sizes: dict[str, tuple[float, float]]
    gain: float
    gain_se: float
    pieces: str

    @property
    def name(self) -> str:
        """Of its file and effect."""
        return f"draft_{self.form}"

    @property
    def is_gain(self) -> bool:
        """Whether it predicts pieces held out by more than chance."""
        return self.gain > STANDARD_ERRORS * self.gain_se and self.gain > 0.0

    @property
    def words(self) -> str:
        """The draft in words, one clause."""
        return _WORDS[self.form](self)

    @property
    def record(self) -> dict[str, Any]:
        """For ``diagnosis.json``."""
        return {
            "name": self.name,
            "form": self.form,
            "target": self.target,
            "says": self.words,
            **self.numbers,
            "parameters": {k: {"mean": mean, "sd": sd} for k, (mean, sd) in self.sizes.items()},
            "heldout_gain_nats": self.gain,
            "heldout_gain_se_nats": self.gain_se,
            "held_out": self.pieces,
            "is_gain": self.is_gain,
        }


@dataclass(frozen=True)
class _Candidate:
    """One choice of a form: signed places of columns that share a weight, one row for each."""

    target: str
    numbers: dict[str, float]
    plus: tuple[int, ...]
    minus: tuple[int, ...] = ()  # subtracted from the columns of ``plus`` one by one


@dataclass
class _Columns:
    """Columns of momentum (n, 3) of every event as they are made, and what they are for."""

    rows: Sequence[InnovationRows]
    blocks: list[list[Array]] = field(default_factory=list)
    forms: dict[str, list[_Candidate]] = field(default_factory=dict)

    def add(self, make: Callable[[int, InnovationRows], Array]) -> int:
        """Place of a new column."""
        self.blocks.append([make(place, event) for place, event in enumerate(self.rows)])
        return len(self.blocks) - 1

    def offer(self, form: str, candidate: _Candidate) -> None:
        """A choice of a form."""
        self.forms.setdefault(form, []).append(candidate)

    def white(self) -> Array:
        """All columns (m, q), whitened."""
        parts = []
        for place, event in enumerate(self.rows):
            own = np.stack([block[place] for block in self.blocks], axis=2)
            parts.append(whitened(own, event.noise_factor))
        return np.concatenate(parts)


class _Information(Information):
    """Information of some of the rows on all columns."""

    @classmethod
    def on(cls, told: Information) -> _Information:
        """The same of what there is."""
        return cls(told.matrix, told.vector)

    def of(self, candidate: _Candidate) -> tuple[Array, Array]:
        """M (k, k) and h (k,) of a candidate's weights."""
        plus = list(candidate.plus)
        matrix, vector = self.matrix[np.ix_(plus, plus)], self.vector[plus]
        if not candidate.minus:
            return matrix, vector
        minus = list(candidate.minus)
        across = self.matrix[np.ix_(plus, minus)]
        return (
            matrix + self.matrix[np.ix_(minus, minus)] - across - across.T,
            vector - self.vector[minus],
        )

    def change(self, candidate: _Candidate, amplitude: float) -> float:
        """Δ(a), nats."""
        matrix, vector = self.of(candidate)
        kappa, rotated = diagonal(matrix, vector)
        return float(change_of_evidence(kappa, rotated, np.array([amplitude]))[0])

    def best(self, candidates: Sequence[_Candidate]) -> tuple[_Candidate, float]:
        """The candidate of largest Δ, and its a."""
        result = [(*self._amplitude(candidate), candidate) for candidate in candidates]
        _, amplitude, candidate = max(result, key=lambda entry: entry[0])
        return candidate, amplitude

    def _amplitude(self, candidate: _Candidate) -> tuple[float, float]:
        kappa, rotated = diagonal(*self.of(candidate))
        if not kappa.max() > 0.0:
            return 0.0, 0.0
        tried = _AMPLITUDES / np.sqrt(kappa.max())
        changes = change_of_evidence(kappa, rotated, tried)
        place = int(changes.argmax())
        return float(changes[place]), float(tried[place])

    def weights(self, candidate: _Candidate, amplitude: float) -> tuple[Array, Array]:
        """Posterior mean and standard deviation (k,) of the weights."""
        matrix, vector = self.of(candidate)
        covariance = np.linalg.inv(matrix + np.eye(len(vector)) / amplitude**2)
        return covariance @ vector, np.sqrt(np.diagonal(covariance))


def drafted(events: Events, weighed: Weighed[Hypothesis]) -> tuple[Draft, ...]:
    """One draft of every form, that of the largest held-out gain first; for telemetry.

    Of what the baseline leaves at the mode of ``unknown``, or of what a cause leaves at its own.
    """
    if weighed.is_cause:
        full, point, left = weighed.hypothesis, weighed.mode.point, left_by(weighed)
    else:
        full, point, left = baseline_at(events, weighed)
    thrusts = [thrust_columns(full, point, place) for place in range(len(left.rows))]
    common = float(full.model.points(point[None]).common_n[0])
    return drafts_of(left.linear, left.rows, point, thrusts, common)


def drafts_of(
    linear: Linear,
    rows: Sequence[InnovationRows],
    point: Array,
    thrusts: Sequence[Array],
    common_n: float,
) -> tuple[Draft, ...]:
    """Drafts of what a linear model leaves.

    Parameters
    ----------
    linear, rows
        The baseline's linear model and innovations at a point.
    point
        The point z (d,): the prior mean of its walked parameters is −z away from it.
    thrusts
        Momentum per newton (n, 3, K) of every thruster in every event's rows.
    common_n
        Common level of the thrust, N.
    """
    columns = _columns(rows, thrusts)
    white = columns.white()
    target = linear.about_prior_mean(point)
    whole = _Information.on(information(linear, target, white))
    without, what = _without_each(linear, target, white)
    drafts = []
    for form, candidates in columns.forms.items():
        scores = []
        for others in without:
            chosen, amplitude = others.best(candidates)
            scores.append(
                whole.change(chosen, amplitude) - others.change(chosen, amplitude)
                if amplitude > 0.0
                else 0.0
            )
        chosen, amplitude = whole.best(candidates)
        if not amplitude > 0.0:
            continue
        sizes = _sizes(form, *whole.weights(chosen, amplitude), common_n)
        gain, error = summed(np.array(scores))
        drafts.append(Draft(form, chosen.target, chosen.numbers, sizes, gain, error, what))
    return tuple(sorted(drafts, key=lambda draft: -draft.gain)[:MOST])


def _without_each(linear: Linear, target: Array, white: Array) -> tuple[list[_Information], str]:
    """Information of all rows but those that are held out together, for each such piece."""
    if len(linear.parts) >= LEAST_PIECES:
        told, what = information_without_each(linear, target, white), "event"
    else:
        told, what = [], "quarter of an event"
        for part in linear.parts:
            edges = np.linspace(part.start // 3, part.stop // 3, QUARTERS + 1).astype(int) * 3
            for first, last in pairwise(edges):
                used = np.ones(len(target), dtype=bool)
                used[first:last] = False
                told.append(information(linear, target, white, used=used))
    return [_Information.on(own) for own in told], what


def _columns(rows: Sequence[InnovationRows], thrusts: Sequence[Array]) -> _Columns:
    columns = _Columns(rows)
    # events may begin long after their epoch
    first = min(float(event.time_s[0]) for event in rows)
    last = max(float(event.time_s[-1]) for event in rows)
    times = np.linspace(first, last, TIMES + 2)[:-1]
    for c, axis in enumerate(AXES):
        _jumps(columns, times[1:], c, axis)
        ramps = [columns.add(_about(c, _since(start))) for start in times]
        _windows(columns, "torque", axis, times, ramps)
    names = next((event.thrusters for event in rows if event.on_time_s.shape[1]), ())
    every: dict[str, slice] = {name: slice(k, k + 1) for k, name in enumerate(names)}
    for name, which in ({"all": slice(None)} | every).items() if names else ():
        of_event = [thrust[:, :, which].sum(2) for thrust in thrusts]
        fired = [columns.add(_fired_since(start, of_event)) for start in times]
        _windows(columns, "thrust", name, times, fired)
    for number in sorted({number for event in rows for number in event.wheels}):
        for power in (1, 2):
            places = tuple(columns.add(_about(c, _speed(number, power))) for c in range(3))
            place = next(e.wheels.index(number) for e in rows if number in e.wheels)
            numbers: dict[str, float] = {"power": power, "place": place}
            columns.offer("wheel", _Candidate(str(number), numbers, places))
    _oscillations(columns, rows)
    return columns


def _jumps(columns: _Columns, times: Array, c: int, axis: str) -> None:
    for start in times:
        place = columns.add(_about(c, _from(start)))
        columns.offer("jump", _Candidate(axis, {"start_s": float(start)}, (place,)))


def _windows(
    columns: _Columns, form: str, target: str, times: Array, places: Sequence[int]
) -> None:
    """Something that begins at one time and ends at another, or does not end."""
    for i, start in enumerate(times):
        if i > 0:  # from the start on and without end: the catalogue has these
            numbers = {"start_s": float(start), "stop_s": float("inf")}
            columns.offer(form, _Candidate(target, numbers, (places[i],)))
    for i, j in combinations(range(len(times)), 2):
        numbers = {"start_s": float(times[i]), "stop_s": float(times[j])}
        columns.offer(form, _Candidate(target, numbers, (places[i],), (places[j],)))


def _oscillations(columns: _Columns, rows: Sequence[InnovationRows]) -> None:
    """Lines of most power, a phase and an amplitude in every event."""
    result = spectra(rows)
    for c, axis in enumerate(AXES):
        along = [s for s in result if s.axis == axis]
        for spectrum in sorted(along, key=lambda s: -s.power[s.peak])[:LINES]:
            frequency = float(spectrum.frequency_hz[spectrum.peak])
            places = tuple(
                columns.add(_about(c, _wave(frequency, wave), event.event))
                for event in rows
                for wave in (np.cos, np.sin)
            )
            columns.offer("oscillation", _Candidate(axis, {"frequency_hz": frequency}, places))


def _about(
    c: int, series: Callable[[InnovationRows], Array], only: str | None = None
) -> Callable[[int, InnovationRows], Array]:
    """A series as momentum about a body axis, in all events or in one."""

    def make(_: int, event: InnovationRows) -> Array:
        values = np.zeros((len(event.time_s), 3))
        if only in (None, event.event):
            values[:, c] = series(event)
        return values

    return make


def _from(start: float) -> Callable[[InnovationRows], Array]:
    return lambda event: (event.time_s >= start).astype(np.float64)


def _since(start: float) -> Callable[[InnovationRows], Array]:
    return lambda event: np.maximum(event.time_s - start, 0.0)


def _speed(number: int, power: int) -> Callable[[InnovationRows], Array]:
    """Of a wheel in 1000 rev/min, to a power; zero in events that do not use it."""

    def series(event: InnovationRows) -> Array:
        if number not in event.wheels:
            return np.zeros(len(event.time_s))
        speed = event.wheel_rad_s[:, event.wheels.index(number)]
        return np.asarray((RPM_PER_RAD_S * speed / 1e3) ** power)

    return series


def _wave(frequency: float, wave: Callable[[Array], Array]) -> Callable[[InnovationRows], Array]:
    return lambda event: wave(2.0 * np.pi * frequency * event.time_s)


def _fired_since(start: float, thrusts: Sequence[Array]) -> Callable[[int, InnovationRows], Array]:
    """Of momentum per newton (n, 3), what was fired since a time, turned with the body."""

    def make(place: int, event: InnovationRows) -> Array:
        turn = direction_cosines(event.attitude)
        inertial = np.einsum("nai,na->ni", turn, thrusts[place])
        first = int(np.searchsorted(event.time_s, start))
        if first >= len(event.time_s):
            return np.zeros((len(event.time_s), 3))
        since = inertial - inertial[max(first - 1, 0)] if first else inertial
        since[:first] = 0.0
        return np.asarray(np.einsum("nai,ni->na", turn, since))

    return make


def _sizes(form: str, mean: Array, sd: Array, common_n: float) -> dict[str, tuple[float, float]]:
    """Weights by key: SI, thrust as a share of the common level."""
    if form == "thrust":
        return {"thrust_share": (float(mean[0]) / common_n, float(sd[0]) / common_n)}
    if form == "oscillation":
        amplitude = np.hypot(mean[::2], mean[1::2])
        return {"amplitude_n_m_s": (float(amplitude.mean()), float(sd.mean()))}
    if form == "wheel":
        return {
            f"momentum_{axis}_n_m_s": (float(m), float(s))
            for axis, m, s in zip(AXES, mean, sd, strict=True)
        }
    key = {"jump": "momentum_n_m_s", "torque": "torque_n_m"}[form]
    return {key: (float(mean[0]), float(sd[0]))}


def _window(draft: Draft) -> str:
    start, stop = draft.numbers["start_s"], draft.numbers["stop_s"]
    begin = f" from t = {start:.0f} s" if start > 0.0 else ""
    return f"{begin} until t = {stop:.0f} s" if np.isfinite(stop) else f"{begin} on"


def _error(draft: Draft, factor: float, unit: str) -> str:
    ((mean, sd),) = draft.sizes.values()
    places = decimals_of(factor * sd)
    return f"{rounded(factor * mean, places)} ± {rounded(factor * sd, places)} {unit}"


def _thrust_sentence(draft: Draft) -> str:
    who = "all thrusters push" if draft.target == "all" else f"{draft.target.upper()} pushes"
    return f"{who} {_error(draft, 100.0, '%')} more{_window(draft)}"


def _wheel_sentence(draft: Draft) -> str:
    shape = "the square of the speed" if draft.numbers["power"] == 2 else "the speed"
    values = ", ".join(f"{1e3 * mean:+.2g}" for mean, _ in draft.sizes.values())
    unit = "(1000 rpm)²" if draft.numbers["power"] == 2 else "1000 rpm"
    return (
        f"momentum goes with {shape} of wheel {draft.target}: {values} mN m s about X, Y, Z at "
        f"{unit}"
    ).replace("-", "−")


_WORDS: Final[dict[str, Callable[[Draft], str]]] = {
    "oscillation": lambda d: (
        f"an oscillation at {d.numbers['frequency_hz']:.4g} Hz about {d.target.upper()}, "
        f"{_error(d, 1e3, 'mN m s')} in the mean of the events"
    ),
    "jump": lambda d: (
        f"a step of {_error(d, 1e3, 'mN m s')} about {d.target.upper()} at t = "
        f"{d.numbers['start_s']:.0f} s"
    ),
    "torque": lambda d: (
        f"a torque of {_error(d, 1e6, 'µN m')} about {d.target.upper()}{_window(d)}"
    ),
    "thrust": _thrust_sentence,
    "wheel": _wheel_sentence,
}
