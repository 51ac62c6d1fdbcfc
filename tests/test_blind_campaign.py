"""The blind campaign's counts and page, from records made up by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cassini_bayes.blind_campaign import (
    first,
    interval,
    named,
    rates,
    read_trials,
    reliability,
    write_results,
)


def record(index: int, stratum: str, hidden: str | None, said: str, **other: Any) -> dict[str, Any]:
    """One finished trial."""
    size = {"parameter": "p", "true": 1.0, "low": 0.5, "high": 1.5, "covers": True}
    return {
        "index": index,
        "seed": 5,
        "code": "abc",
        "stratum": stratum,
        "hidden": [{"name": hidden, "parameters": {}, "sigma": 6.0}] if hidden else [],
        "causes": [
            {"name": said, "probability": 0.9, "log_bayes_factor": 20.0},
            {"name": "none" if said != "none" else "tail_off", "probability": 0.1}
            | {"log_bayes_factor": 0.0},
        ],
        "confounded_with": [],
        "probability_of_none": 0.9 if said == "none" else 0.1,
        "probability_of_unknown": 0.0,
        "probability_of_truth": [0.9],
        "rank_of_truth": [0 if said == hidden else 4],
        "sizes": [size] if hidden else [],
        "pair": None,
        "p_value": 0.4,
        "cpu_prepare_s": 2.0,
        "cpu_diagnose_s": 10.0,
    } | other


RECORDS = (
    record(0, "null", None, "none"),
    record(1, "null", None, "tail_off"),
    record(2, "clear", "tail_off", "tail_off"),
    record(3, "clear", "pulse_shape", "tail_off", confounded_with=["pulse_shape"]),
    record(4, "clear", "time_offset", "rate_scale:z"),
    record(5, "uncatalogued", "pressure_surge", "unknown"),
    record(6, "prior", "tail_off", "tail_off"),
    record(7, "two", "tail_off", "tail_off", pair="tail_off+inertia:xx")
    | {"hidden": [{"name": n, "parameters": {}, "sigma": 6.0} for n in ("inertia:xx", "tail_off")]},
)


def test_a_named_cause_is_the_hidden_one_or_in_its_group() -> None:
    """A confounded group counts; a wrong name, or any name where nothing is hidden, does not."""
    assert [named(r) for r in RECORDS[:5]] == [True, False, True, True, False]
    assert first(RECORDS[4]) == "rate_scale:z"


def test_rates_are_counted_by_part() -> None:
    """Counts of every rate are those of the records by hand."""
    table = rates(RECORDS).set_index("rate")
    assert table.loc["clear: named first (confounded group counts)", "hits"] == 2
    assert table.loc["clear: named first, name alone", "hits"] == 1
    assert table.loc["null: causes[0] is not none", "hits"] == 1
    assert table.loc["uncatalogued, detected: unknown first", "hits"] == 1
    assert table.loc["two: both named", "hits"] == 1
    low, high = interval(2, 3)
    assert table.loc["clear: named first (confounded group counts)", "low_95"] == low
    assert high < 1.0
    assert reliability(RECORDS)["right"].to_list() == [1.0]


def test_page_lists_failures_and_claims_no_goal_on_few_trials(tmp_path: Path) -> None:
    """The page holds every wrong trial, how many there are, and calls no goal reached."""
    for own in RECORDS:
        (tmp_path / f"trial_{own['index']:04d}.json").write_text(json.dumps(own))
    (tmp_path / "trial_0099.json").write_text(json.dumps({**RECORDS[0], "seed": 6}))
    assert len(read_trials(tmp_path, 5)) == len(RECORDS)
    write_results(tmp_path, tmp_path / "page", 5, ["command"])
    page = (tmp_path / "page" / "index.md").read_text()
    assert "8 trials" in page
    assert "| 4 | clear | time_offset | 6.00 | rate_scale:z | 0.900 |" in page
    assert "| 3 | clear" not in page
    assert "reached" not in page
    assert "not excluded" in page
    assert {p.name for p in (tmp_path / "page").iterdir()} >= {
        "blind.png",
        "confusion.png",
        "rates.csv",
        "trials.csv",
    }


def test_rate_of_no_trials_is_open() -> None:
    """No trials leave the whole interval."""
    assert interval(0, 0) == (0.0, 1.0)
    assert rates(RECORDS[:1]).set_index("rate").loc["two: both named", "trials"] == 0
    assert interval(5, 5)[0] == pytest.approx(0.025 ** (1 / 5))
