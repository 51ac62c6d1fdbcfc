"""The diagnosis of printed on-times in words and tables: what is wrong, what remains, the gain.

Flight on-times are weighed against the ideal calculation; the ground software's own ideal column is
the negative control.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.case import NONE, UNKNOWN
from cassini_bayes.diagnosis.diagnosis import Diagnosis, diagnose
from cassini_bayes.diagnosis.on_time_case import OnTimeCase
from cassini_bayes.diagnosis.on_times import OnTimeHypothesis, read_on_times
from cassini_bayes.diagnosis.score import HeldOut
from cassini_bayes.diagnosis.verdict import CONFOUNDED_NATS, SECOND_CAUSE_NATS, Verdict, weigh
from cassini_bayes.effects.catalogue import read_catalogue
from cassini_bayes.events.totals import read_totals
from cassini_bayes.prediction.beliefs import read_beliefs
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.report.plots.on_times import on_time_figure
from cassini_bayes.spacecraft.parameters import THRUST_COMMON
from cassini_bayes.studies.published_sections import Section, by_width, in_words

SCALES: Final = ("tail_off", "pulse_shape", "thrust_scale")  # what scales all on-times alike
FIRING: Final = "firing_logic"


def on_time_section(totals: Path, priors: Path, seed: int, log: Log = silent) -> Section:
    """Weigh the flight's on-times of a totals file, and its ideal column as a control."""
    read = read_priors(priors)
    flight, ideal, calibrated = (
        _case(totals, read, source) for source in ("flight", "gsw_ideal", "gsw")
    )
    rng = np.random.default_rng(seed)
    diagnosis = diagnose(flight, rng, measure_gain=False, log=log)
    printed = {
        name: float(np.abs(case.data.printed_s - flight.data.printed_s).mean())
        for name, case in (("ideal", ideal), ("calibrated", calibrated))
    }
    control = weigh(ideal, np.random.default_rng(seed), pairs=False, log=log)
    return section_of(flight, diagnosis, printed, control, np.random.default_rng(seed))


def section_of(
    case: OnTimeCase,
    diagnosis: Diagnosis[OnTimeHypothesis],
    printed_s: Mapping[str, float],
    control: Verdict[OnTimeHypothesis],
    rng: np.random.Generator,
) -> Section:
    """A diagnosis in tables and paragraphs, its gain measured by leaving out each event in turn.

    ``printed_s``: mean absolute differences to flight of the ideal and the calibrated column, s.
    """
    verdict, first = diagnosis.verdict, diagnosis.verdict.best
    names = (NONE, *case.catalogue.names, UNKNOWN)
    sizes = {name: case.sizes(verdict.named(name), rng) for name in names}
    before, loose, after = (held_out(case, verdict, name) for name in (NONE, UNKNOWN, first.name))
    details = [
        _second(case, verdict),
        _gain(first.name, before, loose, after, printed_s),
        _by_unit(case, before, after),
        _control(control),
    ]
    probability, points = by_width(verdict, diagnosis.widths), points_of(case, before, after)
    factors = {w.name: verdict.log_bayes_factor(w) for w in verdict.weighed}
    return Section(
        "e",
        verdict,
        probability,
        {name: in_words(w, ".3g") for name, w in sizes.items()},
        _remains(case, diagnosis),
        "\n\n".join(details),
        on_time_figure(probability, factors, points),
    )


def held_out(case: OnTimeCase, verdict: Verdict[OnTimeHypothesis], name: str) -> HeldOut:
    """A hypothesis's predictions of every event from the others."""
    score = case.held_out(verdict.named(name), np.random.default_rng(0))
    assert score is not None  # there are events enough
    return score


def points_of(case: OnTimeCase, before: HeldOut, after: HeldOut) -> pd.DataFrame:
    """One row per printed on-time: event, on_time, flight_s, and the held-out predictions.

    Those of ``none`` and of the first cause (none_s, first_s) with half the width of their central
    90 % intervals (none_half_s, first_half_s).
    """
    units, flight = _unit_names(case), case.data.printed_s
    columns: dict[str, object] = {
        "event": np.repeat(case.event_ids, len(units)),
        "on_time": units * len(case.event_ids),
        "flight_s": flight.ravel(),
    }
    for prefix, score in (("none", before), ("first", after)):
        assert score.residual is not None
        assert score.half_width is not None
        columns[f"{prefix}_s"] = (flight - score.residual).ravel()
        columns[f"{prefix}_half_s"] = score.half_width.ravel()
    return pd.DataFrame(columns)


def _unit_names(case: OnTimeCase) -> list[str]:
    names = case.data.priors.spacecraft.thruster_names(case.data.priors.branch)
    return ["-".join(names[k].upper() for k in unit) for unit in case.data.layout.units]


def _case(totals: Path, priors: Priors, source: str) -> OnTimeCase:
    events = read_totals(totals, priors.spacecraft, source)
    catalogue = read_catalogue(priors, priors.wheels, ("on_times",))
    return OnTimeCase(read_on_times(events, priors, read_beliefs()), catalogue)


