"""A torque that all events share: named beyond the baseline's prior, and not within it."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from datetime import timedelta
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from event_cases import eased

from cassini_bayes.diagnosis.case import Beginning, Weighed
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.evidence import by_laplace
from cassini_bayes.diagnosis.hypotheses import Hypothesis, compact, extend, none_hypothesis
from cassini_bayes.diagnosis.modes import Mode, find_mode
from cassini_bayes.diagnosis.shared_torque import gain_of_width, torque_again
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.blind.flights import reduced
from cassini_bayes.studies.scenario import simulate_file

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
FINE = {"rate_noise_rad_s": 2.0e-6, "wheel_noise_rpm": 0.05}
OFF = 2.5  # prior standard deviations that the torque of all events is off about every axis


def test_the_gain_of_a_width_is_that_of_an_integral() -> None:
    """Of a normal likelihood, by sums over a grid, one axis at a time."""
    grid = np.linspace(-8.0, 8.0, 160_001)
    for centre, sd, width in ((0.9, 0.3, 0.1), (-0.4, 0.05, 0.3), (2.0, 1.0, 1.0)):
        likelihood = np.exp(-0.5 * ((grid - centre) / sd) ** 2)
        posterior = likelihood * np.exp(-0.5 * grid**2)
        mean = (grid * posterior).sum() / posterior.sum()
        variance = ((grid - mean) ** 2 * posterior).sum() / posterior.sum()
        prior = np.exp(-0.5 * (grid / width) ** 2)
        at_zero = np.exp(-0.5 * (centre / sd) ** 2)
        wanted = np.log((likelihood * prior).sum() / prior.sum() / at_zero)
        found = gain_of_width(np.array([mean]), np.array([[variance]]), np.array([width]))
        assert found == pytest.approx(wanted, abs=1e-6)


@cache
def events() -> Events:
    """Two short sets of slews, fine rates, and a torque far out in its prior, the same in both."""
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    slews = next(e for e in document["event"] if e["id"] == "slews")
    later = slews["epoch"] + timedelta(days=3)
    document["event"] = [slews, {**slews, "id": "again", "epoch": later}]
    document["truth"] |= FINE
    for axis in "xyz":
        name = f"external_torque_{axis}_n_m"
        prior = priors.parameters[name].distribution
        assert prior is not None
        document["truth"][name] = prior.mean() + OFF * prior.sd()
    simulation = simulate_file(scenario_of(eased(document), SCENARIO.parent), 3, priors=priors)
    return reduced(simulation, priors)


def weighed(hypothesis: Hypothesis) -> Weighed[Hypothesis]:
    """By a search from the prior's centre."""
    return by_laplace(hypothesis, find_mode(hypothesis.log_density, hypothesis.dimension))


@cache
def both() -> tuple[Weighed[Hypothesis], Weighed[Hypothesis], Weighed[Hypothesis]]:
    """The baseline, the cause, and a torque as wide as the baseline believes of one event."""
    full, torque = none_hypothesis(events()), events().catalogue.effect("external_torque")
    tenth = torque.scaled(0.1)  # the catalogue's width is ten times the prior's
    none, wide, own = (
        weighed(compact(hypothesis))
        for hypothesis in (full, extend(full, [torque]), extend(full, [tenth]))
    )
    return none, wide, own


def test_what_is_withheld_is_what_a_search_with_the_priors_width_gains() -> None:
    """Another way to the same evidence: the model with that prior, searched by itself."""
    none, wide, own = both()
    gain = own.log_evidence - none.log_evidence
    assert gain > 8.0
    assert wide.score > none.score + 3.0
    _, again = torque_again([none, wide])
    assert again.withheld == pytest.approx(np.logaddexp(0.0, gain) - np.log(2.0), abs=0.1)
    assert again.score < none.score


def test_a_torque_beyond_its_prior_stays_ahead() -> None:
    """Ten standard deviations, told as well: the prior's width explains less than half."""
    none, wide, _ = both()
    sizes = wide.hypothesis.sizes
    point = wide.mode.point.copy()
    point[sizes] *= 4.0
    more = 0.5 * 15.0 * quadratic(wide.mode, sizes)  # four times the size, sixteen times the gain
    mode = replace(wide.mode, point=point)
    beyond = replace(wide, mode=mode, log_evidence=wide.log_evidence + more)
    assert torque_again([none, beyond]) == [none, beyond]


def quadratic(mode: Mode, sizes: slice) -> float:
    """Square of sizes over their covariance."""
    covariance = (mode.factor @ mode.factor.T)[sizes, sizes]
    return float(mode.point[sizes] @ np.linalg.solve(covariance, mode.point[sizes]))


def test_what_else_is_ahead_of_the_baseline_leaves_all_as_it_is() -> None:
    """Later beginnings, another cause that leads, and one that would lead in the torque's place."""
    none, wide, _ = both()
    late = replace(wide, beginnings=(Beginning("again", 1.0, wide),))
    assert torque_again([none, late]) == [none, late]
    leak = events().catalogue.effect("thruster_leak:z3")
    other = replace(wide, hypothesis=compact(extend(none_hypothesis(events()), [leak])))
    for lead in (5.0, -1.0):
        beside = replace(other, log_evidence=wide.log_evidence + lead)
        assert torque_again([none, wide, beside]) == [none, wide, beside]
