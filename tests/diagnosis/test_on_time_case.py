"""Causes of wrong on-time predictions: evidence, names, sizes, groups, held-out gain."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.diagnosis import Diagnosis, diagnose
from cassini_bayes.diagnosis.gauss_newton import Model, fit, importance_draws, predict_left_out
from cassini_bayes.diagnosis.on_time_case import OnTimeCase
from cassini_bayes.diagnosis.on_times import OnTimeHypothesis, hypothesis, read_on_times
from cassini_bayes.diagnosis.score import Gain
from cassini_bayes.diagnosis.verdict import Verdict, weigh
from cassini_bayes.effects.catalogue import Catalogue, read_catalogue
from cassini_bayes.effects.effect import onsets
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.prediction.beliefs import read_beliefs
from cassini_bayes.prediction.ground_software import (
    GroundInputs,
    ground_prediction,
    prior_parameters,
)
from cassini_bayes.prediction.requests import request_of
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.spacecraft import lever_arms
from cassini_bayes.studies.published_on_times import held_out, points_of, section_of

ROOT = Path(__file__).parents[2]
FEW = ("thrust_scale", "tail_off", "pulse_shape", "center_of_mass:y", "firing_logic")


@cache
def priors() -> Priors:
    """Priors of the eight flight biases."""
    return read_priors(ROOT / "priors" / "cassini_b_branch_2010.toml")


def events(source: str) -> tuple[TotalsEvent, ...]:
    """Four of the eight flight biases, as one column of the tables has them."""
    path = ROOT / "cassini_bayes" / "published" / "flight_2009_2010.csv"
    found = tuple(read_totals(path, priors().spacecraft, source))
    return (*found[:2], found[3], found[5])


@cache
def case(source: str = "flight") -> OnTimeCase:
    """The ideal calculation of those events."""
    return OnTimeCase(read_on_times(events(source), priors(), read_beliefs()), catalogue())


@cache
def catalogue() -> Catalogue:
    """A few causes, so that weighing them takes a second; a second noise of ``unknown``."""
    whole = read_catalogue(priors(), (1, 2, 4), ("on_times",))
    share = whole.effects[0].prior_probability
    effects = tuple(replace(whole.effect(name), prior_probability=share) for name in FEW)
    return replace(whole, effects=effects)


def flown(name: str, values: dict[str, float], seed: int, begins: int = 0) -> OnTimeCase:
    """The case with on-times drawn from a hypothesis, its effect at the given values.

    It acts from the event of that place in time on.
    """
    rng = np.random.default_rng(seed)
    onset = (None, *onsets(case().data.order))[begins]
    effects = tuple(replace(e, onset=onset) for e in catalogue().effects if e.name == name)
    own = hypothesis(case().data, effects)
    z = 0.5 * rng.standard_normal(own.model.dimension)
    for place, walked in enumerate(own.space.names):
        for effect in effects:
            for parameter in effect.parameters:
                if parameter.name == walked:
                    z[place] = parameter.distribution.standard_of(values[parameter.key])
    noise = np.linalg.cholesky(own.model.noise(z))
    mean = own.model.forward(z[None])[0]
    drawn = mean + np.einsum("euv,ev->eu", noise, rng.standard_normal(mean.shape))
    return with_on_times(drawn)


def with_on_times(printed_s: Array) -> OnTimeCase:
    """The case with other on-times."""
    return replace(case(), data=replace(case().data, printed_s=printed_s))


def verdict_on(own: OnTimeCase) -> Verdict[OnTimeHypothesis]:
    """The verdict on a case with the few causes."""
    return weigh(own, np.random.default_rng(1))


@cache
def flight() -> Diagnosis[OnTimeHypothesis]:
    """The diagnosis of the four flight biases."""
    return diagnose(case(), np.random.default_rng(1), measure_gain=False)


def gain_over(own: OnTimeCase, verdict: Verdict[OnTimeHypothesis], other: str) -> Gain:
    """What ``firing_logic`` gains on events left out over another hypothesis."""
    return held_out(own, verdict, "firing_logic").gain_over(held_out(own, verdict, other))


def linear(rng: np.random.Generator) -> tuple[Model, Array, Array, Array]:
    """A linear model of 3 events with 2 figures and 4 parameters: offset, slopes, noise."""
    offset, slope = rng.standard_normal((3, 2)), rng.standard_normal((3, 2, 4))
    root = rng.standard_normal((3, 2, 2))
    noise = root @ np.swapaxes(root, 1, 2) + 0.3 * np.eye(2)
    model = Model(lambda z: offset + np.einsum("eud,nd->neu", slope, z), lambda _: noise, 4)
    return model, offset, slope, noise


def dense(slope: Array, noise: Array) -> Array:
    """Covariance (6, 6) of all figures, written out block by block."""
    flat = slope.reshape(6, 4)
    found = flat @ flat.T
    for event in range(3):
        own = slice(2 * event, 2 * event + 2)
        found[own, own] += noise[event]
    return found


def test_evidence_of_a_linear_model_is_the_dense_normal() -> None:
    """Evidence is scipy's density of N(offset, S Sᵀ + R); importance sampling says the same."""
    rng = np.random.default_rng(3)
    model, offset, slope, noise = linear(rng)
    y = offset + 2.0 * rng.standard_normal(offset.shape)
    found = fit(y, model)
    oracle = multivariate_normal(offset.ravel(), dense(slope, noise)).logpdf(y.ravel())
    assert found.log_evidence == pytest.approx(oracle, abs=1e-8)
    draws = importance_draws(y, model, found, rng, 4000)
    assert abs(draws.log_evidence - oracle) < 5.0 * draws.log_evidence_se
    wider = Model(model.forward, lambda z: 2.0 * model.noise(z), 4)
    assert abs(fit(y, wider).log_evidence - oracle) > 0.1