def _remains(case: OnTimeCase, diagnosis: Diagnosis[OnTimeHypothesis]) -> str:
    """p-value of the baseline, the group of the first cause, what is left after it."""
    verdict, first = diagnosis.verdict, diagnosis.verdict.best
    p_value = diagnosis.record["p_value"]
    p = "below 0.001" if p_value < 1e-3 else f"{p_value:.2g}"
    count = case.data.printed_s.size
    text = f"The baseline's p-value is {p} (χ² of its prior prediction, {count} on-times)."
    group = verdict.confounded_with(first.name)
    if first.is_cause:
        text += (
            f" Confounded with it: {', '.join(f'`{n}`' for n in group)}."
            if group
            else f" No other cause is within {CONFOUNDED_NATS:g} nats."
        )
        draws, _ = case.size_draws(first, np.random.default_rng(0))
        ends = {key: np.quantile(values, [0.05, 0.95]) for key, values in draws.items()}
        intervals = "; ".join(f"{k} [{low:.2g}, {high:.2g}]" for k, (low, high) in ends.items())
        text += f"\n\nCentral 90 % credible intervals: {intervals}."
    none, values = case.rmse(verdict.none), case.rmse(first)
    return f"{text} `none` leaves {none:.2f} s RMS at its mode, `{first.name}` {values:.2f} s."


def _second(case: OnTimeCase, verdict: Verdict[OnTimeHypothesis]) -> str:
    first = verdict.best
    gains = {
        pair.hypothesis.causes[1]: pair.mode.log_evidence - first.mode.log_evidence
        for pair in verdict.pairs
    }
    if not gains:
        return "No second cause was looked for."
    name = max(gains, key=lambda second: gains[second])
    if verdict.pair is not None:
        alike = f" (as good: {', '.join(verdict.equal_seconds)})" if verdict.equal_seconds else ""
        return f"Second cause: `{name}`, {gains[name]:+.1f} nats{alike}."
    space = first.hypothesis.space
    place = space.names.index(THRUST_COMMON)
    z, sd = first.mode.point[place], float(np.linalg.norm(first.mode.factor[place]))
    prior = space.distributions[place]
    low, mean, high = prior.quantile_of_standard(np.array([z - sd, z, z + sd]))
    assumed = float(case.data.thrust_n.mean())
    mean = mean + assumed - case.data.thrust_centre_n
    scales = ", ".join(f"`{n}` {gains[n]:+.1f}" for n in SCALES)
    return (
        f"Second cause: none. The best one beside `{first.name}`, `{name}`, gains "
        f"{gains[name]:+.1f} nats, where {SECOND_CAUSE_NATS:g} are required ({scales}).\n\n"
        f"With rectangular pulses the thrusters deliver {mean:.3f} ± {(high - low) / 2:.3f} N "
        f"(1 sd) per commanded second. The calculation assumes {assumed:.3f} ± {prior.sd():.2f} N."
    )


def _gain(
    first: str, before: HeldOut, loose: HeldOut, after: HeldOut, printed_s: Mapping[str, float]
) -> str:
    """Gain against ``none`` and, as that has far too small errors, against ``unknown``."""
    gain, noisy = after.gain_over(before), after.gain_over(loose)
    least = min((gain, noisy), key=lambda g: g.nats - 2.0 * g.standard_error)
    ratio = max(gain.rmse_ratio, noisy.rmse_ratio)
    verdict = replace(least, rmse_ratio=ratio).verdict
    miss = [float(np.abs(h.residual).mean()) for h in (before, after) if h.residual is not None]
    return f"""\
Held out: each of {len(before.log_scores)} events in turn. Verdict: {verdict}. Log
scores are summed, ± one standard error.

| model | `{first}` against it (nats) | RMS residual (s) | mean absolute (s) | in 90 % intervals |
| --- | --- | --- | --- | --- |
| `{first}` | – | {after.rmse:.2f} | {miss[1]:.2f} | {_percent(after)} % |
| `unknown`, its noise from all events | {noisy.nats:+.1f} ± {noisy.standard_error:.1f} \
| {loose.rmse:.2f} | – | – |
| `none`, whose errors are far too small | {gain.nats:+.0f} ± {gain.standard_error:.0f} \
| {before.rmse:.2f} | {miss[0]:.2f} | {_percent(before)} % |
| printed: ideal | – | – | {printed_s["ideal"]:.2f} | – |
| printed: calibrated on these flights | – | – | {printed_s["calibrated"]:.2f} | – |"""


def _percent(score: HeldOut) -> str:
    assert score.coverage_90 is not None
    return f"{100 * score.coverage_90:.0f}"


def _by_unit(case: OnTimeCase, before: HeldOut, after: HeldOut) -> str:
    """Held-out residuals of every printed on-time: mean and RMS over events, s."""
    columns = [
        figure
        for residual in (before.residual, after.residual)
        if residual is not None
        for figure in (residual.mean(0), np.sqrt((residual**2).mean(0)))
    ]
    rows = "\n".join(
        f"| {name} | {mean:+.2f} | {rms:.2f} | {own_mean:+.2f} | {own_rms:.2f} |"
        for name, mean, rms, own_mean, own_rms in zip(_unit_names(case), *columns, strict=True)
    )
    return f"""Flight less held-out prediction over the events, s:

| on-time | `none`: mean | RMS | first cause: mean | RMS |
| --- | --- | --- | --- | --- |
{rows}"""


def _control(verdict: Verdict[OnTimeHypothesis]) -> str:
    share = verdict.probabilities
    return (
        f"Negative control: with the printed ideal column in place of flight, "
        f"`{verdict.best.name}` is the most probable ({share[verdict.best.name]:.2f}). `{FIRING}` "
        f"has {share[FIRING]:.2g} (log Bayes factor "
        f"{verdict.log_bayes_factor(verdict.named(FIRING)):+.1f} nats)."
    )
