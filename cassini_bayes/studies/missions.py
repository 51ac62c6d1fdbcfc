"""Results of the trend on simulated missions: names, onsets, false alarms, delays beside two rules.

The rules are those that paper 003 and process control use on single-bias estimates: the ratio of
the mean of the last four to that of the first four, and a one-sided CUSUM. Every rule gets the
threshold at which one mission in twenty has a false alarm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array, Flags
from cassini_bayes.report.study_page import markdown_table, table_of
from cassini_bayes.results.ranks import envelope_p_values, holm
from cassini_bayes.studies.blind.rates import interval
from cassini_bayes.studies.mission_flights import MODULE, MissionFlights
from cassini_bayes.studies.study import Study

Arrays = Mapping[str, NDArray[Any]]
MISSIONS: Final = "missions"
FULL: Final[Mapping[str, int]] = {MISSIONS: 300}
QUICK: Final[Mapping[str, int]] = {MISSIONS: 24}
FALSE_ALARMS: Final = 0.05  # per mission, at which the rules are compared
ALARM: Final = 0.95
LARGE: Final = 0.10  # loss from which the right thruster has to be named
ENOUGH: Final = 3  # biases that fired a thruster since it failed
AVERAGED: Final = 4  # biases, paper 003 averages 4 to 5
LEAST_P: Final = 0.01  # of ranks, adjusted
SCATTER: Final = 0.03  # of one estimate, relative, for the CUSUM
SLACK: Final = 0.5  # of the CUSUM, in standard deviations


@dataclass(frozen=True)
class MissionFindings:
    """Rates over simulated missions; counts are (hits, cases)."""

    missions: int
    converged: int
    looks: tuple[int, int]  # whose draws are no result
    named: tuple[int, int]  # failing thrusters of large losses with an alarm at the end
    in_time: tuple[int, int]  # of those that enough biases have fired since
    near: tuple[int, int]  # of the named, onset within one bias that fired the thruster
    oracle_near: tuple[int, int]
    false_alarms: tuple[int, int]  # missions with an alarm of a (yet) healthy thruster
    rules: pd.DataFrame  # detection and delay of every rule at equal false alarms
    rank_p: Mapping[str, float]  # of ranks against uniform ones, adjusted by Holm


def ratio_of_ends(estimates: Array) -> Array:
    """Loss by the ratio of the last four estimates to the first four, (E, K), from E on."""
    result = np.zeros_like(estimates)
    for k in range(estimates.shape[1]):
        seen = np.flatnonzero(np.isfinite(estimates[:, k]))
        values = estimates[seen, k]
        for i in range(AVERAGED + 1, len(seen) + 1):
            last = values[max(AVERAGED, i - AVERAGED) : i].mean()
            result[seen[i - 1] :, k] = 1.0 - last / values[:AVERAGED].mean()
    return result


def cusum(estimates: Array) -> Array:
    """One-sided CUSUM (E, K) of estimates below the mean of the first four."""
    result = np.zeros_like(estimates)
    for k in range(estimates.shape[1]):
        seen = np.flatnonzero(np.isfinite(estimates[:, k]))
        if len(seen) <= AVERAGED:
            continue
        start, total = estimates[seen[:AVERAGED], k].mean(), 0.0
        for place in seen[AVERAGED:]:
            lower = (start - estimates[place, k]) / (SCATTER * start)
            total = max(0.0, total + lower - SLACK)
            result[place:, k] = total
    return result


RULES: Final[Mapping[str, Callable[[Array, Array], Array]]] = {
    "posterior odds": lambda _, chances: chances,
    "ratio of first to last": lambda estimates, _: ratio_of_ends(estimates),
    "CUSUM": lambda estimates, _: cusum(estimates),
}


def findings_of(found: Arrays) -> MissionFindings:
    """Rates of all missions, arrays as :meth:`MissionFlights.repetition` gives them, stacked."""
    failed, share, chances = found["failed"], found["share"], found["chances"]
    last = np.array([[_last(branch) for branch in mission] for mission in chances])
    large = (failed >= 0) & (share >= LARGE)
    named = large & (last > ALARM)
    since = found["fired"] & ~healthy(failed, chances.shape[2])
    in_time = large & (since.sum(2) >= ENOUGH)
    alarm = (chances > ALARM) & healthy(failed, chances.shape[2])
    return MissionFindings(
        missions=len(failed),
        converged=int(found["converged"].sum()),
        looks=(int(found["untrusted"].sum()), int(found["looks"].sum())),
        named=(int(named.sum()), int(large.sum())),
        in_time=(int((named & in_time).sum()), int(in_time.sum())),
        near=_near(found, named, "onset"),
        oracle_near=_near(found, named, "oracle"),
        false_alarms=(int(alarm.any((1, 2, 3)).sum()), len(failed)),
        rules=compare_rules(found),
        rank_p=_rank_p(found),
    )


def healthy(failed: Array, events: int) -> Flags:
    """Which thrusters (…, E, K) are healthy at each event: not failing (−1), or not yet."""
    onset = np.where(failed < 0, events, failed)[..., None, :]
    return np.asarray(np.arange(events)[:, None] < onset)


def _last(chances: Array) -> Array:
    """Probabilities (K,) at the last event that was looked at."""
    looked = np.flatnonzero(chances.any(-1))
    return chances[looked[-1]] if len(looked) else np.zeros(chances.shape[-1])


def _near(found: Arrays, chosen: Flags, which: str) -> tuple[int, int]:
    """How many onsets are at most one bias that fired the thruster away from the truth."""
    hits = 0
    places = np.argwhere(chosen)
    for i, j, k in places:
        a, b = sorted((int(found[which][i, j, k]), int(found["failed"][i, j, k])))
        hits += int(found["fired"][i, j, a:b, k].sum() <= 1 and a >= 0)
    return hits, len(places)


def compare_rules(found: Arrays) -> pd.DataFrame:
    """Threshold, detection and delay (in biases of the branch) of each rule."""
    failed, share, events = found["failed"], found["share"], found["events"].astype(int)
    rows = []
    for name, rule in RULES.items():
        paths = np.zeros(found["chances"].shape)
        for i, j in np.ndindex(events.shape):
            n = events[i, j]
            paths[i, j, :n] = rule(found["estimates"][i, j, :n], found["chances"][i, j, :n])
        steady = np.where(healthy(failed, found["chances"].shape[2]), paths, 0.0)
        highest = steady.reshape(len(paths), -1).max(1)
        threshold = float(np.quantile(highest, 1.0 - FALSE_ALARMS))
        delays = []
        for i, j, k in np.argwhere((failed >= 0) & (share >= LARGE)):
            onset = int(failed[i, j, k])
            above = np.flatnonzero(paths[i, j, onset : events[i, j], k] > threshold)
            delays.append(float(above[0]) if len(above) else np.inf)
        rows.append(
            {
                "rule": name,
                "threshold": threshold,
                "detected": float(np.isfinite(delays).mean()) if delays else np.nan,
                "median_delay_biases": float(np.median(delays)) if delays else np.nan,
                "mean_delay_of_detected": float(np.mean([d for d in delays if np.isfinite(d)]))
                if np.isfinite(delays).any()
                else np.nan,
            }
        )
    return pd.DataFrame(rows)


def _rank_p(found: Arrays) -> dict[str, float]:
    """Uniformity of ranks, adjusted by Holm: of what was walked, of slopes, of onsets.

    Onsets are those of thrusters that failed: their number is another one.
    """
    onsets = found["onset_rank"][np.isfinite(found["onset_rank"])]
    names = [*found["names"][0], "A slope", "B slope", "onset"]
    columns = np.concatenate([found["ranks"], found["slope_rank"]], axis=1)
    p_values = [*envelope_p_values(columns), *envelope_p_values(onsets[:, None])]
    return dict(zip(names, holm(p_values).tolist(), strict=True))


def study_missions(study: Study, events: Path, priors: Path, numbers: Mapping[str, int]) -> bool:
    """Fly and fit missions that are not kept yet, and write the page. Returns whether it passes.

    ``numbers`` are missions as in :data:`FULL`.
    """
    flights = MissionFlights(events, priors, seed=study.seed)
    findings = findings_of(study.repeat(MISSIONS, MISSIONS, flights, numbers[MISSIONS]))
    study.publish("Simulated missions", body_of(findings), MODULE, {"": findings.rules}, {})
    return passes(findings)


def passes(findings: MissionFindings) -> bool:
    """The requirements: names, onsets, false alarms, earlier than either rule, uniform ranks."""
    delay = findings.rules.set_index("rule")["median_delay_biases"]
    return bool(
        _rate(findings.named) >= 0.95
        and _rate(findings.near) >= 0.9 * _rate(findings.oracle_near)
        and _rate(findings.false_alarms) <= FALSE_ALARMS
        and delay["posterior odds"] < delay.drop("posterior odds").min()
        and min(findings.rank_p.values()) > LEAST_P
    )


def _rate(counts: tuple[int, int]) -> float:
    return counts[0] / counts[1] if counts[1] else float("nan")


def body_of(findings: MissionFindings) -> str:
    """Text of the results page below its heading."""
    rules = table_of(
        findings.rules,
        "rule | threshold | detected | median delay (biases) | mean delay of those detected",
        "{rule} | {threshold:.3g} | {detected:.0%} | {median_delay_biases:.1f}"
        " | {mean_delay_of_detected:.1f}",
    )
    ranks = markdown_table(
        ("what", "p"), ((name, f"{p:.2g}") for name, p in findings.rank_p.items())
    )
    return f"""\
