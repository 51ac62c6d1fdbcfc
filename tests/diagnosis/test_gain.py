"""Held-out gain: there where one cause acts in all events, gone where effects are shuffled.

Scores of totals rows against importance sampling, and of a row that does not belong. Fits shared
out among processes, stored and read back give the same scores as those made in one.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from event_cases import eased

from cassini_bayes.balance.linearised import Linear
from cassini_bayes.balance.part_columns import ColumnsByPart
from cassini_bayes.balance.statistics import ExtraColumn, Samples
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis import gain
from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.case import Beginning, Fits, Weighed
from cassini_bayes.diagnosis.diagnosis import diagnose
from cassini_bayes.diagnosis.events import Events, prepare
from cassini_bayes.diagnosis.evidence import by_laplace
from cassini_bayes.diagnosis.gain import (
    fits_to_hold_out,
    held_out_telemetry,
    held_out_totals,
    longest_first,
    predicted_rows,
    ways_without,
)
from cassini_bayes.diagnosis.hypotheses import (
    Hypothesis,
    compact,
    extend,
    none_hypothesis,
    unknown_hypothesis,
)
from cassini_bayes.diagnosis.innovations import linearise
from cassini_bayes.diagnosis.modes import Mode, find_mode
from cassini_bayes.diagnosis.rows_and_turns import with_torque_noise
from cassini_bayes.diagnosis.score import WORSE, HeldOut
from cassini_bayes.diagnosis.stages import StageRunner
from cassini_bayes.diagnosis.verdict import Verdict, weigh
from cassini_bayes.effects.effect import SearchResult, onsets
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.model.posterior import build_model, log_posterior
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.report.diagnosis_verdict import gain_sentence
from cassini_bayes.sampling.warmstart import warm_start
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.blind.flights import reduced
from cassini_bayes.studies.scenario import simulate_file

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
LEAK_N = 1.0e-4
TOTALS_PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_2010.toml")
FLIGHT = ROOT / "cassini_bayes" / "published" / "flight_2009_2010.csv"


@cache
def priors() -> Priors:
    """The telemetry priors, read once."""
    return read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")


def leaking(thrusters: Mapping[str, str]) -> Events:
    """Three biases, in each of them a valve that leaks."""
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    biases = [event for event in document["event"] if event["kind"] == "bias"]
    third = {**biases[0], "id": "bias-3", "from_rpm": [200.0, -900.0, -300.0]}
    document["event"] = [*biases, {**third, "to_rpm": [-500.0, 100.0, 600.0]}]
    document["effect"] = [
        {"name": f"thruster_leak:{name}", "parameters": {"leak_n": LEAK_N}, "events": [event]}
        for event, name in thrusters.items()
    ]
    simulation = simulate_file(
        scenario_of(eased(document, 0.2, 4.0), SCENARIO.parent), 11, priors=priors()
    )
    return reduced(simulation, priors())


def one_by_one(events: Events, weighed: Weighed[Hypothesis]) -> list[Fits]:
    """The fits that holding out takes, all in this process."""
    return [fit() for fit in fits_to_hold_out(events, weighed)]


def leak_scores(events: Events) -> tuple[HeldOut, HeldOut]:
    """Events held out without and with a leak of Z3 in the model."""
    leak = events.catalogue.effect("thruster_leak:z3")
    only = replace(events, catalogue=replace(events.catalogue, effects=(leak,)))
    full = none_hypothesis(only)
    models = [compact(full), compact(extend(full, [leak]))]
    none, own = (by_laplace(m, find_mode(m.log_density, m.dimension)) for m in models)
    base, extended = (held_out_telemetry(only, w, one_by_one(only, w)) for w in (none, own))
    return base, extended


def test_gain_is_there_and_vanishes_when_effects_are_shuffled() -> None:
    """A leak in every event gains on each; leaks of other valves in other events gain nothing."""
    base, own = leak_scores(leaking({"bias-1": "z3", "bias-2": "z3", "bias-3": "z3"}))
    gains = own.log_scores - base.log_scores
    assert gains.sum() > 2.0 * np.sqrt(3) * gains.std(ddof=1)
    assert own.rmse < WORSE * base.rmse  # a leak is far below the noise of one rate sample
    base, own = leak_scores(leaking({"bias-1": "z3", "bias-2": "z1", "bias-3": "z2"}))
    gains = own.log_scores - base.log_scores
    assert not gains.sum() > 2.0 * np.sqrt(3) * gains.std(ddof=1)


@cache
def three() -> tuple[TotalsEvent, ...]:
    """The first three flight biases."""
    return read_totals(str(FLIGHT), TOTALS_PRIORS.spacecraft, "flight")[:3]


def scored(rows: tuple[TotalsEvent, ...]) -> HeldOut:
    """The baseline's scores of rows held out in turn."""
    events = prepare((), TOTALS_PRIORS, rows)
    none = none_hypothesis(events)
    d = none.dimension
    # searches start from the mode, so the prior's own does
    weighed = Weighed(none, Mode(np.zeros(d), 0.05 * np.eye(d), 0.0), 0.0, 0.0)
    return held_out_totals(events, weighed, np.random.default_rng(1), one_by_one(events, weighed))


