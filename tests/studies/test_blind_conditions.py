"""Blind trials over conditions: what is drawn and refused, sizes by simulation, counts by level."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import run_cases
from scipy.stats import binom
from study_cases import study_in

from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import compact, none_hypothesis
from cassini_bayes.diagnosis.modes import Mode, find_mode
from cassini_bayes.errors import InputError
from cassini_bayes.studies.blind.by_condition import by_condition
from cassini_bayes.studies.blind.campaign import write_results
from cassini_bayes.studies.blind.flights import Blind, Hidden, Scene
from cassini_bayes.studies.blind.likelihood_oracle import likelihood_classifier
from cassini_bayes.studies.blind.oracle import Classifier, sizes_of
from cassini_bayes.studies.blind.rates import CLEAR, WITHOUT_DECLINED, rates
from cassini_bayes.studies.blind.shift import changed_size, held
from cassini_bayes.studies.blind.sizes import (
    SEEN_AT,
    Growth,
    Stage,
    draw_path,
    measured,
    sensitivity,
    stage,
)
from cassini_bayes.studies.blind.strata import OVER_CONDITIONS
from cassini_bayes.studies.blind.trials import is_seen, run_trial
from cassini_bayes.studies.blind.uncatalogued import WITHOUT_THRUSTERS, draw_kind
from cassini_bayes.studies.conditions import LEVELS

ROOT = Path(__file__).parents[2]
SCENARIO, PRIORS = ROOT / "runs" / "scenarios" / "calibration.toml", ROOT / "priors"
CAMPAIGN = Blind(SCENARIO, PRIORS, 5, (), OVER_CONDITIONS, over_conditions=True)
SIGMA = 7.0


def index_of(**levels: str) -> int:
    """The first trial with these levels."""
    for index in range(5_000):
        condition = CAMPAIGN.condition(CAMPAIGN.stream(index))
        assert condition is not None
        if levels.items() <= condition.strata.items():
            return index
    raise AssertionError(levels)


def scene_of(**levels: str) -> Scene:
    """Its flight."""
    return CAMPAIGN.scene(CAMPAIGN.stream(index_of(**levels)))


def baseline(events: Events) -> Mode:
    """The baseline's mode."""
    none = compact(none_hypothesis(events))
    return find_mode(none.log_density, none.dimension)


@cache
def slews(rates: str = "as flown") -> Stage:
    """Slews alone, every 4 s, coarse wheels, noise known."""
    scene = scene_of(events="slews", cadence="4 s", wheel_step="1 rpm", noise="known", rates=rates)
    events = scene.fly(())
    return stage(scene, events, baseline(events))


def test_what_is_drawn_depends_on_seed_and_number_alone() -> None:
    """The same trial again has the same conditions and flight; other numbers and seeds differ."""
    index = index_of(events="three biases")
    one, again = (CAMPAIGN.scene(CAMPAIGN.stream(index)) for _ in range(2))
    assert one.condition == again.condition == CAMPAIGN.condition(CAMPAIGN.stream(index))
    assert (one.seed, one.document) == (again.seed, again.document)
    drawn = {CAMPAIGN.condition(CAMPAIGN.stream(i)) for i in range(30)}
    other = {replace(CAMPAIGN, seed=6).condition(CAMPAIGN.stream(i)) for i in range(30)}
    moved = {
        replace(CAMPAIGN, seed=6).condition(replace(CAMPAIGN, seed=6).stream(i)) for i in range(30)
    }
    assert len(drawn) > 25
    assert drawn == other  # the stream decides
    assert len(drawn & moved) < 3


def test_an_effect_acts_in_all_events_and_torque_noise_in_none() -> None:
    """Three biases have the effect, without torque noise, which would be hidden as well."""
    scene = scene_of(events="three biases")
    file = scene.file([Hidden("tail_off", {"tau_fall_s": 0.08}, 7.0)])
    assert [event.id for event in file.scenario.event] == ["bias-1", "bias-2", "bias-3"]
    (effect,) = file.effects
    assert effect.events is None
    assert not file.scenario.torque_noise


def test_known_noise_is_the_truth_s() -> None:
    """Where noise is known its priors are fixed at the truth; elsewhere they are free."""
    for level in LEVELS["noise"]:
        scene = scene_of(noise=level)
        prior = scene.priors.parameters["wheel_noise_rpm"]
        if level == "known":
            assert prior.fixed == scene.truth().parameters["wheel_noise_rpm"]
        else:
            assert prior.distribution is not None


