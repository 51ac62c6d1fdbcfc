"""Held-out scores of totals rows against importance sampling, and a row that does not belong."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.diagnosis.diagnosis import catalogue_of, diagnose
from cassini_bayes.diagnosis.evidence import Weighed
from cassini_bayes.diagnosis.extended import Case, none_hypothesis, prepare
from cassini_bayes.diagnosis.gain import HeldOut
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.diagnosis.totals_gain import held_out_totals
from cassini_bayes.effects.catalogue import Catalogue
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model import build_model, log_posterior
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.report.diagnosis import gain_sentence
from cassini_bayes.sampling.warmstart import warm_start

ROOT = Path(__file__).parents[2]
PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_2010.toml")
FLIGHT = ROOT / "cassini_bayes" / "published" / "flight_2009_2010.csv"


@cache
def three() -> tuple[TotalsEvent, ...]:
    """The first three flight biases."""
    return read_totals(str(FLIGHT), PRIORS.spacecraft, "flight")[:3]


def scored(rows: tuple[TotalsEvent, ...]) -> HeldOut:
    """The baseline's scores of rows held out in turn."""
    case: Case = prepare((), PRIORS, rows)
    catalogue: Catalogue = catalogue_of(case)
    none = none_hypothesis(case, catalogue)
    d = none.dimension
    # searches start from the mode, so the prior's own does
    weighed = Weighed(none, Mode(np.zeros(d), 0.05 * np.eye(d), 0.0), 0.0, 0.0)
    return held_out_totals(case, rows, catalogue, weighed, np.random.default_rng(1))


def sampled(rows: tuple[TotalsEvent, ...]) -> float:
    """Log evidence of rows by importance sampling of the totals posterior."""
    model = build_model(rows, PRIORS)
    start = warm_start(
        lambda z: log_posterior(model, z), model.space.dimension, np.random.default_rng(1)
    )
    return start.draws.log_evidence


@cache
def plain() -> HeldOut:
    """Scores of the three as they were flown."""
    return scored(three())


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
    assert found.rmse_n_m_s > 2.0 * plain().rmse_n_m_s
    assert found.coverage_90 < plain().coverage_90


@pytest.mark.parametrize("has_rows", [True, False])
def test_a_diagnosis_holds_its_rows_out(has_rows: bool) -> None:
    """With its rows a diagnosis has the scores of these; without them its gain is not measured."""
    case = prepare((), PRIORS, three())
    catalogue = catalogue_of(case)
    few = replace(catalogue, effects=(catalogue.effect("thrust_scale"),))
    rows = three() if has_rows else ()
    record = diagnose(case, few, np.random.default_rng(3), rows=rows).record
    assert (record["gain"]["elpd_diff"] is not None) == has_rows
    if has_rows:
        # searches from different starts end within a slope of 0.1 nats, four of them to a sum
        assert record["baseline"]["elpd"] == pytest.approx(plain().elpd, abs=0.05)
        assert record["baseline"]["heldout_rmse_nms"] == pytest.approx(plain().rmse_n_m_s, rel=0.1)
    assert ("not a mix" in gain_sentence(record)) != has_rows