def sampled(rows: tuple[TotalsEvent, ...]) -> float:
    """Log evidence of rows by importance sampling of the totals posterior."""
    model = build_model(rows, TOTALS_PRIORS)
    start = warm_start(
        lambda z: log_posterior(model, z), model.space.dimension, np.random.default_rng(1)
    )
    return start.draws.log_evidence


@cache
def plain() -> HeldOut:
    """Scores of the three as they were flown."""
    return scored(three())


class SettledByOneEvent(SearchResult):
    """A search that took 3 nats from the event of some rates alone."""

    log_gain = log_looks = 0.0

    def __init__(self, rate_rad_s: Array) -> None:
        self.rate_rad_s = rate_rad_s

    def log_start_of(self, samples: Samples) -> float:
        """Three nats of that event."""
        return 3.0 if samples.rate_rad_s is self.rate_rad_s else 0.0

    def columns(self, _: Samples) -> tuple[ExtraColumn, ...]:
        """None."""
        return ()


def test_what_a_search_took_from_an_event_is_paid_for_where_it_is_held_out() -> None:
    """Its score is less by that; those of the others, and residuals, are as they were."""
    events = leaking({"bias-1": "z3", "bias-2": "z3", "bias-3": "z3"})
    leak = events.catalogue.effect("thruster_leak:z3")
    model = compact(extend(none_hypothesis(events), [leak]))
    weighed = by_laplace(model, find_mode(model.log_density, model.dimension))
    fits = one_by_one(events, weighed)
    settled = SettledByOneEvent(events.telemetry[1].samples.rate_rad_s)
    effects = (replace(leak, search_result=settled),)
    charged = replace(model, model=replace(model.model, effects=effects))
    searched = replace(weighed, hypothesis=charged)
    plain, paid = (held_out_telemetry(events, w, fits) for w in (weighed, searched))
    assert plain.log_scores - paid.log_scores == pytest.approx([0.0, 3.0, 0.0])
    assert paid.rmse == plain.rmse


def test_predictions_do_not_depend_on_the_point_about_which_rows_are_linear() -> None:
    """One linear model about two points; control: the prior mean as seen from another's point."""
    rng = np.random.default_rng(0)
    columns, truth = 0.08 * rng.standard_normal((360, 2)), np.array([3.0, 0.3])
    target = columns @ truth + rng.standard_normal(360)

    def about(point: Array) -> Linear:
        by_part = ColumnsByPart.of(columns, [180, 180])
        return Linear(target - columns @ point, by_part, np.ones(2))

    one, two = np.array([2.9, 0.2]), np.array([0.2, -1.0])
    wanted = predicted_rows(about(one), 1, -one)[0]
    assert predicted_rows(about(two), 1, -two)[0] == pytest.approx(wanted, abs=1e-9)
    assert np.abs(predicted_rows(about(one), 1, -two)[0] - wanted).max() > 0.05