def test_a_trial_that_is_refused_says_so() -> None:
    """Counters coarser than the pulses that they count: declined, in words; others are kept."""
    index = index_of(
        events="one bias", controller="proportional, 0.5 s off", counter_step="control cycle"
    )
    record = run_trial(CAMPAIGN, index)
    assert "a counter in finer steps than its pulses" in record["declined"]
    assert record["condition"]["controller"] == "proportional, 0.5 s off"
    assert "error" not in record


@pytest.mark.parametrize("name", ["rate_bias:y", "wheel_inertia:2"])
def test_sizes_are_those_that_simulations_show(name: str) -> None:
    """Flights with and without an effect: scores move by G s, the size by the curvature, in 5 %.

    Both flights have the same noise, so that it cancels: the change of the scores is Mᵀ V⁻¹ δ of
    the simulated δ. Control: the oracle of a flight with ten times finer rates is far off.
    """
    before = slews()
    effect = before.events.catalogue.effect(name)
    told = likelihood_classifier(before.events, before.base, {})
    path = draw_path(effect, np.random.default_rng(4))
    unit = measured(before, path, 0.2)
    assert unit is not None
    hidden = measured(before, path, 0.2 * SIGMA / unit.sigma)
    assert hidden is not None
    assert hidden.sigma == pytest.approx(SIGMA, rel=0.05)
    size = sizes_of(effect, hidden.parameters, before.truth.parameters)
    assert sigma_of(told, name, size) == pytest.approx(SIGMA, rel=0.05)
    events = before.scene.fly((hidden,))
    after = likelihood_classifier(events, baseline(events), {})
    places = list(next(side.places for side in told.sides if side.name == name))
    moved = float(size @ (after.score - told.score)[places])
    assert np.sqrt(moved) == pytest.approx(SIGMA, rel=0.05)
    if name == "rate_bias:y":
        finer = slews("ten times finer")
        other = likelihood_classifier(finer.events, finer.base, {})
        assert sigma_of(other, name, size) > 1.5 * SIGMA


def test_a_size_needs_no_mode_of_the_same_parameters() -> None:
    """A flight with an effect may have late pulses where that without has none: a new search."""
    before = slews()
    path = draw_path(before.events.catalogue.effect("rate_bias:y"), np.random.default_rng(4))
    more = len(before.base.point) + 1
    other = replace(before.base, point=np.zeros(more), factor=np.eye(more))
    plain, searched = measured(before, path, 0.2), measured(replace(before, base=other), path, 0.2)
    assert plain is not None
    assert searched is not None
    assert searched.sigma == pytest.approx(plain.sigma, rel=0.01)


def test_late_records_show_nothing_up_to_a_control_cycle_and_then_much() -> None:
    """Pulses start with cycles of 0.125 s; control: the model has a curvature at 0.3 s."""
    scene = scene_of(events="one bias", cadence="1 s", controller="hysteresis", rates="as flown")
    events = scene.fly(())
    on = stage(scene, events, baseline(events))
    effect = events.catalogue.effect("time_offset")
    path = Growth(effect, {"time_offset_s": 1.0}, {})
    sizes = [measured(on, path, late_s) for late_s in (0.06, 0.12, 0.13)]
    below, still, above = (hidden.sigma for hidden in sizes if hidden is not None)
    assert max(below, still) < 1.0
    assert above > 7.0
    assert 0.06 * sensitivity(events, on.base, path, beside=SEEN_AT["time_offset"]) > 1.5


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_a_factor_of_thrusts_has_the_size_that_simulations_show(factor: float) -> None:
    """By what it adds to rows; control: the curvature there, where thrusts scatter by the factor.

    The simulated change is of flights without noise, and knows rows alone.
    """
    finest = {"rates": "ten times finer", "counter_step": "1 ms"}
    scene = scene_of(events="one bias", cadence="1 s", controller="hysteresis", **finest)
    events = scene.fly(())
    on = stage(scene, events, baseline(events))
    path = Growth(events.catalogue.effect("thrust_scale"), {"thrust_factor": factor - 1.0}, {})
    hidden = measured(on, path, 1.0)
    assert hidden is not None
    simulated = changed_size(on.view(hidden), on.plain)
    assert hidden.sigma == pytest.approx(simulated, rel=0.25)
    flown = scene.fly((hidden,))
    with_it = compact(held(none_hypothesis(flown), path.effect, path.values(1.0)))
    near = find_mode(with_it.log_density, with_it.dimension)
    curved = sensitivity(flown, near, path, 1.0) / hidden.sigma
    assert curved > 1.4 if factor < 1.0 else curved < 0.95


