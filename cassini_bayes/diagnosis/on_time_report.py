"""The diagnosis of printed on-times in words and tables: what is wrong, what remains, the gain.

Flight on-times are weighed against the ideal calculation; the ground software's own ideal column is
the negative control.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cassini_bayes.diagnosis.naming import CONFOUNDED_NATS
from cassini_bayes.diagnosis.on_time_verdict import (
    SECOND_NATS,
    HeldOut,
    OnTimeVerdict,
    held_out,
    score_difference,
    sizes,
    weigh_on_times,
)
from cassini_bayes.diagnosis.on_times import COMMON, OnTimeCase, on_time_case
from cassini_bayes.diagnosis.score import gain_verdict
from cassini_bayes.effects.catalogue import Catalogue, read_catalogue
from cassini_bayes.events.totals import read_totals
from cassini_bayes.prediction.beliefs import read_beliefs
from cassini_bayes.priors.reader import Priors, read_priors

Array = NDArray[np.float64]
Say = Callable[[str], None]
SCALES: Final = ("tail_off", "pulse_shape", "thrust_scale")  # what scales all on-times alike


@dataclass(frozen=True)
class OnTimeFindings:
    """A verdict as tables by cause (probability: columns are prior widths) and paragraphs.

    ``points`` has one row per printed on-time: event, on_time, flight_s, and the held-out
    prediction of ``none`` and of the first cause (none_s, first_s) with half the width of its
    central 90 % interval (none_half_s, first_half_s).
    """

    probability: pd.DataFrame
    log_bayes_factor: Mapping[str, float]
    log_evidence_se: Mapping[str, float]
    sizes: Mapping[str, str]
    remains: str
    details: str
    points: pd.DataFrame


def on_time_findings(
    totals: Path, priors: Path, seed: int, say: Say | None = None
) -> OnTimeFindings:
    """Weigh the flight's on-times of a totals file, and its ideal column as a control."""
    read = read_priors(priors)
    case = _case(totals, read, "flight")
    catalogue = read_catalogue(read, read.wheels, ("on_times",))
    verdict = weigh_on_times(case, catalogue, np.random.default_rng(seed), say)
    control = _case(totals, read, "gsw_ideal")
    printed = {
        source: float(np.abs(own.seen_s - case.seen_s).mean())
        for source, own in (("gsw_ideal", control), ("gsw", _case(totals, read, "gsw")))
    }
    found = findings_of(verdict, printed, np.random.default_rng(seed))
    return replace(found, details=f"{found.details}\n\n{_control(control, catalogue, seed, say)}")


def findings_of(
    verdict: OnTimeVerdict, printed_s: Mapping[str, float], rng: np.random.Generator
) -> OnTimeFindings:
    """A verdict in tables and paragraphs, its gain measured by leaving out each event in turn.

    ``printed_s``: mean absolute differences to flight of the columns gsw_ideal and gsw, s.
    """
    case, weighed = verdict.case, verdict.weighed
    table = pd.DataFrame(verdict.probability)
    order = sorted(table.index, key=lambda n: (-table.loc[n, 1.0], -weighed[str(n)].log_evidence))
    before, loose, after = (
        held_out(case, weighed[name]) for name in ("none", "unknown", verdict.first)
    )
    return OnTimeFindings(
        table.loc[order],
        {name: verdict.log_bayes_factor(name) for name in weighed},
        {name: own.log_evidence_se for name, own in weighed.items()},
        {name: _size_text(verdict, name, rng) for name in weighed},
        _remains(verdict),
        "\n\n".join(
            [
                _second(verdict),
                _gain(verdict.first, before, loose, after, printed_s),
                _by_unit(case, before, after),
            ]
        ),
        _points(case, before, after),
    )


def _points(case: OnTimeCase, before: HeldOut, after: HeldOut) -> pd.DataFrame:
    units = _unit_names(case)
    return pd.DataFrame(
        {
            "event": np.repeat(case.event_ids, len(units)),
            "on_time": units * len(case.event_ids),
            "flight_s": case.seen_s.ravel(),
            "none_s": (case.seen_s - before.residual_s).ravel(),
            "none_half_s": before.half_width_s.ravel(),
            "first_s": (case.seen_s - after.residual_s).ravel(),
            "first_half_s": after.half_width_s.ravel(),
        }
    )


def _unit_names(case: OnTimeCase) -> list[str]:
    names = case.priors.spacecraft.thruster_names(case.priors.branch)
    return ["-".join(names[k].upper() for k in unit) for unit in case.layout.units]


def _case(totals: Path, priors: Priors, source: str) -> OnTimeCase:
    events = read_totals(totals, priors.spacecraft, source)
    return on_time_case(events, priors, read_beliefs())


def _size_text(verdict: OnTimeVerdict, name: str, rng: np.random.Generator) -> str:
    own = sizes(verdict.weighed[name], rng)
    return "; ".join(f"{key} {s[0]:.3g} ± {s[1]:.2g}" for key, s in own.items())


