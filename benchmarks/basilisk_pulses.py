"""Whether the balance knows what pulses delivered in Basilisk's flights, to as well as it says.

Trials that kept their telemetry (``basilisk_closed_loop.py --trials … --keep``) have every firing
in their ``truth.json``, to the millisecond. What first-order valves deliver for these is known in
closed form (:mod:`closed_loop.valve`). The package sees counters only: rounded, every ten seconds,
of pulses that may have cut each other. It takes some on-time as delivered, and says how far that
may be off. This script looks at the difference, at the true parameters, over all rows and turns of
a flight: e, N m s. With V all that the linear model of rows and turns leaves open there, noise of
channels and a column for every rounding, cut tail and pair of unlike pulses, thrusts and parameters
free,

    eᵀ V⁻¹ e    is, if e is as large as stated,    Σ (1 − p_j (XᵀX + P)⁻¹_jj)

over these columns on average: how many of them the data tell. Far more than that is a fault of the
model. Nothing of the channels' data is used, so it shows faults that one flight's noise would hide.
The share of close pulses, which no truth has, is that of a few with which the figure is least.

It needs the package's environment and no Basilisk. Flights with late pulses in all rows are left
out: what is late has no columns.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from closed_loop import answers
from closed_loop.valve import Valve

from cassini_bayes.balance.linearised import Linear
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.threads import one_thread
from cassini_bayes.diagnosis.hypotheses import Hypothesis, none_hypothesis
from cassini_bayes.diagnosis.innovations import innovations, thrust_columns
from cassini_bayes.diagnosis.read import read_events
from cassini_bayes.diagnosis.rows_and_turns import BesideMode, side_by_side
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import MISTAKES, Policy
from cassini_bayes.spacecraft.attitude import direction_cosines

SHARE: Final = "close_pulse_share"
SHARES: Final = (0.003, 0.1, 0.3, 0.6)
FARTHEST: Final = 6.0  # standard values: a truth beyond a bound has none
NOISE: Final = ("rate_noise_rad_s", "wheel_noise_rpm", "attitude_noise_rad")
"""Parameters that a flight has as its conditions say, and not as drawn."""
SIGMAS: Final = 4.0  # above the mean, of χ² with as many degrees of freedom


@dataclass(frozen=True)
class Told:
    """eᵀ V⁻¹ e of a flight, what it should be, and the share of close pulses with which it is so.

    ``by_event`` is the same with the error of one event alone.
    """

    square: float
    expected: float
    share: float
    by_event: Mapping[str, float]

    @property
    def is_fault(self) -> bool:
        """Whether it is far above what it should be."""
        return self.square > self.expected + SIGMAS * np.sqrt(2.0 * self.expected) + SIGMAS


def delivered(term: Any, arms_m: Array, truth: Mapping[str, Any]) -> Array:
    """Angular momentum (n, 3) that an event's pulses have delivered at its rows, N m s."""
    event, parameters = term.event, truth["parameters"]
    flown = truth["events"][event.id]
    tau = [parameters[f"tau_{name}_s"] for name in ("delay", "rise", "fall")]
    samples, rows = event.samples, event.usable_rows
    read = samples.has_counters & samples.has_state
    read_s, attitude = samples.time_s[read], direction_cosines(samples.attitude[read])
    mean = 0.5 * (attitude[1:] + attitude[:-1])
    inertial = np.zeros((len(rows.time_s), 3))
    for k, thruster in enumerate(event.thrusters):
        pulses = flown["firings_ms"].get(thruster, [])
        if not pulses:
            continue
        valve = Valve(tuple((start, start + width) for start, width in pulses), *tau)
        by_interval = np.diff(valve.effective_s(read_s))
        torque = flown["thrust_n"][thruster] * arms_m[:, k]
        gained = by_interval[:, None] * np.einsum("iba,b->ia", mean, torque)
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(gained, axis=0)])
        place = np.searchsorted(read_s, rows.time_s + 1e-6, side="right") - 1
        since = valve.effective_s(rows.time_s) - valve.effective_s(read_s[place])
        now = np.einsum("iba,b->ia", rows.cosines, torque)
        inertial += sums[place] + since[:, None] * now
    return np.asarray(np.einsum("iab,ib->ia", rows.cosines, inertial))


def point_of(none: Hypothesis, truth: Mapping[str, Any], share: float) -> Array:
    """The truth in standard values (d,) of the baseline."""
    parameters = {**truth["parameters"], SHARE: share}
    parameters.update({name: truth["conditions"][name] for name in NOISE})
    space = none.model.space
    point = np.zeros(len(space.names))
    for i, name in enumerate(space.names):
        if name in parameters:
            point[i] = space.distributions[i].standard_of(parameters[name])
    return np.clip(point, -FARTHEST, FARTHEST)


