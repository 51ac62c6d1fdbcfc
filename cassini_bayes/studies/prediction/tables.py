"""Tables of the results page, as markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.prediction.firing import NAMES
from cassini_bayes.prediction.ground_software import (
    GroundInputs,
    ground_prediction,
    implied_parameters,
    prior_parameters,
)
from cassini_bayes.prediction.leave_one_out import KINDS, Skill, column_difference
from cassini_bayes.prediction.predict import SOURCES
from cassini_bayes.prediction.requests import request_of
from cassini_bayes.priors.reader import Priors
from cassini_bayes.report.study_page import markdown_table, table_of
from cassini_bayes.studies.prediction.findings import COLUMNS, Findings

GOALS: Final[Mapping[str, float]] = {"on_time": 0.45, "delta_v_z": 0.5, "hydrazine": 0.8}


def skill_table(findings: Findings) -> str:
    """Mean absolute differences beside the published columns, and scores of the intervals."""
    units = findings.folds[0].prediction.units
    rows = []
    for source, label in COLUMNS.items():
        result = column_difference(findings.events, findings.columns[source], units)
        rows.append([label, *(f"{result[k]:.2f}" if k in result else "–" for k in KINDS)])
    ours = (f"**{findings.scores[kind].mean_absolute_difference:.2f}**" for kind in KINDS)
    goals = (f"≤ {GOALS[kind]:g}" if kind in GOALS else "–" for kind in KINDS)
    rows += [["**this prediction, event left out**", *ours], ["goal", *goals]]
    head = ("column", "on-time [s]", "pulses [count]", "ΔVz [mm/s]", "hydrazine [g]")
    return markdown_table(head, rows)


def score_table(scores: Mapping[str, Skill]) -> str:
    """Coverage, interval score, CRPS and bias by kind."""
    return table_of(
        (
            {
                "kind": kind,
                "unit": KINDS[kind],
                "s": s,
                "percent": 100 * s.coverage,
                "held": round(s.coverage * s.items),
            }
            for kind, s in scores.items()
        ),
        "kind | figures | median − flight, mean | coverage of 90 % intervals"
        " | interval score | CRPS",
        "{kind} [{unit}] | {s.items} | {s.bias:+.2f} | {percent:.0f} % ({held} of {s.items})"
        " | {s.interval_score:.2f} | {s.crps:.2f}",
    )


def event_table(findings: Findings) -> str:
    """Flight and prediction of every held-out event."""
    names = findings.folds[0].prediction.unit_names()
    head = " | ".join(name.upper().replace("_", "–") for name in names)
    rows = [
        f"| event | | {head} | ΔVz [mm/s] | hydrazine [g] | duration [s] |",
        f"| --- | --- |{' --- |' * len(names)} --- | --- | --- |",
    ]
    for held in findings.folds:
        p, event = held.prediction, held.event
        first = [unit[0] for unit in p.units]
        assert p.delta_v_computed_m_s is not None
        assert p.hydrazine_g is not None
        assert event.delta_v_m_s is not None
        flight = [*event.on_time_s[first], 1e3 * event.delta_v_m_s[2], event.hydrazine_g]
        cells = " | ".join(f"{value:.2f}" for value in flight)
        rows.append(f"| {event.id} | flight | {cells} | {event.duration_s:.0f} |")
        draws = [*p.unit_on_time_s().T, 1e3 * p.delta_v_computed_m_s[:, 2], p.hydrazine_g]
        cells = " | ".join(_interval(values) for values in draws)
        rows.append(f"| | predicted | {cells} | {_interval(p.duration_s, 0)} |")
    return "\n".join(rows)


def _interval(draws: Array, digits: int = 2) -> str:
    low, median, high = np.quantile(draws, [0.05, 0.5, 0.95])
    return f"{median:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def requirement_table(findings: Findings) -> str:
    """The ΔV requirement per event, with the spread that is left without each source."""
    rows = []
    for held in findings.folds:
        x, y, z = findings.requirement[held.event.id]
        assert held.event.delta_v_m_s is not None
        size = abs(z.nominal_m_s)
        missed = 100.0 * (held.event.delta_v_m_s[2] - z.nominal_m_s) / size
        spreads = (z.spread_m_s, *(z.without_m_s[source] for source in SOURCES))
        row = (held.event.id, f"{1e3 * z.nominal_m_s:.2f}", f"{100 * z.probability:.0f} %")
        percent = (f"{100 * spread / size:.1f} %" for spread in spreads)
        beside = f"{1e3 * x.spread_m_s:.2f}, {1e3 * y.spread_m_s:.2f}"
        rows.append([*row, f"{missed:+.1f}", *percent, beside])
    head = ("event", "nominal ΔVz [mm/s]", "P(within 3 %)", "flight − nominal [%]", "spread [%]")
    without = (f"without {source}" for source in SOURCES)
    return markdown_table((*head, *without, "spread of ΔVx, ΔVy [mm/s]"), rows)


def ground_table(findings: Findings, priors: Priors) -> tuple[str, str]:
    """The rebuilt ideal column beside the printed one, and the inputs that that implies."""
    printed = findings.columns["gsw_ideal"]
    nominal = prior_parameters(priors)
    implied = implied_parameters(printed, priors.spacecraft, priors.branch, nominal)
    first = [unit[0] for unit in findings.folds[0].prediction.units]
    rows = []
    for label, parameters in (("as in the priors", nominal), ("implied", implied)):
        differences = []
        for event in printed:
            assert event.thrust_predicted_n is not None
            assert event.mass_kg is not None
            assert event.delta_v_m_s is not None
            assert event.hydrazine_g is not None
            known = (parameters, event.thrust_predicted_n, event.mass_kg)
            inputs = GroundInputs(priors.spacecraft, priors.branch, *known)
            g = ground_prediction(inputs, request_of(event))
            differences.append(
                [
                    *(g.on_time_s - event.on_time_s)[first],
                    1e3 * (g.delta_v_m_s[2] - event.delta_v_m_s[2]),
                    g.hydrazine_g - event.hydrazine_g,
                    g.duration_s - event.duration_s,
                ]
            )
        d = np.abs(np.array(differences))
        on_time, (speed, hydrazine, duration) = d[:, :-3], d[:, -3:].mean(axis=0)
        mean = (f"{on_time.mean():.3f}", f"{on_time.max():.2f}", f"{speed:.3f}")
        rows.append([label, *mean, f"{hydrazine:.2f}", f"{duration:.1f}"])
    head = ("inputs", "on-time, mean difference [s]", "largest [s]", "ΔVz, mean [mm/s]")
    inferred = (
        [name, f"{value:.4f}", f"{nominal[name]:g}"]
        for name, value in implied.items()
        if value != nominal[name]
    )
    return (
        markdown_table((*head, "hydrazine, mean [g]", "duration, mean [s]"), rows),
        markdown_table(("input", "implied", "priors file"), inferred),
    )


def sensitivity_table(findings: Findings) -> str:
    """Skill with the priors of the firing logic halved and doubled."""
    every = {"as stated": findings.scores, **findings.sensitivity}
    return table_of(
        (
            {"label": label, "covered": 100 * scores["on_time"].coverage, **scores}
            for label, scores in every.items()
        ),
        "widths of the firing logic's priors | on-time [s] | coverage | ΔVz [mm/s] | hydrazine [g]",
        "{label} | {on_time.mean_absolute_difference:.2f} | {covered:.0f} %"
        " | {delta_v_z.mean_absolute_difference:.2f} | {hydrazine.mean_absolute_difference:.2f}",
    )


def firing_table(findings: Findings) -> str:
    """Posterior of the firing logic in every fold, mean ± standard deviation."""
    rows = []
    for held in findings.folds:
        draws = (held.learned.firing[name] for name in NAMES)
        cells = (f"{np.mean(values):.2g} ± {np.std(values):.1g}" for values in draws)
        quality = (f"{held.learned.effective_draws:.0f}", f"{held.pareto_k:.2f}")
        rows.append([held.event.id, *cells, *quality])
    head = ("left out", *NAMES, "effective draws", "Pareto k̂ of the physics")
    return markdown_table(head, rows)