def sigma_of(oracle: Classifier, name: str, size: np.ndarray) -> float:
    """σ of a cause by an oracle's Gram matrix."""
    places = list(next(side.places for side in oracle.sides if side.name == name))
    return float(np.sqrt(size @ oracle.gram[np.ix_(places, places)] @ size))


def test_slews_alone_hide_what_needs_no_thruster() -> None:
    """Nothing of thrust is seen where nothing fires, and nothing outside the catalogue needs it."""
    rng = np.random.default_rng(1)
    effects = slews().events.catalogue.effect
    blind = ("thrust_scale", "thruster_leak:z1", "time_offset", "center_of_mass:x")
    assert not any(is_seen(slews(), effects(name), rng) for name in blind)
    assert is_seen(slews(), effects("inertia:xy"), rng)
    kinds = {draw_kind(slews().events, rng).name for _ in range(20)}
    assert kinds == set(WITHOUT_THRUSTERS)


def record(index: int, part: str, said: str, **other: Any) -> dict[str, Any]:
    """A finished trial made up by hand, its conditions drawn."""
    condition = CAMPAIGN.condition(CAMPAIGN.stream(index))
    assert condition is not None
    hidden = [{"name": "tail_off", "parameters": {}, "sigma": 6.0}] if part == "clear" else []
    return {
        "index": index,
        "seed": 5,
        "code": "abc",
        "stratum": part,
        "condition": condition.strata,
        "hidden": hidden,
        "causes": [{"name": said, "probability": 0.9, "log_bayes_factor": 20.0}],
        "confounded_with": [],
        "probability_of_none": 0.9 if said == "none" else 0.1,
        "probability_of_unknown": 0.0,
        "probability_of_truth": [0.9],
        "rank_of_truth": [0] if hidden else [],
        "sizes": [],
        "pair": None,
        "p_value": 0.5,
        "oracle_rank": 0 if hidden else None,
        "oracle_expected": 0.9 if hidden else None,
        "oracle_group": ["tail_off", "pulse_shape"],
        "wall_s": 12.5,
        "cpu_prepare_s": 2.0,
        "cpu_diagnose_s": 10.0,
    } | other


def declined(index: int, part: str) -> dict[str, Any]:
    """A trial that was refused."""
    whole = record(index, part, "none")
    kept = {key: whole[key] for key in ("index", "seed", "code", "stratum", "condition")}
    return kept | {"declined": "event bias-1: too little"}


def records() -> list[dict[str, Any]]:
    """300 empty trials, of which ten are declined and a few wrong, and 100 clear ones."""
    null = [record(i, "null", "none", p_value=(i + 0.5) / 290) for i in range(290)]
    null[3] |= {"causes": [{"name": "unknown", "probability": 0.9, "log_bayes_factor": 9.0}]}
    clear = [record(i, "clear", "pulse_shape" if i % 2 else "tail_off") for i in range(300, 390)]
    clear[0] |= {"causes": [{"name": "none", "probability": 0.9, "log_bayes_factor": 0.0}]}
    refused = [declined(i, "null") for i in range(290, 300)]
    return [*null, *refused, *clear, *(declined(i, "clear") for i in range(390, 400))]


def test_rates_count_a_declined_trial_as_a_miss() -> None:
    """Ten of a hundred clear trials declined: 89 of 100, and 89 of 90 without them."""
    odd = [r for r in records() if r.get("causes", [{}])[0].get("name") != "pulse_shape"]
    table = rates(odd).set_index("rate")
    clear = len([r for r in odd if r["stratum"] == "clear"])
    assert tuple(table.loc[CLEAR, ["hits", "trials"]]) == (clear - 11, clear)
    assert tuple(table.loc[f"{CLEAR}{WITHOUT_DECLINED}", ["hits", "trials"]]) == (
        clear - 11,
        clear - 10,
    )
    assert tuple(table.loc["null: causes[0] is not none", ["hits", "trials"]]) == (1, 290)
    assert table.loc["all: declined before any search", "hits"] == 20
    assert not any("declined" in name for name in rates([r for r in odd if "causes" in r])["rate"])


