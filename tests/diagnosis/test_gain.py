"""Held-out gain: there where one cause acts in all events, gone where effects are shuffled."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from cassini_bayes.diagnosis.diagnosis import catalogue_of
from cassini_bayes.diagnosis.extended import Case, prepare
from cassini_bayes.diagnosis.gain import HeldOut, held_out
from cassini_bayes.diagnosis.naming import name_causes
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.blind.flights import source_of
from cassini_bayes.studies.scenario import simulate_file

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
LEAK_N = 3.0e-5


@cache
def priors() -> Priors:
    """The telemetry priors, read once."""
    return read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")


def leaking(thrusters: Mapping[str, str]) -> Case:
    """Three biases, in each of them a valve that leaks."""
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    biases = [event for event in document["event"] if event["kind"] == "bias"]
    third = {**biases[0], "id": "bias-3", "from_rpm": [200.0, -900.0, -300.0]}
    document["event"] = [*biases, {**third, "to_rpm": [-500.0, 100.0, 600.0]}]
    document["effect"] = [
        {"name": f"thruster_leak:{name}", "parameters": {"leak_n": LEAK_N}, "events": [event]}
        for event, name in thrusters.items()
    ]
    simulation = simulate_file(scenario_of(document, SCENARIO.parent), 11, priors=priors())
    return prepare([source_of(event) for event in simulation.events], priors())


def scores(case: Case) -> tuple[HeldOut, HeldOut]:
    """Events held out without and with a leak of Z3 in the model."""
    catalogue = catalogue_of(case)
    only = replace(catalogue, effects=(catalogue.effect("thruster_leak:z3"),))
    verdict = name_causes(case, only, np.random.default_rng(1), pairs=False)
    leak = next(w for w in verdict.weighed if w.name == "thruster_leak:z3")
    return held_out(verdict, verdict.none), held_out(verdict, leak)


def test_gain_is_there_and_vanishes_when_effects_are_shuffled() -> None:
    """A leak in every event gains on each; leaks of other valves in other events gain nothing."""
    base, own = scores(leaking({"bias-1": "z3", "bias-2": "z3", "bias-3": "z3"}))
    gains = own.log_scores - base.log_scores
    assert gains.sum() > 2.0 * np.sqrt(3) * gains.std(ddof=1)
    assert own.rmse_n_m_s < base.rmse_n_m_s
    base, own = scores(leaking({"bias-1": "z3", "bias-2": "z1", "bias-3": "z2"}))
    gains = own.log_scores - base.log_scores
    assert not gains.sum() > 2.0 * np.sqrt(3) * gains.std(ddof=1)