def test_a_left_out_event_is_predicted_by_the_conditional_normal() -> None:
    """Prediction of an event from the others is the conditional of the dense normal."""
    rng = np.random.default_rng(4)
    model, offset, slope, noise = linear(rng)
    y = offset + rng.standard_normal(offset.shape)
    mean, covariance, evidence = predict_left_out(y, model, 1, np.zeros(4))
    whole, own, rest = dense(slope, noise), [2, 3], [0, 1, 4, 5]
    gain = whole[np.ix_(own, rest)] @ np.linalg.inv(whole[np.ix_(rest, rest)])
    np.testing.assert_allclose(mean, offset[1] + gain @ (y - offset).ravel()[rest], atol=1e-8)
    np.testing.assert_allclose(
        covariance, whole[np.ix_(own, own)] - gain @ whole[np.ix_(rest, own)], atol=1e-8
    )
    others = multivariate_normal(offset.ravel()[rest], whole[np.ix_(rest, rest)])
    assert evidence == pytest.approx(others.logpdf(y.ravel()[rest]))


def test_the_baseline_is_the_ideal_calculation() -> None:
    """At the prior's centre on-times are those of the rebuilt ideal column, sampled each second."""
    own = hypothesis(case().data)
    found = own.model.forward(np.zeros((1, own.model.dimension)))[0]
    first = [unit[0] for unit in case().data.layout.units]
    for event, row in zip(events("flight"), found, strict=True):
        assert event.thrust_predicted_n is not None
        inputs = GroundInputs(
            priors().spacecraft, "B", prior_parameters(priors()), event.thrust_predicted_n, 2400.0
        )
        oracle = ground_prediction(inputs, request_of(event)).on_time_s[first]
        np.testing.assert_allclose(row, oracle, atol=0.01)


def test_firing_logic_leaves_momentum_as_it_is() -> None:
    """On-times of any share of pairs and any opposing firings turn the spacecraft alike."""
    effect = catalogue().effect("firing_logic")
    own = hypothesis(case().data, (effect,))
    z = np.zeros((2, own.model.dimension))
    places = [own.space.names.index(p.name) for p in effect.parameters]
    z[0, places], z[1, places] = -4.0, (1.0, 0.5, -0.5, 1.0)
    on_time = np.zeros((2, 4, case().data.thrusters))
    for column, unit in enumerate(case().data.layout.units):
        on_time[..., list(unit)] = own.model.forward(z)[..., column, None]
    base = prior_parameters(priors())
    turned = on_time @ lever_arms(priors().spacecraft, "B", base).T
    np.testing.assert_allclose(turned[0], turned[1], atol=1e-6)
    assert np.abs(on_time[0] - on_time[1]).max() > 1.0


@pytest.mark.statistical
def test_a_hidden_firing_logic_is_named() -> None:
    """Pairs and opposing firings are named, their share found, and left-out events gain."""
    truth = {
        "pairing_share": 0.8,
        "minor_constant_s": 0.2,
        "minor_per_duration": 0.0005,
        "minor_per_demand": 0.03,
    }
    data = flown("firing_logic", truth, 11)
    found = diagnose(data, np.random.default_rng(1))
    record = found.record
    assert found.verdict.best.name == "firing_logic"
    assert record["causes"][0]["probability"] > 0.95
    assert min(found.widths[width]["firing_logic"] for width in (0.5, 2.0)) > 0.95
    assert record["p_value"] < 0.01
    low, high = record["causes"][0]["parameters"]["pairing_share"]["hdi_90"]
    assert low < truth["pairing_share"] < high
    assert record["gain"]["elpd_diff"] > 0.0
    assert record["gain"]["heldout_rmse_ratio"] < 1.0
    assert record["extended"]["heldout_rmse_s"] < record["baseline"]["heldout_rmse_s"]