Does the trend of a mission name a failing thruster, and in time? Each of the {findings.missions}
missions has 20 to 60 biases, a recharge and a swap of branches. Everything is drawn from the
priors, failures among it: up to two thrusters of each branch fail. Biases are made as totals
rows; no telemetry is used here.

A mission is looked at after every second bias, from its sixth or seventh on. The first and the
last look are fits of their own: {findings.converged} of the last ones converged. Looks in between
weigh one pool of points, which grows with the mission and has the same posterior:
{findings.looks[0]} of {findings.looks[1]} had too few effective draws.

{_verdict(findings)} 95 % intervals are in brackets.

| what | figure | goal |
| --- | --- | --- |
| thruster with a loss of 10 % or more has an alarm | {_text(findings.named)} | 95 % |
| the same where {ENOUGH} biases or more have fired it since | {_text(findings.in_time)} | |
| onset of the named within one bias that fired it | {_text(findings.near)} | 90 % of the oracle's |
| the same for one who knows all but the onset | {_text(findings.oracle_near)} | |
| missions with a false alarm at any look | {_text(findings.false_alarms)} | at most 5 % |

An alarm is a probability of loss above {ALARM}. It is false if the thruster does not fail, or has
not failed yet. The next table compares rules at equal false alarms, one mission in twenty, for
losses of 10 % or more. A delay of *inf* means that less than half are detected.

{rules}

Are ranks of the truth among posterior draws uniform? p by a simultaneous envelope, after Holm's
correction; goal: above {LEAST_P}.

{ranks}

An estimate from the totals of one bias rests on three equations. So the other two rules see a
failing thruster through the scatter of its neighbours. With the time history of a bias they would
do better.
"""


def _verdict(findings: MissionFindings) -> str:
    """Whether the figures themselves are at or beyond all goals."""
    return f"All goals are {'reached' if passes(findings) else '**not** reached'} by the figures."


def _text(counts: tuple[int, int]) -> str:
    """A rate with its central 95 % interval (Clopper-Pearson)."""
    hits, cases = counts
    if not cases:
        return "no case"
    low, high = interval(hits, cases)
    return f"{hits} of {cases}: {hits / cases:.0%} ({low:.0%} to {high:.0%})"