def _remains(verdict: OnTimeVerdict) -> str:
    """p-value of the baseline, the group of the first cause, what is left after it."""
    first, y = verdict.weighed[verdict.first], verdict.case.seen_s
    p = "below 0.001" if verdict.p_value < 1e-3 else f"{verdict.p_value:.2g}"
    text = f"p-value of the baseline: {p} (χ² of its prior prediction, {y.size} on-times)."
    group = verdict.confounded_with(verdict.first)
    if verdict.first != "none":
        text += (
            f" Within {CONFOUNDED_NATS:g} nats of it: {', '.join(f'`{n}`' for n in group)}."
            if group
            else f" No other cause is within {CONFOUNDED_NATS:g} nats of it."
        )
        intervals = "; ".join(
            f"{key} [{s[2]:.2g}, {s[3]:.2g}]"
            for key, s in sizes(first, np.random.default_rng(0)).items()
        )
        if intervals:
            text += f" Central 90 % credible intervals: {intervals}."
    left = float(np.sqrt(((y - first.fit.mean) ** 2).mean()))
    none = float(np.sqrt(((y - verdict.weighed["none"].fit.mean) ** 2).mean()))
    return f"{text} At their modes `none` leaves {none:.2f} s RMS, `{verdict.first}` {left:.2f} s."


def _second(verdict: OnTimeVerdict) -> str:
    if verdict.second is None:
        return "No second cause was looked for."
    name = verdict.second.own.effects[1].name
    if verdict.second_nats >= SECOND_NATS:
        alike = f" (as good: {', '.join(verdict.second_alike)})" if verdict.second_alike else ""
        return f"Second cause: `{name}`, {verdict.second_nats:+.1f} nats{alike}."
    own = verdict.weighed[verdict.first]
    place = own.own.space.names.index(COMMON)
    z, sd = own.fit.mode[place], float(np.sqrt(own.fit.covariance[place, place]))
    prior = own.own.space.distributions[place]
    low, mean, high = prior.quantile_of_standard(np.array([z - sd, z, z + sd]))
    told = float(verdict.case.thrust_n.mean())
    mean = mean + told - verdict.case.thrust_centre_n
    scales = ", ".join(f"`{n}` {verdict.pair_nats[n]:+.1f}" for n in SCALES)
    return (
        f"Second cause: none. The best one beside `{verdict.first}`, `{name}`, gains "
        f"{verdict.second_nats:+.1f} nats ({scales}); {SECOND_NATS:g} are asked for. What the "
        f"thrusters give per commanded second is {mean:.3f} ± {(high - low) / 2:.3f} N (1 sd) with "
        f"rectangular pulses; the calculation is told {told:.3f} N, good "
        f"to {prior.sd():.2f} N."
    )


def _gain(
    first: str, before: HeldOut, loose: HeldOut, after: HeldOut, printed_s: Mapping[str, float]
) -> str:
    """Gain against ``none`` and, as that has far too small errors, against ``unknown``."""
    gain, error = score_difference(before, after)
    own, own_error = score_difference(loose, after)
    ratio = after.rmse_s / min(before.rmse_s, loose.rmse_s)
    least, its_error = min((gain, error), (own, own_error), key=lambda g: g[0] - 2.0 * g[1])
    verdict = gain_verdict(least, its_error, ratio)
    miss = [float(np.abs(h.residual_s).mean()) for h in (before, after)]
    return (
        f"Held out, each of {len(before.log_score)} events in turn: `{first}` {own:+.1f} ± "
        f"{own_error:.1f} nats against `unknown` (with its noise as all events have it) and "
        f"{gain:+.0f} ± {error:.0f} nats against `none`, whose errors are far too small (sums of "
        f"log scores, one standard error over events); RMS residual {after.rmse_s:.2f} s, "
        f"`unknown` {loose.rmse_s:.2f} s, `none` {before.rmse_s:.2f} s; mean absolute residual "
        f"{miss[1]:.2f} s, `none` {miss[0]:.2f} s: {verdict}. Central 90 % prediction intervals "
        f"hold {100 * after.coverage:.0f} % of the on-times, those of `none` "
        f"{100 * before.coverage:.0f} %. For comparison, mean absolute differences of printed "
        f"columns to flight: ideal {printed_s['gsw_ideal']:.2f} s, calibrated (tuned to these "
        f"flights) {printed_s['gsw']:.2f} s."
    )


def _by_unit(case: OnTimeCase, before: HeldOut, after: HeldOut) -> str:
    """Held-out residuals of every printed on-time: mean and RMS over events, s."""
    columns = [
        figure
        for own in (before, after)
        for figure in (own.residual_s.mean(0), np.sqrt((own.residual_s**2).mean(0)))
    ]
    rows = "\n".join(
        f"| {name} | {mean:+.2f} | {rms:.2f} | {own_mean:+.2f} | {own_rms:.2f} |"
        for name, mean, rms, own_mean, own_rms in zip(_unit_names(case), *columns, strict=True)
    )
    return f"""Flight less held-out prediction over the events, s:

| on-time | `none`: mean | RMS | first cause: mean | RMS |
| --- | --- | --- | --- | --- |
{rows}"""


def _control(case: OnTimeCase, catalogue: Catalogue, seed: int, say: Say | None) -> str:
    verdict = weigh_on_times(case, catalogue, np.random.default_rng(seed), say)
    own = verdict.probability[1.0]
    return (
        f"Negative control: the printed ideal column in place of flight gives `{verdict.first}` "
        f"({own[verdict.first]:.2f}), `firing_logic` {own['firing_logic']:.2g} (log Bayes factor "
        f"{verdict.log_bayes_factor('firing_logic'):+.1f} nats)."
    )
