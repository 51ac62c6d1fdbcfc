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
from cassini_bayes.studies.prediction.findings import COLUMNS, Findings

GOALS: Final[Mapping[str, float]] = {"on_time": 0.45, "delta_v_z": 0.5, "hydrazine": 0.8}


def skill_table(findings: Findings) -> str:
    """Mean absolute differences beside the published columns, and scores of the intervals."""
    units = findings.folds[0].prediction.units
    rows = [
        "| column | on-time [s] | pulses [count] | ΔVz [mm/s] | hydrazine [g] |",
        "| --- | --- | --- | --- | --- |",
    ]
    for source, label in COLUMNS.items():
        result = column_difference(findings.events, findings.columns[source], units)
        cells = [f"{result[kind]:.2f}" if kind in result else "–" for kind in KINDS]
        rows.append(f"| {label} | {' | '.join(cells)} |")
    differences = [f"**{findings.scores[kind].mean_absolute_difference:.2f}**" for kind in KINDS]
    rows.append(f"| **this prediction, event left out** | {' | '.join(differences)} |")
    goals = [f"≤ {GOALS[kind]:g}" if kind in GOALS else "–" for kind in KINDS]
    rows.append(f"| goal | {' | '.join(goals)} |")
    return "\n".join(rows)


def score_table(scores: Mapping[str, Skill]) -> str:
    """Coverage, interval score, CRPS and bias by kind."""
    rows = [
        "| kind | figures | median − flight, mean | coverage of 90 % intervals "
        "| interval score | CRPS |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for kind, s in scores.items():
        unit = KINDS[kind]
        rows.append(
            f"| {kind} [{unit}] | {s.items} | {s.bias:+.2f} | {100 * s.coverage:.0f} % "
            f"({round(s.coverage * s.items)} of {s.items}) "
            f"| {s.interval_score:.2f} | {s.crps:.2f} |"
        )
    return "\n".join(rows)


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
    rows = [
        "| event | nominal ΔVz [mm/s] | P(within 3 %) | flight − nominal [%] | spread [%] "
        f"| without {' | without '.join(SOURCES)} | spread of ΔVx, ΔVy [mm/s] |",
        f"| --- | --- | --- | --- | --- |{' --- |' * len(SOURCES)} --- |",
    ]
    for held in findings.folds:
        x, y, z = findings.requirement[held.event.id]
        assert held.event.delta_v_m_s is not None
        size = abs(z.nominal_m_s)
        missed = 100.0 * (held.event.delta_v_m_s[2] - z.nominal_m_s) / size
        left = " | ".join(f"{100 * z.without_m_s[source] / size:.1f} %" for source in SOURCES)
        rows.append(
            f"| {held.event.id} | {1e3 * z.nominal_m_s:.2f} | {100 * z.probability:.0f} % "
            f"| {missed:+.1f} | {100 * z.spread_m_s / size:.1f} % | {left} "
            f"| {1e3 * x.spread_m_s:.2f}, {1e3 * y.spread_m_s:.2f} |"
        )
    return "\n".join(rows)


def ground_table(findings: Findings, priors: Priors) -> tuple[str, str]:
    """The rebuilt ideal column beside the printed one, and the inputs that that implies."""
    printed = findings.columns["gsw_ideal"]
    nominal = prior_parameters(priors)
    implied = implied_parameters(printed, priors.spacecraft, priors.branch, nominal)
    rows = [
        "| inputs | on-time, mean difference [s] | largest [s] | ΔVz, mean [mm/s] "
        "| hydrazine, mean [g] | duration, mean [s] |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for label, parameters in (("as in the priors", nominal), ("implied", implied)):
        differences = []
        for event in printed:
            assert event.thrust_predicted_n is not None
            assert event.mass_kg is not None
            inputs = GroundInputs(
                priors.spacecraft,
                priors.branch,
                parameters,
                event.thrust_predicted_n,
                event.mass_kg,
            )
            g = ground_prediction(inputs, request_of(event))
            assert event.delta_v_m_s is not None
            assert event.hydrazine_g is not None
            units = findings.folds[0].prediction.units
            first = [unit[0] for unit in units]
            differences.append(
                [
                    *(g.on_time_s - event.on_time_s)[first],
                    1e3 * (g.delta_v_m_s[2] - event.delta_v_m_s[2]),
                    g.hydrazine_g - event.hydrazine_g,
                    g.duration_s - event.duration_s,
                ]
            )
        d = np.abs(np.array(differences))
        rows.append(
            f"| {label} | {d[:, :-3].mean():.3f} | {d[:, :-3].max():.2f} | {d[:, -3].mean():.3f} "
            f"| {d[:, -2].mean():.2f} | {d[:, -1].mean():.1f} |"
        )
    text = ["| input | implied | priors file |", "| --- | --- | --- |"]
    text += [
        f"| {name} | {implied[name]:.4f} | {nominal[name]:g} |"
        for name in implied
        if implied[name] != nominal[name]
    ]
    return "\n".join(rows), "\n".join(text)


def sensitivity_table(findings: Findings) -> str:
    """Skill with the priors of the firing logic halved and doubled."""
    rows = [
        "| widths of the firing logic's priors | on-time [s] | coverage | ΔVz [mm/s] "
        "| hydrazine [g] |",
        "| --- | --- | --- | --- | --- |",
    ]
    every = {"as stated": findings.scores, **findings.sensitivity}
    for label, scores in every.items():
        rows.append(
            f"| {label} | {scores['on_time'].mean_absolute_difference:.2f} "
            f"| {100 * scores['on_time'].coverage:.0f} % "
            f"| {scores['delta_v_z'].mean_absolute_difference:.2f} "
            f"| {scores['hydrazine'].mean_absolute_difference:.2f} |"
        )
    return "\n".join(rows)


def firing_table(findings: Findings) -> str:
    """Posterior of the firing logic in every fold, mean ± standard deviation."""
    rows = [f"| left out | {' | '.join(NAMES)} | effective draws | Pareto k̂ of the physics |"]
    rows.append(f"| --- |{' --- |' * len(NAMES)} --- | --- |")
    for held in findings.folds:
        cells = " | ".join(
            f"{np.mean(held.learned.firing[name]):.2g} ± {np.std(held.learned.firing[name]):.1g}"
            for name in NAMES
        )
        rows.append(
            f"| {held.event.id} | {cells} | {held.learned.effective_draws:.0f} "
            f"| {held.pareto_k:.2f} |"
        )
    return "\n".join(rows)