@pytest.mark.statistical
def test_a_hidden_tail_off_is_named_as_a_group() -> None:
    """A tail of 90 ms beside rectangular pulses cannot be told from stronger thrusters."""
    verdict = verdict_on(flown("tail_off", {"tau_fall_s": 0.07}, 12))
    first, group = verdict.best.name, {"tail_off", "pulse_shape", "thrust_scale"}
    assert first in group
    assert group <= {first, *verdict.confounded_with(first)}
    assert "firing_logic" not in verdict.confounded_with(first)


@pytest.mark.statistical
def test_a_thrust_that_sinks_between_events_begins_there() -> None:
    """All thrusters at 60 % in the last two of four events: named with the third, size and gain;
    without that event the others leave its side open.
    """
    own = flown("thrust_scale", {"thrust_factor": 0.6}, 14, begins=2)
    verdict = verdict_on(own)
    order = own.data.order
    assert "thrust_scale" in {verdict.best.name, *verdict.confounded_with(verdict.best.name)}
    found = verdict.named("thrust_scale")
    assert found.begins is not None
    assert (found.begins.event, found.begins.probability > 0.9) == (order[2], True)
    assert {b.event for b in found.beginnings} == {"", *order[1:]}
    size = own.sizes(found, np.random.default_rng(1))["thrust_factor"]
    assert abs(size.mean - 0.6) < 3.0 * size.sd
    assert size.sd < 0.1
    gain = held_out(own, verdict, "thrust_scale").gain_over(held_out(own, verdict, "none"))
    assert gain.nats > 0.0


@pytest.mark.statistical
def test_nothing_hidden_is_none() -> None:
    """On-times of the baseline itself: none, a p-value that is not small, no gain by a cause."""
    data = flown("none", {}, 13)
    verdict = verdict_on(data)
    assert verdict.best.name == "none"
    assert verdict.pairs == ()
    assert data.p_value(verdict.none, np.random.default_rng(0)) > 0.02
    gain = gain_over(data, verdict, "none")
    assert gain.nats < 2.0 * gain.standard_error


def test_the_printed_ideal_column_needs_no_cause() -> None:
    """Negative control: the ground software's own column is what the baseline calculates."""
    verdict = verdict_on(case("gsw_ideal"))
    assert verdict.best.name == "none"
    assert verdict.probabilities["firing_logic"] < 0.01


def test_shuffled_departures_gain_nothing() -> None:
    """Negative control: flight gains over ``unknown``; its departures moved to other events lose.

    Against ``none`` both gain, as ``none`` has far too small errors: it is no measure of the name.
    """
    own = hypothesis(case().data)
    ideal = own.model.forward(np.zeros((1, own.model.dimension)))[0]
    moved = ideal + np.roll(case().data.printed_s - ideal, 2, axis=0)
    one = replace(catalogue(), effects=(catalogue().effect("firing_logic"),))
    data = replace(with_on_times(np.maximum(moved, 0.0)), catalogue=one)
    verdict = verdict_on(data)
    assert verdict.best.name == "unknown"
    assert gain_over(data, verdict, "unknown").nats < 0.0
    gain = gain_over(case(), flight().verdict, "unknown")
    assert gain.nats > 2.0 * gain.standard_error


def test_findings_say_what_was_measured() -> None:
    """Paragraphs, table and figure of flight carry the numbers of the held-out predictions."""
    verdict, printed = flight().verdict, {"ideal": 1.0, "calibrated": 0.5}
    found = section_of(case(), flight(), printed, verdict, np.random.default_rng(5))
    assert found.probability.index[0] == "firing_logic"
    points = points_of(case(), *(held_out(case(), verdict, n) for n in ("none", "firing_logic")))
    assert len(points) == 24
    missed = points["flight_s"] - points["first_s"]
    assert f"| `firing_logic` | – | {np.sqrt((missed**2).mean()):.2f} |" in found.details
    assert "Verdict: gain." in found.details
    assert "below 0.001" in found.remains
    assert "pairing_share" in found.sizes["firing_logic"]
    left, right = found.figure.axes
    assert left.get_yticklabels()[-1].get_text() == "firing_logic"
    assert right.get_xlabel().endswith("(s)")


def test_firing_logic_takes_no_share_from_other_inputs() -> None:
    """Telemetry and totals have neither the cause nor less prior probability for theirs."""
    both = read_catalogue(priors(), (1, 2, 4), ("telemetry", "totals"))
    assert "firing_logic" not in both.names
    kinds = {effect.kind.name for effect in both.effects}
    for kind in kinds:
        own = [e.prior_probability for e in both.effects if e.kind.name == kind]
        assert sum(own) == pytest.approx(0.45 / len(kinds))


def test_events_of_another_branch_are_refused() -> None:
    """The priors are those of one branch."""
    wrong = replace(events("flight")[0], branch="A")
    with pytest.raises(InputError, match="branch B"):
        read_on_times([wrong], priors(), read_beliefs())
    with pytest.raises(InputError, match="at least one"):
        read_on_times([], priors(), read_beliefs())
