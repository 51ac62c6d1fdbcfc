"""Simulated leaks before two monitors: delay, misses and names at equal false-alarm rates.

``cassini-bayes calibrate leaks`` flies wheel biases with parameters drawn from the priors and with
or without a leak (any thruster, 0.01 to 5 mN, any start), and writes ``docs/results/leaks.md``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.arrays import Array
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.report.plots.leaks import leak_figure, torque_figure
from cassini_bayes.studies.leak_attitudes import (
    CLEAR_SIGMA,
    LEAK_N,
    LEVER_M,
    STAY_S,
    after_turns,
    least_leaks,
    momentum_noise,
    turn_cells,
)
from cassini_bayes.studies.leak_monitors import Track, alarm_row
from cassini_bayes.studies.leak_trials import MODULE, WINDOWS_S, LeakTrials, Trial, trials_of
from cassini_bayes.studies.study import Study

FULL: Final[Mapping[str, int]] = {"trials": 800}
QUICK: Final[Mapping[str, int]] = {"trials": 60}
"""Numbers of biases, seven of ten with a leak."""
PERSISTENCE: Final = (1, 3)  # rows, ten seconds apart
FALSE_ALARMS: Final = 0.05  # per event
BINS_N: Final = np.array([1e-5, 1e-4, 3e-4, 1e-3, 5e-3])


@dataclass(frozen=True)
class Monitor:
    """A monitor and its persistence; a window of 0 stands for the sequential odds."""

    window_s: float
    persistence: int

    @property
    def label(self) -> str:
        """For the page."""
        what = f"threshold, {self.window_s:.0f} s" if self.window_s > 0.0 else "sequential odds"
        return f"{what}, {self.persistence} row{'s' if self.persistence > 1 else ''}"


MONITORS: Final = tuple(
    Monitor(window, rows) for window in (0.0, *WINDOWS_S) for rows in PERSISTENCE
)


def _track(trial: Trial, monitor: Monitor) -> Track:
    windows = (0.0, *WINDOWS_S)
    return trial.tracks[windows.index(monitor.window_s)]


def _reached(statistic: Array, persistence: int) -> float:
    """The highest threshold that would still be passed for so many rows in a row."""
    lowest = np.lib.stride_tricks.sliding_window_view(statistic, persistence).min(axis=1)
    return float(lowest.max())


def threshold_of(monitor: Monitor, quiet: Sequence[Trial]) -> float:
    """The threshold that a share :data:`FALSE_ALARMS` of events without a leak passes."""
    reached = [_reached(_track(trial, monitor).statistic, monitor.persistence) for trial in quiet]
    return float(np.quantile(reached, 1.0 - FALSE_ALARMS))


def judged(flown: Sequence[Trial]) -> pd.DataFrame:
    """One row per leak and monitor: found, delay from the leak's start, named rightly.

    Thresholds are set on the first half of the events without a leak; ``false_alarms`` is what the
    other half says of them. An alarm before the leak began counts as false, and as a miss.
    """
    quiet = [trial for trial in flown if trial.thruster < 0]
    half = len(quiet) // 2
    rows = []
    for monitor in MONITORS:
        threshold = threshold_of(monitor, quiet[:half])
        false = [
            _reached(_track(t, monitor).statistic, monitor.persistence) > threshold
            for t in quiet[half:]
        ]
        for trial in flown:
            if trial.thruster < 0:
                continue
            track = _track(trial, monitor)
            row = alarm_row(track.statistic, threshold, monitor.persistence)
            delay = np.nan if row is None else float(trial.time_s[row]) - trial.start_s
            result = row is not None and delay >= 0.0
            rows.append(
                {
                    "monitor": monitor.label,
                    "threshold": threshold,
                    "false_alarms": float(np.mean(false)) if false else np.nan,
                    "leak_n": trial.leak_n,
                    "found": result,
                    "delay_s": delay if result else np.nan,
                    "named": result and int(track.thruster[row or 0]) == trial.thruster,
                }
            )
    table = pd.DataFrame(rows)
    labels = [monitor.label for monitor in MONITORS]
    table["monitor"] = pd.Categorical(table["monitor"], labels, ordered=True)
    return table


def by_size(table: pd.DataFrame) -> pd.DataFrame:
    """Per monitor and bin of sizes: leaks, share found, median delay, share of found ones named."""
    bins = pd.cut(table["leak_n"], BINS_N, include_lowest=True)
    groups = table.groupby(["monitor", bins], observed=True)
    result = groups["found"].mean()
    return pd.DataFrame(
        {
            "leaks": groups.size(),
            "found": result,
            "delay_s": groups["delay_s"].median(),
            "named": groups["named"].mean() / result.where(result > 0.0),
        }
    ).reset_index()


BODY: Final = """\
Which monitor finds a leaking thruster sooner? {leaks} wheel biases with a leak and {quiet}
without are replayed row by row. Nothing here runs on board. Wheel rates lie within ±1,000
rev/min. Parameters are drawn from `{priors}`. The leak is of any of the eight thrusters, from
0.01 to 5 mN (log-uniform), and begins anywhere in the first four fifths. Noise levels are taken
as known.

Both monitors see the same residual momentum, every ten seconds, at rows where no thruster delivers.
Rates are those of the body's turn over seven rows at rest: at Cassini's noise of 1.3e-5 rad and
1.7e-5 rad/s, a measured rate knows ten times less.

- *Threshold* (paper 000 section IV): an alarm when the residual gained within a window passes a
  threshold for one or three rows in a row. The signs of its components name the thruster.
- *Sequential odds*: the log Bayes factor of a leak. Sizes are log-uniform, the start is even.
  Thrusts, centre of mass, inertias, geometry and pulse shape are uncertain.

