"""The telemetry calibration: reproducible repetitions, truths with draws, a sound judgement."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.errors import InputError
from cassini_bayes.model.posterior import Model
from cassini_bayes.priors.reader import OF_CONTROLLERS
from cassini_bayes.results.ranks import Ranks
from cassini_bayes.studies import telemetry_calibration
from cassini_bayes.studies.telemetry_calibration import (
    CONTROLS,
    VARIANTS,
    TelemetryCampaign,
    flat_draws,
    flat_truth,
    model_of,
)
from cassini_bayes.studies.telemetry_campaign import FULL, QUICK, judge

SCENARIO = Path("runs/scenarios/calibration.toml")
PRIORS = Path("priors/cassini_b_branch_telemetry.toml")


def campaign(name: str, seed: int = 5) -> TelemetryCampaign:
    """The campaign of one variant."""
    variant = next(v for v in (*VARIANTS, *CONTROLS) if v.name == name)
    return TelemetryCampaign(SCENARIO, PRIORS, variant, seed=seed)


def test_a_repetition_repeats_and_ranks_every_name() -> None:
    """The same seed and index give the same ranks, one fraction per name."""
    slews = campaign("slew")
    found = slews.repetition(0)
    first, k, again = found["ranks"], found["pareto_k"], slews.repetition(0)["ranks"]
    assert np.array_equal(first, again)
    assert first.shape == (len(slews.names()),)
    assert ((first >= 0) & (first <= 1)).all()
    assert np.isfinite(k)


def test_a_flight_that_is_declined_is_kept_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    """No rows between firings: no ranks, and the campaign goes on."""

    def refused(*_: object) -> Model:
        raise InputError("event bias-1: telemetry", "rows", "none", "give more")

    monkeypatch.setattr(telemetry_calibration, "model_of", refused)
    bias = campaign("bias")
    found = bias.repetition(0)
    assert np.isnan(found["ranks"]).all()
    assert np.shape(found["ranks"]) == (len(bias.names()),)
    assert np.isnan(found["pareto_k"])


def test_names_are_those_of_draws_and_truth() -> None:
    """Every ranked scalar has draws and a true value, and every walked parameter is ranked."""
    joint = campaign("joint")
    rng = np.random.default_rng(1)
    priors = joint.priors()
    simulation = joint.simulate(priors, rng)
    model = model_of(simulation, joint.variant, priors)
    drawn = flat_draws(model, model.space.sample(rng, 3), rng)
    truth = flat_truth(simulation)
    assert set(joint.names()) <= set(drawn)
    assert set(joint.names()) <= set(truth)
    assert set(model.space.names) - set(OF_CONTROLLERS) <= set(joint.names())


def test_variants_change_what_they_say() -> None:
    """Sampling, events and wheel noise of a variant are in its telemetry and priors."""
    rng = np.random.default_rng(2)
    mixed = campaign("mixed")
    telemetry = mixed.simulate(mixed.priors(), rng).events[0].telemetry
    counters = telemetry.time_s[np.isfinite(telemetry.columns["pulses_z1"])]
    rates = telemetry.time_s[np.isfinite(telemetry.columns["rate_x_rad_s"])]
    assert np.diff(counters).min() == pytest.approx(10.0)
    assert np.diff(rates).min() == pytest.approx(4.0)
    noisy = campaign("noisy-wheels").priors().parameters["wheel_noise_rpm"].distribution
    assert noisy is not None
    assert noisy.quantile_of_standard(np.zeros(1))[0] == pytest.approx(1.0)
    assert set(FULL) == set(QUICK) == {v.name for v in (*VARIANTS, *CONTROLS)}


def test_the_pulse_blind_control_keeps_more_rows() -> None:
    """Without the guard time rows during pulses are kept."""
    one = campaign("bias")
    priors = one.priors()
    simulation = one.simulate(priors, np.random.default_rng(3))
    rows = [
        model_of(simulation, replace(one.variant, name=control), priors)
        .telemetry[0]
        .event.statistics.rows
        for control in ("bias", "pulse-blind")
    ]
    assert rows[1] > rows[0] + 50


def test_the_control_without_cut_tails_flies_close_pulses() -> None:
    """466 pulses for 6 begin one control cycle after the last one; none may be close."""
    ignored, usual = campaign("cuts-ignored"), campaign("bias")
    priors = ignored.priors()
    simulation, other = (own.simulate(priors, np.random.default_rng(3)) for own in (ignored, usual))
    close = []
    for flown in (simulation, other):
        logs = flown.events[0].motion.pulses.values()
        gaps = [log.start_s[1:] - log.start_s[:-1] - log.width_s[:-1] for log in logs]
        close.append(int((np.concatenate(gaps) < 0.2).sum()))
    assert close[0] > 300 > 20 * close[1]
    assert "close_pulse_share" not in model_of(simulation, ignored.variant, priors).space.names
    whole = campaign("high-gain")
    assert "close_pulse_share" in model_of(simulation, whole.variant, priors).space.names


def test_the_judgement_is_over_all_variants_together() -> None:
    """Uniform ranks pass; one skewed parameter in one variant fails everything."""
    rng = np.random.default_rng(4)

    def made_up(n: int, skew: float) -> Ranks:
        values = rng.uniform(size=(n, 6))
        values[:, 2] **= skew
        return Ranks(tuple("abcdef"), values, np.zeros(n), np.zeros(n, dtype=bool))

    good = judge({"one": made_up(200, 1.0), "two": made_up(100, 1.0)})
    bad = judge({"one": made_up(200, 2.0), "two": made_up(100, 1.0)})
    assert good.passed
    assert not bad.passed
    failing = bad.table[bad.table["p_envelope_holm"] <= 0.01]
    assert list(failing["variant"] + failing["parameter"]) == ["onec"]
