"""Blind trials of two-wheel events: what is hidden, what is drawn, what the page says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study_cases import study_in

from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.verdict import weigh
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.studies.blind import campaign as blind_campaign
from cassini_bayes.studies.blind.flights import CHANNEL_NOISE, Blind, Hidden
from cassini_bayes.studies.blind.strata import STRATA, TWO_WHEELS, planned, stratum_of
from cassini_bayes.studies.blind.trials import draw_effect
from cassini_bayes.studies.blind.two_wheels import run_two_wheels, trial_table

SCENARIO = Path("runs/scenarios/hybrid_2012.toml")
PRIORS = Path("priors/cassini_hybrid_2012.toml")
WEIGHED = ("wheel_articulation:4", "rate_scale:y", "inertia:xx", "external_torque")
ANGLE = "rwa4_articulation_rad"
CAMPAIGN = Blind(SCENARIO, PRIORS, 5, ("mosaic",), TWO_WHEELS, all_drawn=True)


def test_any_first_part_of_a_campaign_holds_its_strata_in_proportion() -> None:
    """A full round has every stratum as often as planned, a third of it a third of each."""
    for strata in (STRATA, TWO_WHEELS):
        names = [stratum_of(strata, index).name for index in range(planned(strata))]
        for stratum in strata:
            assert names.count(stratum.name) == stratum.trials
            early = names[: planned(strata) // 3].count(stratum.name)
            assert abs(early - stratum.trials / 3) <= 1.0


def test_a_trial_draws_what_the_priors_know() -> None:
    """Truth, noise and the mosaic's wheel rates are drawn; steps of telemetry stay as they are."""
    priors = read_priors(PRIORS)
    one, other = (CAMPAIGN.scene(np.random.default_rng(seed), priors) for seed in (1, 2))
    assert not one.document["truth"].keys() & priors.parameters.keys()
    assert not set(CHANNEL_NOISE) & one.document["telemetry"].keys()
    assert one.document["telemetry"]["wheel_resolution_rpm"] == 0.1
    (mosaic,), (again,) = one.document["event"], other.document["event"]
    assert len(mosaic["from_rpm"]) == 2
    assert mosaic["from_rpm"] != again["from_rpm"]
    angles = [scene.truth().parameters[ANGLE] for scene in (one, other)]
    assert angles[0] != angles[1]
    spin = Blind(SCENARIO, PRIORS, 5, ("spin-up",)).document(np.random.default_rng(1))
    assert spin["event"][0]["from_rpm"] == [734.92, 626.30]  # its spin follows from them


def test_a_stratum_hides_effects_of_its_kind_alone() -> None:
    """Platforms in the one, any thruster's leak in the other; others draw from all causes."""
    priors = read_priors(PRIORS)
    catalogue = CAMPAIGN.scene(np.random.default_rng(1), priors).fly(()).catalogue
    rng = np.random.default_rng(3)
    drawn = {
        stratum.name: {draw_effect(catalogue, rng, stratum.kind).name for _ in range(80)}
        for stratum in TWO_WHEELS
    }
    assert drawn["articulation"] == {"wheel_articulation:4"}
    assert {name.partition(":")[0] for name in drawn["leak"]} == {"thruster_leak"}
    assert len(drawn["leak"]) == 8
    assert len({name.partition(":")[0] for name in drawn["null"]}) > 5


def test_a_platform_hidden_in_a_mosaic_is_named() -> None:
    """80 mrad, eight prior widths, in a mosaic: named first of some causes; without it, none is."""
    priors = read_priors(PRIORS)
    scene = CAMPAIGN.scene(np.random.default_rng(8), priors)
    hidden = Hidden("wheel_articulation:4", {ANGLE: scene.truth().parameters[ANGLE] + 0.08}, 0.0)
    for effects, first in (((hidden,), "wheel_articulation:4"), ((), "none")):
        events = scene.fly(effects)
        some = tuple(effect for effect in events.catalogue.effects if effect.name in WEIGHED)
        events = replace(events, catalogue=replace(events.catalogue, effects=some))
        verdict = weigh(BalanceCase(events), np.random.default_rng(1), pairs=False)
        assert verdict.best.name == first


def record(index: int, stratum: str, hidden: str | None, said: str, **other: Any) -> dict[str, Any]:
    """A finished trial made up by hand."""
    size = {"parameter": ANGLE, "true": -1.6, "mean": -1.61, "sd": 0.01, "covers": True}
    return {
        "index": index,
        "seed": 5,
        "code": "abc",
        "stratum": stratum,
        "hidden": [{"name": hidden, "parameters": {}, "sigma": 6.0}] if hidden else [],
        "causes": [{"name": said, "probability": 0.9, "log_bayes_factor": 20.0}],
        "confounded_with": [],
        "probability_of_truth": [0.9 if said == hidden else 0.05],
        "sizes": [size] if hidden else [],
    } | other


RECORDS = (
    record(0, "null", None, "none"),
    record(1, "articulation", "wheel_articulation:4", "wheel_articulation:4"),
    record(2, "articulation", "wheel_articulation:4", "wheel_alignment:4")
    | {"confounded_with": ["wheel_articulation:4"]},
    record(3, "articulation", "wheel_articulation:4", "rate_scale:y"),
    {"index": 4, "seed": 5, "code": "abc", "stratum": "leak", "error": "ValueError: bad"},
)


def test_sizes_are_departures_from_the_priors_mean() -> None:
    """An angle of −1.6 rad about a mean of −1.644 is off by 44 mrad; a failed trial names none."""
    table = trial_table("mosaic", RECORDS, read_priors(PRIORS)).set_index("trial")
    assert table.loc[1, "size"] == pytest.approx(0.0441001553)
    assert table.loc[1, "found"] == pytest.approx(0.0341001553)
    assert table["named"].to_list() == [True, True, True, False, False]
    assert table["itself"].to_list() == [True, True, False, False, False]


def test_the_page_counts_and_lists(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rates by stratum, a line for every trial that named something else, table and figure."""
    by_index = {own["index"]: own for own in RECORDS}
    monkeypatch.setattr(blind_campaign, "trial_code", lambda: "abc")
    monkeypatch.setattr(blind_campaign, "run_trial", lambda _, index: by_index[index])
    study = study_in(tmp_path, tmp_path / "two-wheels.md")
    run_two_wheels(study, SCENARIO, PRIORS, ["mosaic"], len(RECORDS))
    text = study.page.read_text(encoding="utf-8")
    assert "| mosaic | articulation | 3 | 2 | 0.09 … 0.99 | 1 |" in text
    assert "| 3 of 3 | 10 mrad (23%) |" in text
    assert "| mosaic | 3 | wheel_articulation:4 | 6.0 | rate_scale:y | 0.900 |" in text
    assert "failed: ValueError: bad" in text
    assert (tmp_path / "two-wheels.csv").exists()
    assert (tmp_path / "two-wheels.png").exists()