def square_of(linear: Linear, gram: Array, error: Array) -> float:
    """eᵀ V⁻¹ e of whitened errors (m,) beside all columns of a linear model."""
    along = linear.columns.along(error)
    return float(error @ error - along @ np.linalg.solve(gram, along))


def told_of(folder: Path, events: Sequence[str], truth: Mapping[str, Any]) -> Told | None:
    """What a flight says with the likeliest share of close pulses; None with late pulses."""
    paths = [str(folder / name) for name in events]
    read = read_events(paths, folder / "priors.toml", policy=Policy(frozenset(MISTAKES)))
    none = none_hypothesis(read)
    terms = none.model.telemetry
    if any(term.balance.statistics.counters.has_late_pulses for term in terms):
        return None
    shares = SHARES if SHARE in none.model.space.names else SHARES[:1]
    return min((at_share(none, truth, share) for share in shares), key=lambda own: own.square)


def at_share(none: Hypothesis, truth: Mapping[str, Any], share: float) -> Told:
    """What a flight says with one share of close pulses."""
    point = point_of(none, truth, share)
    located = none.model.points(point[None])
    errors = []
    for place, term in enumerate(none.model.telemetry):
        arms = np.asarray(term.physics(located).arms_m).reshape(3, -1)
        thrusts = truth["events"][term.event.id]["thrust_n"]
        levels = np.array([thrusts[name] for name in term.event.thrusters])
        error = delivered(term, arms, truth) - thrust_columns(none, point, place) @ levels
        errors.append(error[:, :, None])
    beside = BesideMode.of(none, point, innovations(none, point))
    linear, white = beside.linear, beside.white(side_by_side(errors))  # a column for every event
    gram = linear.gram()
    by_event = {
        term.event.id: square_of(linear, gram, own)
        for term, own in zip(none.model.telemetry, white.T, strict=True)
    }
    walked = len(point) + none.model.thrust_prior.shared.shape[-1]
    told = 1.0 - linear.precision * np.diag(np.linalg.inv(gram))
    whole = square_of(linear, gram, white.sum(axis=1))
    return Told(whole, float(told[walked:].sum()), share, by_event)


def row_of(record: answers.Record, told: Told) -> dict[str, Any]:
    """A row of the table."""
    worst = max(told.by_event, key=lambda name: told.by_event[name])
    asked = ("controller", "counter_every_s", "counter_step_s", "rate_noise_rad_s")
    return {
        "trial": record["index"],
        **{name: record["conditions"][name] for name in asked},
        "square": round(told.square, 1),
        "expected": round(told.expected, 1),
        "close_pulse_share": told.share,
        "worst_event": worst,
        "square_of_it": round(told.by_event[worst], 1),
        "fault": told.is_fault,
    }


def told_of_trial(record: answers.Record, out: Path) -> Told | None:
    """What a trial says; None where nothing was kept, nothing fires, or pulses are late."""
    folder = out / f"{record['index']:05d}" / "record"
    events = [f"{i + 1}-{kind}" for i, kind in enumerate(record["conditions"]["events"])]
    fired = [name for name in events if name.endswith("bias")]
    if not fired or not folder.is_dir():
        return None
    truth = json.loads((folder / "truth.json").read_text("utf-8"))
    try:
        with one_thread():
            return told_of(folder, fired, truth)
    except InputError as refusal:
        print(f"{record['index']:05d}: {refusal}", file=sys.stderr)
        return None


def main() -> int:
    """Look at all trials of a folder; exit status 1 where there are none, 2 with a fault."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the trials")
    parser.add_argument("--table", type=Path, help="CSV file for a row of each")
    parser.add_argument("--trials", nargs="*", type=int, help="these alone")
    given = parser.parse_args()
    table = []
    for record in answers.read(given.out):
        asked = given.trials is None or record["index"] in given.trials
        told = told_of_trial(record, given.out) if asked else None
        if told is None:
            continue
        table.append(row := row_of(record, told))
        word = "  fault" if row["fault"] else ""
        print(
            f"{row['trial']:05d} {row['controller']}, counters every {row['counter_every_s']} s in "
            f"steps of {row['counter_step_s']} s: {row['square']}, expected {row['expected']}; "
            f"most in {row['worst_event']} ({row['square_of_it']}){word}",
            flush=True,
        )
    if not table:
        print(f"no flights with firings kept in {given.out}", file=sys.stderr)
        return 1
    faults = sum(row["fault"] for row in table)
    print(f"{len(table)} flights, {faults} of them far above what is expected")
    if given.table:
        with given.table.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(table[0]))
            writer.writeheader()
            writer.writerows(table)
    return 2 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