The paper prints neither threshold nor window. Here each monitor has the threshold that {rate:.0%}
of one half of the events without a leak pass. *False alarms* are those of the other half ({half}
events).

| monitor | threshold | false alarms | found | named of found |
| --- | --- | --- | --- | --- |
{overall}

![Share of leaks found, and delay, by size]({name}.png)

| monitor | leak, mN | leaks | found | median delay, s | named of found |
| --- | --- | --- | --- | --- | --- |
{sizes}

{known}

Thresholds are in N m s for the residual and in nats for the odds. The monitor of residuals knows
of no uncertainty: its threshold has to stand above all that thrusts and tails leave in a whole
bias when they are off by their widths. The odds know which part of a residual the thrusts
explain. At rest between biases little fires, and a threshold could stand far lower. That is not
simulated here.

## A leak and a steady torque

At one attitude a leak and a steady torque are the same: both add momentum in one fixed direction.
A turn does not part them if the torque turns with the body, as the model's own `external_torque`
does. Only the torque's prior width and the leak's sign and direction are left to tell them apart.

A torque fixed in inertial axes, as of the Sun or of gravity, parts from the leak once the body
turns by ψ across it. No inertial torque and no start explain τ (t − t₁) 2 sin(ψ/2) less its
likeliest line in t. The table is for a leak of {leak:g} mN (lever {lever:g} m) and {stay:.0f} s
at the first attitude. Rows are ten seconds apart, with {row:.2g} N m s of noise (as above) and
torque noise of {walk:.2g} N m s^½:

{parted}

![A leak and a torque fixed in inertial axes, told apart by a turn]({name}-torque.png)

Left: that leak, against time at the second attitude. Right: the least leak that is {clear:g} σ from
every such torque, against the turn, for stays of equal length before and after it. Without a turn
there is none, however long the stay.
"""

TITLE: Final = {
    False: "Leaks: the residual-momentum monitor beside sequential odds",
    True: "Leaks with calibrated thrusters",
}
KNOWN: Final = {
    False: "Thrusts, pulses and centre of mass have the widths of the priors file. Nothing has been"
    " calibrated, which is hardest for the threshold.",
    True: "Thrusts, pulses and centre of mass are calibrated: a tenth of the priors file's widths.",
}


def body(table: pd.DataFrame, quiet: int, priors: Path, name: str, calibrated: bool) -> str:
    """Text of the page ``name`` of a judged campaign; ``quiet`` events had no leak."""
    overall, sizes = [], []
    for label, rows in table.groupby("monitor", observed=True):
        result = rows["found"].mean()
        named = rows["named"].sum() / max(rows["found"].sum(), 1)
        first = rows.iloc[0]
        overall.append(
            f"| {label} | {first['threshold']:.3g} | {first['false_alarms']:.1%} | {result:.1%}"
            f" | {named:.1%} |"
        )
    patient = [monitor.label for monitor in MONITORS if monitor.persistence == max(PERSISTENCE)]
    shown = by_size(table)
    for row in shown[shown["monitor"].isin(patient)].to_dict(orient="records"):
        low, high = 1e3 * row["leak_n"].left, 1e3 * row["leak_n"].right
        delay = "" if np.isnan(row["delay_s"]) else f"{row['delay_s']:.0f}"
        named = "" if np.isnan(row["named"]) else f"{row['named']:.0%}"
        sizes.append(
            f"| {row['monitor']} | {max(low, 0.01):.2g} to {high:.2g} | {row['leaks']}"
            f" | {row['found']:.0%} | {delay} | {named} |"
        )
    return BODY.format(
        leaks=len(table) // len(MONITORS),
        quiet=quiet,
        half=quiet - quiet // 2,
        priors=priors,
        rate=FALSE_ALARMS,
        name=name,
        known=KNOWN[calibrated],
        overall="\n".join(overall),
        sizes="\n".join(sizes),
        **_apart(read_priors(priors)),
    )


def _apart(priors: Priors) -> dict[str, Any]:
    """What the text says of a leak and a torque."""
    noise = momentum_noise(priors)
    head = f"| turn | until {CLEAR_SIGMA:g} σ, s after it | σ {STAY_S:.0f} s after it |"
    rows = [
        f"| {turn:.0f}° | {'never' if np.isnan(after) else f'{after:.0f}'} | {sigma:.1f} |"
        for turn, after, sigma in turn_cells(after_turns(noise))
    ]
    return {
        "leak": 1e3 * LEAK_N,
        "lever": LEVER_M,
        "stay": STAY_S,
        "row": noise.row_n_m_s,
        "walk": noise.walk_n_m_s05,
        "clear": CLEAR_SIGMA,
        "parted": "\n".join([head, "| --- | --- | --- |", *rows]),
    }


def compare_leak_monitors(
    study: Study, scenario: Path, priors: Path, numbers: Mapping[str, int], *, calibrated: bool
) -> None:
    """Fly what is missing, judge, write page, table and figure; ``numbers`` as :data:`FULL`.

    ``calibrated``: the thrusters are known, see :class:`LeakTrials`.
    """
    campaign = LeakTrials(scenario, priors, calibrated, seed=study.seed)
    name = study.page.stem
    flown = trials_of(study.repeat(name, "biases", campaign, numbers["trials"]))
    quiet = sum(trial.thruster < 0 for trial in flown)
    table = judged(flown)
    sizes, noise = by_size(table), momentum_noise(read_priors(priors))
    study.publish(
        TITLE[calibrated],
        body(table, quiet, priors, name, calibrated),
        MODULE,
        {"": sizes},
        {"": leak_figure(sizes), "-torque": torque_figure(after_turns(noise), least_leaks(noise))},
    )