def beginnings_apart(events: Events) -> Weighed[Hypothesis]:
    """A leak that may begin with any event, each beginning with a made-up mode of its own."""
    full, leak = none_hypothesis(events), events.catalogue.effect("thruster_leak:z3")
    beginnings = []
    for place, onset in enumerate((None, *onsets(events.in_order))):
        model = extend(full, [replace(leak, onset=onset)])
        mode = Mode(np.full(model.dimension, 0.2 * place), np.eye(model.dimension), 0.0)
        event = "" if onset is None else onset.event
        beginnings.append(Beginning(event, 1.0 / 3.0, Weighed(model, mode, 0.0)))
    throughout = beginnings[0].weighed
    assert throughout is not None
    return replace(throughout, beginnings=tuple(beginnings))


def test_rows_are_predicted_from_the_point_about_which_they_are_linear(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beginnings that are alike to the others have one mode: not that of another event held out.

    So one beginning has linear models about several points, more than there are beginnings.
    """
    events = leaking({"bias-1": "z3", "bias-2": "z3", "bias-3": "z3"})
    weighed, made, matched = beginnings_apart(events), [], []

    def noted(whole: Hypothesis, centre: Array, rows: Linear, factors: list[Array]) -> Linear:
        made.append((with_torque_noise(whole, centre, rows, factors), centre))
        return made[-1][0]

    def checked(linear: Linear, place: int, centre: Array) -> tuple[Array, Array]:
        (own,) = (point for known, point in made if known is linear)
        matched.append(np.array_equal(-centre, own))
        return predicted_rows(linear, place, centre)

    monkeypatch.setattr(gain, "with_torque_noise", noted)
    monkeypatch.setattr(gain, "predicted_rows", checked)
    fits = [tuple(way.mode for _, _, way in weighed.searched)]
    for event in longest_first(events):
        members = dict.fromkeys(id(way) for _, way in ways_without(events, weighed, event))
        fits.append((weighed.mode,) * len(members))
    held_out_telemetry(events, weighed, fits)
    assert len(made) > len(events.telemetry)
    assert len(matched) > len(events.telemetry)
    assert all(matched)


def test_score_of_a_row_is_a_difference_of_evidences() -> None:
    """The first row's score is what importance sampling gives, to Laplace's own error."""
    wanted = sampled(three()) - sampled(three()[1:])
    assert plain().log_scores[0] == pytest.approx(wanted, abs=0.3)


def test_a_row_of_another_spacecraft_scores_badly() -> None:
    """Negative control: on-times half as long again lower the row's score, and are missed by."""
    first, *others = three()
    odd = replace(first, on_time_s=1.5 * first.on_time_s)
    found = scored((odd, *others))
    assert found.log_scores[0] < plain().log_scores[0] - 5.0
    assert found.rmse > 2.0 * plain().rmse
    assert found.coverage_90 is not None
    assert found.coverage_90 < (plain().coverage_90 or 0.0)


def test_what_is_unknown_counts_in_the_rows_that_it_predicts() -> None:
    """A torque that wanders makes held-out rows less certain, more so the further from the first.

    Control: without its columns the same rows seem known to their noise.
    """
    events = leaking({"bias-1": "z3", "bias-2": "z3", "bias-3": "z3"})
    unknown = compact(unknown_hypothesis(events))
    z = np.zeros(unknown.dimension)
    z[unknown.model.space.names.index("torque_noise_n_m_s05")] = 3.0
    still, factors = linearise(unknown, z)
    wandering = with_torque_noise(unknown, z, still, factors)
    spread, control = (predicted_rows(linear, 0, -z)[1] for linear in (wandering, still))
    assert spread[-30:].mean() > 1.5 * control[-30:].mean()
    assert spread[-30:].mean() > 1.2 * spread[:30].mean()


def test_a_row_that_alone_brings_a_parameter_is_held_out_like_any_other() -> None:
    """Only the first row has a ΔV, and so its noise: without that row nobody walks it."""
    first, *others = three()
    found = scored((first, *(replace(row, delta_v_m_s=None) for row in others)))
    assert np.isfinite(found.log_scores).all()
    assert found.rmse == pytest.approx(plain().rmse, rel=0.3)


@pytest.mark.parametrize("has_rows", [True, False])
def test_a_diagnosis_holds_its_rows_out(has_rows: bool) -> None:
    """Three rows have the scores of these; of two the gain is not measured."""
    events = prepare((), TOTALS_PRIORS, three() if has_rows else three()[:2])
    few = replace(events.catalogue, effects=(events.catalogue.effect("thrust_scale"),))
    case = BalanceCase(replace(events, catalogue=few))
    record = diagnose(case, np.random.default_rng(3)).record
    assert (record["gain"]["elpd_diff"] is not None) == has_rows
    if has_rows:
        # searches from different starts end within a slope of 0.1 nats, four of them to a sum
        assert record["baseline"]["elpd"] == pytest.approx(plain().elpd, abs=0.05)
        assert record["baseline"]["heldout_rmse_nms"] == pytest.approx(plain().rmse, rel=0.1)
    assert ("not a mix" in gain_sentence(record)) != has_rows


@cache
def five() -> tuple[BalanceCase, Verdict[Hypothesis]]:
    """Five flight biases, the thrust of the last two a tenth lower: a cause with an onset."""
    rows = read_totals(str(FLIGHT), TOTALS_PRIORS.spacecraft, "flight")[:5]
    late = (replace(row, on_time_s=1.1 * row.on_time_s) for row in rows[3:])
    events = prepare((), TOTALS_PRIORS, (*rows[:3], *late))
    few = replace(events.catalogue, effects=(events.catalogue.effect("thrust_scale"),))
    case = BalanceCase(replace(events, catalogue=few))
    return case, weigh(case, np.random.default_rng(3), pairs=False)


@cache
def whole_score(name: str) -> HeldOut:
    """A hypothesis's scores of the five, all worked out in this process."""
    case, verdict = five()
    score = case.held_out(verdict.named(name), np.random.default_rng(1))
    assert score is not None
    return score


def test_a_cause_of_the_five_may_begin_with_several() -> None:
    """What is shared between beginnings is shared in their fits."""
    _, verdict = five()
    assert len(verdict.named("thrust_scale").searched) > 1


@pytest.mark.parametrize("processes", [1, 2])
@pytest.mark.parametrize("name", ["none", "thrust_scale"])
def test_scores_by_pieces_are_those_of_the_whole(name: str, processes: int, tmp_path: Path) -> None:
    """Each fit a piece of its own, shared out, kept, and read back where they are all there."""
    case, verdict = five()
    weighed, whole = verdict.named(name), whole_score(name)
    for _ in range(2):
        crew = StageRunner(processes, CheckpointStore(tmp_path, "own"))
        fits = crew.results("", case.fits_to_hold_out(weighed), Fits)
        found = case.held_out(weighed, np.random.default_rng(1), fits=fits)
        assert found is not None
        np.testing.assert_array_equal(found.log_scores, whole.log_scores)
        assert (found.rmse, found.coverage_90) == (whole.rmse, whole.coverage_90)


def test_fits_without_a_long_event_come_first() -> None:
    """By rows of telemetry; totals rows, which are all alike, stay in their order."""
    events = leaking({})
    lengths = {event.id: len(event.usable_rows.time_s) for event in events.telemetry}
    found = [lengths[name] for name in longest_first(events)]
    assert found == sorted(lengths.values(), reverse=True)
    case, _ = five()
    assert longest_first(case.events) == list(case.event_ids)