def level(table: pd.DataFrame, condition: str, name: str, rate: str) -> Any:
    """One row."""
    chosen = table[(table["condition"] == condition) & (table["level"] == name)]
    return chosen.set_index("rate").loc[rate]


def test_levels_are_counted_and_tested() -> None:
    """Counts are those of the records, p-values binomial; honest levels pass, a bad one is named.

    Control: a craft whose empty trials are all false alarms is rejected, after Holm over all.
    """
    found = records()
    table = by_condition(found)
    assert len(table) == 5 * (1 + sum(map(len, LEVELS.values())))
    whole = level(table, "all", "all", "clear: first")
    assert (whole["hits"], whole["trials"], whole["declined"]) == (89, 100, 10)
    assert whole["p"] == pytest.approx(binom.cdf(89, 100, 0.95))
    assert level(table, "all", "all", "clear: first, declined left out")["trials"] == 90
    assert level(table, "all", "all", "null: p < 0.05")["hits"] == 14
    assert level(table, "all", "all", "null: unknown")["hits"] == 1
    for name, levels in LEVELS.items():
        each = [level(table, name, own, "null: false alarm")["trials"] for own in levels]
        assert sum(each) == 290
    tested = table[table["condition"] != "all"]
    assert (tested["p_holm"] > 0.05).all()
    for own in found:
        if own["stratum"] == "null" and "causes" in own and own["condition"]["craft"] == "A branch":
            own["causes"] = [{"name": "tail_off", "probability": 0.9, "log_bayes_factor": 9.0}]
    table = by_condition(found)
    bad = table[(table["p_holm"] <= 0.05) & (table["condition"] == "craft")]
    assert bad[["level", "rate"]].to_numpy().tolist() == [["A branch", "null: false alarm"]]


def test_the_page_has_every_level(tmp_path: Path) -> None:
    """The page of trials over conditions says what was declined, and has a line for every level."""
    for own in records():
        (tmp_path / f"trial_{own['index']:04d}.json").write_text(json.dumps(own))
    write_results(study_in(tmp_path, tmp_path / "page" / "index.md"), OVER_CONDITIONS)
    page = (tmp_path / "page" / "index.md").read_text()
    assert "null 300 of 750, clear 100 of 750" in page
    assert "| all: declined before any search | 20 of 400 |" in page
    assert "**Rejected: 0 of 130.**" in page
    for name, levels in LEVELS.items():
        assert all(f"| {name.replace('_', ' ')} | {own} |" in page for own in levels)
    assert {"conditions.csv", "conditions.png"} <= {p.name for p in (tmp_path / "page").iterdir()}


def test_a_campaign_without_verdicts_has_no_page(tmp_path: Path) -> None:
    """No trials, or only declined ones, are one line, and nothing is written."""
    study = study_in(tmp_path, tmp_path / "page" / "index.md")
    for own in ((), (declined(1, "null"),)):
        for one in own:
            (tmp_path / "trial_0001.json").write_text(json.dumps(one))
        with pytest.raises(InputError, match="finished trials of seed 5 with a verdict"):
            write_results(study, OVER_CONDITIONS)
    assert not study.page.exists()


def test_rates_of_parts_that_were_not_run_are_no_numbers(tmp_path: Path) -> None:
    """Where all trials hide nothing there are rates of false alarms, and none of clear causes."""
    for own in records():
        if own["stratum"] == "null":
            (tmp_path / f"trial_{own['index']:04d}.json").write_text(json.dumps(own))
    found = write_results(study_in(tmp_path, tmp_path / "page" / "index.md"), OVER_CONDITIONS)
    assert any(name.startswith("null") for name in found)
    assert not any(name.startswith("clear") for name in found)
    assert np.isfinite(list(found.values())).all()


@pytest.mark.parametrize(
    "option",
    [
        ("--events", "bias-1"),
        ("--priors", "priors/none.toml"),
        ("--parts", "null", "--results-only"),
    ],
)
def test_options_that_would_be_passed_over_are_refused(
    option: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """Conditions draw events and have priors of both craft; a page is of all parts there are."""
    assert run_cases.command(("calibrate", "blind", "--conditions", *option)) == 2
    assert capsys.readouterr().err.startswith(f"error: {option[0]}: ")
