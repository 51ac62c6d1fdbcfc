"""The one door that events of telemetry pass: rows are collected, then judged."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.plausibility.attitudes import turns_rad
from cassini_bayes.events.plausibility.cells import BadCell, CellSearch, without_cells
from cassini_bayes.events.plausibility.counts import OnTimeSteps, PulseSteps
from cassini_bayes.events.plausibility.departures import Nominal
from cassini_bayes.events.plausibility.evidence import (
    Evidence,
    between_firings,
    with_swing,
    without_cut_pulses,
)
from cassini_bayes.events.plausibility.hypotheses import AXES, are_too_short, explanations
from cassini_bayes.events.plausibility.likelier import (
    likelier_rates,
    likeliest,
    with_scaled_rates,
)
from cassini_bayes.events.plausibility.rows import Motion, RowCollector, Rows
from cassini_bayes.events.plausibility.shifts import with_noise_of_lags
from cassini_bayes.events.plausibility.verdict import (
    PHYSICS,
    STRICT,
    SUSPECT,
    UNKNOWN,
    Explanation,
    Findings,
    Policy,
    best_explanations,
)
from cassini_bayes.events.telemetry import Chunk, TelemetryEvent
from cassini_bayes.events.totals import SHORTEST_PULSE_S
from cassini_bayes.spacecraft import Spacecraft

ONE_MOTION: Final = "attitude, rates, wheels and counters of one motion"
OPEN: Final = 0.3
"""Of the momentum exchanged: what may stay open without a name before an event is refused. By trial
(docs/topics/plausibility.md); what it does to honest events is in docs/results/mistakes.md."""
MOST_CELLS_NAMED: Final = 3  # that a line can hold
SILENT_SIGMAS: Final = 8.0
"""Of the attitude's noise: a wobble that is none (judgement: the largest of 10⁵ normal rows, a day,
is 4.4). A wobble of less leaves a stuck rate unasked."""
LEAST_EXCESS_S: Final = 1.0
"""Of a counter over time: rounding, of counters in steps of up to a second (judgement)."""
LEAST_TURN_RAD: Final = 2e-4
"""A wobble of the attitude that a rate which never changes cannot have made: ten times the
largest noise measured (docs/results/real-attitude.md)."""


@dataclass(frozen=True)
class Plausibility:
    """How well motion and momentum fit each other.

    ``misfit`` is in units of noise (0 for an event that fits, NaN for one with too few rows to
    judge), ``rows`` those with every channel, ``content`` a digest of all numbers whatever the
    event is called, ``findings`` what was not refused but has to be said.
    """

    rows: int
    misfit: float
    content: str
    findings: tuple[str, ...] = ()


class TelemetryCheck:
    """Give it an event's chunks while they are read for something else; then ask for its verdict.

    Parameters
    ----------
    event, spacecraft
        From :func:`read_event`.
    parameters
        Nominal values by name: inertia, wheels, and for events with on-times geometry, centre of
        mass, ``thrust_common_n``, ``tau_rise_s`` and ``tau_fall_s``; prior means will do.
    policy
        Mistakes that the user accepts.
    """

    def __init__(
        self,
        event: TelemetryEvent,
        spacecraft: Spacecraft,
        parameters: Mapping[str, float],
        policy: Policy = STRICT,
    ) -> None:
        self._event, self._policy, self._where = event, policy, str(event.telemetry)
        self._nominal = Nominal.of(
            spacecraft, event.branch, event.wheels, parameters, fires=bool(event.thrusters)
        )
        self._rows = RowCollector()
        self._pulses = PulseSteps()
        self._on_times = OnTimeSteps(len(event.thrusters))
        self._search = CellSearch(self._nominal)
        self._cells: list[BadCell] = []
        self._content = hashlib.sha256()

    def take(self, chunk: Chunk) -> Chunk:
        """Take a chunk; without its bad cells if they are to be left out."""
        cells = self._search.find(chunk)
        self._cells += cells
        # other mistakes are judged without these cells, whatever becomes of them
        mended = without_cells(chunk, cells)
        self._rows.add(mended)
        self._pulses.add(mended)
        self._on_times.add(mended)
        motion = (chunk.time_s[:, None], chunk.attitude, chunk.rate_rad_s)
        table = np.concatenate([*motion, chunk.wheel_rpm, chunk.on_time_s, chunk.pulses], axis=1)
        self._content.update(table.tobytes())
        return mended if self._policy.leave_out else chunk

    def verdict(self) -> Plausibility:
        """Judge what was collected.

        Raises
        ------
        InputError
            A mistake explains what physics does not, or the balance of momentum stays wide open.
            The message names the mistake that explains it best, and what would as well.
        """
        channels = self._event.channels
        findings = Findings(self._policy, channels.where if channels is not None else "")
        self._check_pulses(findings)
        rows, motion = self._rows.rows(), self._rows.motion()
        if rows is not None:
            self._check_widths(rows, findings)
        if motion is not None:
            self._check_still_rates(motion, findings)
        evidence = Evidence(self._nominal, motion, rows)
        misfit = evidence.misfit() if motion is not None or rows is not None else np.nan
        for with_fewer in (without_cut_pulses, between_firings):
            if misfit > SUSPECT:
                fewer = with_fewer(evidence)
                if (left := fewer.misfit()) <= SUSPECT:
                    evidence, misfit = fewer, left
        if misfit > SUSPECT:
            evidence = with_swing(evidence)
            misfit = evidence.misfit()
        if misfit > SUSPECT:
            self._explain(evidence, misfit, findings)
        elif (best := self._likeliest(evidence)) and self._likeliest(between_firings(evidence)):
            findings.refuse_best(self._where, ONE_MOTION, misfit, best)
        self._check_on_times(findings)
        self._check_cells(findings)
        count = 0 if rows is None else len(rows.time_s)
        return Plausibility(count, misfit, self._content.hexdigest(), tuple(findings.sentences))

    def _check_cells(self, findings: Findings) -> None:
        """Refuse cells that do not fit, or say that they were left out."""
        if not self._cells:
            return
        count = len(self._cells)
        worst = sorted(self._cells, key=lambda cell: -abs(cell.sigmas))[:MOST_CELLS_NAMED]
        what = "1 cell that does" if count == 1 else f"{count} cells that do"
        said = f"{what} not fit: " + "; ".join(map(str, worst))
        if self._policy.leave_out:
            findings.sentences.append(f"{self._where}: left out {said}")
            return
        expected = "cells that fit those before and after them"
        fix = "empty the row's cells of that channel, or leave them out with --leave-out"
        findings.refuse("bad-cell", self._where, expected, said, fix)

    def _check_pulses(self, findings: Findings) -> None:
        if self._pulses.counted > 1:
            findings.refuse(
                "pulse-count",
                f"{self._where}: columns pulses_…",
                "every pulse counted once",
                f"counts that all grow by multiples of {self._pulses.counted}",
                f"divide them by {self._pulses.counted}",
            )

    def _check_on_times(self, findings: Findings) -> None:
        """No thruster fires for longer than time passes."""
        excess_s = self._on_times.excess_s
        if not len(excess_s) or excess_s.max() <= LEAST_EXCESS_S:
            return
        thruster = self._event.thrusters[int(np.argmax(excess_s))]
        findings.refuse(
            "on-time-unit",
            f"{self._where}: column on_time_{thruster}_s",
            "at most the time that passes between two readings",
            f"{excess_s.max():.6g} s more: on-times that look like ms",
            "give on_time_…_s in seconds",
        )

    def _check_widths(self, rows: Rows, findings: Findings) -> None:
        """No valve is open for less than some milliseconds, whatever tails could make up for."""
        on_time = rows.on_time_s[-1] - rows.on_time_s[0]
        pulses = rows.pulses[-1] - rows.pulses[0]
        if not are_too_short(on_time, pulses):
            return
        findings.refuse(
            "on-time-unit",
            f"{self._where}: columns on_time_…",
            f"pulses of at least {SHORTEST_PULSE_S:g} s on average",
            f"{on_time.sum():.4g} s in {pulses.sum():.0f} pulses: on-times that look like a longer"
            " unit than they are",
            "give on_time_…_s in seconds",
        )

    def _check_still_rates(self, motion: Motion, findings: Findings) -> None:
        """A rate that never changes tells nothing: refused where the attitude wobbles."""
        turns = turns_rad(motion.attitude)
        wobble = _detrended(np.cumsum(turns, axis=0), motion.time_s[1:])
        noise = np.sqrt(0.5 * np.mean(np.diff(turns, axis=0) ** 2, axis=0))
        still = np.ptp(motion.rate_rad_s, axis=0) == 0.0
        moves = np.abs(wobble).max(axis=0) > np.maximum(SILENT_SIGMAS * noise, LEAST_TURN_RAD)
        for axis in np.flatnonzero(still & moves):
            turned = np.abs(wobble[:, axis]).max()
            findings.refuse(
                "rate-silent",
                f"{self._where}: column rate_{AXES[axis]}_rad_s",
                f"the body rate of an attitude that turns to and fro by {turned:.3g} rad",
                f"{motion.rate_rad_s[0, axis]:.6g} in every row",
                "give the body rate about that axis",
            )

    def _likeliest(self, evidence: Evidence) -> tuple[Explanation, ...]:
        """Mistakes by how much likelier they make an event: of rates, or of wheels and counters."""
        event = self._event
        return likelier_rates(evidence) or likeliest(evidence, event.wheels, event.thrusters)

    def _explain(self, evidence: Evidence, misfit: float, findings: Findings) -> None:
        event, where = self._event, self._where
        sharper = with_noise_of_lags(evidence)
        found = list(explanations(sharper, event.wheels, event.thrusters))
        physical = min((each.score for each in found if each.mistake == PHYSICS), default=np.inf)
        misfit = min(misfit, physical)
        mistakes = [each for each in found if each.mistake != PHYSICS]
        best: tuple[Explanation, ...] = ()
        if misfit > SUSPECT:
            best = best_explanations(min(sharper.misfit(), physical), mistakes)
        best = best or self._likeliest(evidence)
        if best:
            best = with_scaled_rates(evidence, best)
            findings.refuse_best(where, ONE_MOTION, misfit, best)
            return
        if misfit <= SUSPECT:
            return
        balance = evidence.balance()
        share = 0.0
        if balance is not None and evidence.rows is not None:
            share = balance.open_nms / max(_exchanged(evidence.rows, evidence.nominal), 1e-9)
        said = f"{100.0 * share:.3g} % of the exchanged momentum unexplained"
        if share > OPEN:
            findings.refuse(
                "open-balance",
                where,
                "a momentum balance that closes at nominal values",
                f"{said} (misfit {misfit:.3g}); no single mistake of a channel explains it",
                "check kind, branch and wheels in event.toml, the columns' order, signs and"
                " units, and that the nominal values are this spacecraft's",
            )
        elif misfit >= UNKNOWN:
            findings.sentences.append(
                f"{where}: something that no catalogued effect and no single mistake of a channel"
                f" explains (misfit {misfit:.3g}, honest events stay below {UNKNOWN:g}; {said}):"
                " diagnose it"
            )


def check_telemetry(
    event: TelemetryEvent,
    chunks: Iterable[Chunk],
    spacecraft: Spacecraft,
    parameters: Mapping[str, float],
    policy: Policy = STRICT,
) -> Plausibility:
    """Collect and judge at once; see :class:`TelemetryCheck`."""
    check = TelemetryCheck(event, spacecraft, parameters, policy)
    for chunk in chunks:
        check.take(chunk)
    return check.verdict()


def _detrended(values: Array, time_s: Array) -> Array:
    design = np.stack([np.ones_like(time_s), time_s - time_s.mean()], axis=1)
    return np.asarray(values - design @ np.linalg.lstsq(design, values, rcond=None)[0])


def _exchanged(rows: Rows, nominal: Nominal) -> float:
    """Largest change of momentum that any kind of carrier shows, RMS over rows, N m s."""
    momenta = (
        rows.rate_rad_s @ nominal.inertia.T,
        nominal.of_wheels(rows.wheel_rpm),
        rows.on_time_s @ nominal.torques.T,
    )
    return max(
        float(np.sqrt(np.mean(np.sum((value - value.mean(axis=0)) ** 2, axis=1))))
        for value in momenta
    )
