"""Predictions and plans from a fit: what a fit cannot answer is refused, what is doubtful said."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from prediction_cases import write_run_folder
from totals_cases import B_BRANCH

import cassini_bayes as cb
from cassini_bayes.errors import InputError
from cassini_bayes.pipeline.predictions import beyond_trend
from cassini_bayes.prediction.requests import BiasRequest


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """fit.nc in a run folder that no test changes."""
    return write_run_folder(tmp_path_factory.mktemp("run"))


def test_a_wheel_that_no_event_turned_is_refused(tmp_path: Path) -> None:
    """Priors may list wheel 3: its ramp was never seen, so that neither verb takes it."""
    priors = tmp_path / "four.toml"
    text = B_BRANCH.read_text(encoding="utf-8")
    assert "wheels = [1, 2, 4]" in text
    priors.write_text(text.replace("wheels = [1, 2, 4]", "wheels = [1, 2, 3, 4]"), "utf-8")
    fit = write_run_folder(tmp_path, priors=priors)
    with pytest.raises(InputError, match="prime wheels rwa1, rwa2, rwa4"):
        cb.predict(fit, "rwa1: 0 -> 500, rwa3: 0 -> 500")
    with pytest.raises(InputError, match="prime wheels 1, 2, 4, got wheel 3"):
        cb.plan(fit, "thrust_mean_n", start="rwa1: 400, rwa3: 500", levels=1)


def test_ids_of_biases_are_checked_wherever_they_come_from(fit: Path, tmp_path: Path) -> None:
    """Rows of a CSV and requests of a program: nothing is predicted, nothing written."""
    path = tmp_path / "planned.csv"
    path.write_text("id,rwa1_rpm_start,rwa1_rpm_end\n../../escape,0,500\n")
    with pytest.raises(InputError, match=r"planned\.csv: id"):
        cb.predict(fit, path)
    path.write_text("id,rwa1_rpm_start,rwa1_rpm_end\nsame,0,500\nsame,0,600\n")
    with pytest.raises(InputError, match="'same' twice"):
        cb.predict(fit, path)
    request = BiasRequest("a/b", (1,), np.zeros(1), np.full(1, 500.0))
    with pytest.raises(InputError, match="bias: id"):
        cb.predict(fit, request)


@pytest.mark.parametrize(
    ("idle", "said"),
    [
        ({"quantity": "cm_x_m", "to": "rwa4: 700"}, "--to: expected --minimise beside it"),
        ({"quantity": "cm_x_m", "limit": 80.0}, "--limit: expected --minimise"),
        ({"minimise": "z_throughput", "budget": 10.0}, "--budget: expected --quantity"),
        ({"minimise": "z_throughput", "levels": 5}, "--levels: expected --quantity"),
        ({"minimise": "z_throughput", "top": 1}, "--top: expected --quantity"),
    ],
)
def test_options_of_the_other_kind_of_plan_are_refused(
    fit: Path, idle: dict[str, Any], said: str
) -> None:
    """What would not be read is not accepted in silence, the defaults' own values included."""
    with pytest.raises(InputError, match=said):
        cb.plan(fit, **idle)


def test_a_fit_that_has_not_converged_says_so_of_what_is_made_of_it(
    fit: Path, tmp_path: Path
) -> None:
    """Last of the warnings, with what failed and what to do; a fit that has is not doubted."""
    worse = write_run_folder(tmp_path, stop_rule="R-hat 1.08")
    made = (
        lambda own: cb.predict(own, "rwa1: 0 -> 500"),
        lambda own: cb.plan(own, "cm_x_m", levels=1),
        lambda own: cb.plan(own, minimise="z_throughput", to="rwa1: 400, rwa4: 700"),
    )
    for make in made:
        good, bad = make(fit), make(worse)
        assert good.converged
        assert not any("fit" in sentence for sentence in good.warnings)
        assert not bad.converged
        assert "R-hat 1.08" in bad.warnings[-2]
        assert bad.warnings[-1].startswith("NOT CONVERGED: ")
        assert bad.as_record()["warnings"] == list(bad.warnings)
        assert bad.as_record()["converged"] is False


def test_an_epoch_beyond_the_trend_is_doubted(fit: Path) -> None:
    """Draws without thrust are counted; a year on there are none, twenty years on there are."""
    near, far = (
        cb.predict(fit, "rwa1: 0 -> 500", epoch=own) for own in ("2011-03-01", "2030-03-01")
    )
    assert near.predictions[0].powerless == 0.0
    assert not any("no thrust" in sentence for sentence in near.warnings)
    share = far.predictions[0].powerless
    assert 0.0 < share < 1.0
    assert any(
        sentence.startswith(f"planned: in {100.0 * share:.0f} % of the draws")
        for sentence in far.warnings
    )


def test_a_share_of_draws_is_whole_per_cent_and_never_none() -> None:
    """All draws are 100 %, and a few of thousands not 0 %."""
    learned = SimpleNamespace(last_epoch=pd.Timestamp("2010-03-29"))
    for share, said in ((1.0, "100 %"), (0.23, "23 %"), (2e-4, "less than 1 %")):
        own = SimpleNamespace(
            powerless=share, request=SimpleNamespace(id="x"), epoch=pd.Timestamp("2200-01-01")
        )
        (sentence,) = beyond_trend([own], learned)  # type: ignore[list-item, arg-type]
        assert sentence.startswith(f"x: in {said} of the draws a thruster has no thrust left on")


def test_a_seed_of_numpy_is_written_as_a_number(fit: Path) -> None:
    """Its draws are those of the same plain number."""
    one, other = (cb.predict(fit, "rwa1: 0 -> 500", seed=seed) for seed in (np.int64(2), 2))
    assert json.loads(json.dumps(one.as_record()))["seed"] == 2
    drawn = (found.predictions[0].on_time_s for found in (one, other))
    np.testing.assert_array_equal(*drawn)
