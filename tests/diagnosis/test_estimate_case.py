"""Evidence of printed estimates against closed forms, where the prior's own draws fail."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm, truncnorm

from cassini_bayes.diagnosis.diagnosis import Diagnosis, diagnose
from cassini_bayes.diagnosis.estimate_case import Candidate, EstimateCase, untrusted
from cassini_bayes.diagnosis.estimates import (
    EstimateHypothesis,
    Prediction,
    positive_normal,
    read_estimates,
)
from cassini_bayes.diagnosis.read import read_estimate_case
from cassini_bayes.diagnosis.verdict import ranked
from cassini_bayes.errors import InputError
from cassini_bayes.pipeline.diagnoses import DiagnosisResult
from cassini_bayes.studies.published_cases import a_branch, flight_2004, fsds

ROOT_FOLDER = Path(__file__).parents[2]
ROOT = np.array([[3.0, 0.0, 0.0], [1.0, 2.0, 0.0], [0.5, -1.0, 1.0], [2.0, 0.3, -0.4]])
TARGET = np.array([24.0, -2.0, 3.0, 17.0])  # eight prior standard deviations along the first
SD = np.full(4, 0.02)


def predict(z: np.ndarray) -> Prediction:
    """A linear model: estimates ROOT z, no spread of their own."""
    estimate = z @ ROOT.T
    return Prediction(estimate, np.zeros_like(estimate), {"first": z[:, 0]})


FAR = EstimateHypothesis("far", 1.0, 3, predict)
CASE = EstimateCase(("a", "b", "c", "d"), TARGET, SD, lambda _: [FAR])


def weighed(draws: int) -> Candidate:
    """The hypothesis with that many draws."""
    (found,) = CASE.weighed([FAR], np.random.default_rng(1), draws)
    return found


def log_evidence(kept: np.ndarray) -> float:
    """Closed form N(y; 0, ROOT ROOTᵀ + SD²)."""
    own = ROOT[kept]
    covariance = own @ own.T + np.diag(SD[kept] ** 2)
    return float(multivariate_normal(np.zeros(len(own)), covariance).logpdf(TARGET[kept]))


def test_far_posterior_has_its_closed_form_evidence() -> None:
    """Eight prior standard deviations out, evidence, mean and width are the closed form's."""
    found = weighed(40_000)
    size = CASE.sizes(found, np.random.default_rng(1))["first"]
    assert found.log_evidence == pytest.approx(log_evidence(np.arange(4)), abs=0.05)
    precision = np.eye(3) + ROOT.T @ ROOT / SD[0] ** 2
    mean = np.linalg.solve(precision, ROOT.T @ TARGET / SD[0] ** 2)
    sd = np.sqrt(np.linalg.inv(precision)[0, 0])
    assert size.mean == pytest.approx(mean[0], abs=0.1 * sd)
    assert size.sd == pytest.approx(sd, rel=0.1)
    assert untrusted([found]) == ""


def test_estimates_have_no_model_to_sample(tmp_path: Path) -> None:
    """One line, before anything is written."""
    with pytest.raises(InputError, match="expected telemetry or totals"):
        CASE.refit(weighed(100), tmp_path / "fit", 1)
    assert not list(tmp_path.iterdir())


def test_draws_of_a_cause_go_to_arviz() -> None:
    """Resampled by their weights, they have the size's mean and width."""
    found = weighed(4_000)
    named = SimpleNamespace(case=CASE, extended=found, verdict=SimpleNamespace(weighed=()))
    data = DiagnosisResult(cast(Diagnosis[EstimateHypothesis], named), 1).to_arviz(4_000)
    size = CASE.sizes(found, np.random.default_rng(1))["first"]
    drawn = data.posterior["first"].values
    assert abs(drawn.mean() - size.mean) < 0.1 * size.sd
    assert drawn.std() == pytest.approx(size.sd, rel=0.1)


def test_draws_from_the_prior_alone_fail_there() -> None:
    """Negative control: as many plain prior draws miss the same evidence by far."""
    z = np.random.default_rng(1).standard_normal((40_000, 3))
    misfit = ((TARGET - predict(z).estimate_n) / SD) ** 2
    score = -0.5 * misfit.sum(-1) - np.log(SD).sum() - 2.0 * np.log(2.0 * np.pi)
    plain = float(np.logaddexp.reduce(score)) - np.log(40_000)
    assert abs(plain - log_evidence(np.arange(4))) > 100.0


def test_too_few_draws_are_told() -> None:
    """With two hundred draws the hypothesis is named as not to be relied upon."""
    assert "far" in untrusted([weighed(200)])


def test_left_out_scores_are_differences_of_closed_forms() -> None:
    """Every log score is log Z(all) − log Z(others), every residual that of the others' fit."""
    found = CASE.held_out(weighed(200), np.random.default_rng(1))
    assert found is not None
    assert found.residual is not None
    for place in range(4):
        kept = np.delete(np.arange(4), place)
        wanted = log_evidence(np.arange(4)) - log_evidence(kept)
        # no more than the Monte Carlo error of two evidences, three standard errors each
        assert found.log_scores[place] == pytest.approx(wanted, abs=0.15)
        precision = np.eye(3) + ROOT[kept].T @ ROOT[kept] / SD[0] ** 2
        mean = np.linalg.solve(precision, ROOT[kept].T @ TARGET[kept] / SD[0] ** 2)
        residual = TARGET[place] - ROOT[place] @ mean
        assert found.residual[place] == pytest.approx(residual, abs=0.02)


@pytest.mark.parametrize(("mean", "sd"), [(0.0, 0.2), (0.065, 0.0625), (0.065, 0.0005)])
def test_positive_normal_is_the_truncated_normal(mean: float, sd: float) -> None:
    """Its quantiles are those of a normal cut off at zero, in both tails; sd 0 is a constant."""
    z = np.linspace(-7.0, 7.0, 29)
    wanted = truncnorm(-mean / sd, np.inf, loc=mean, scale=sd)
    found = positive_normal(z, mean, sd)
    assert found[z <= 0] == pytest.approx(wanted.ppf(norm.cdf(z[z <= 0])), rel=1e-6, abs=1e-12)
    assert found[z > 0] == pytest.approx(wanted.isf(norm.sf(z[z > 0])), rel=1e-6)
    assert positive_normal(z, mean, 0.0) == pytest.approx(mean)
    assert np.isfinite(positive_normal(np.array([-60.0, 60.0]), mean, sd)).all()


def test_far_shift_of_the_a_branch_has_its_evidence_by_quadrature() -> None:
    """The c.m. shift of paper 003's branch, 24 baseline prior sd away, by a double integral.

    The shift along X is held at zero, so that thrust level and shift along Y are left.
    """
    branch, case = a_branch()
    shifted = replace(branch, cm_sd_m={"x": 1e-9, "y": 5.0 * branch.cm_sd_m["y"]})
    rng = np.random.default_rng(1)
    (found,) = case.weighed([shifted.hypothesis("y", 1.0)], rng, 40_000)

    def density(level: float, shift: float) -> float:
        own = shifted.predict(np.array([[level, 0.0, shift]]))
        sd = np.hypot(case.sd_n, own.independent_sd_n[0])
        value = norm.logpdf(case.estimate_n, own.estimate_n[0], sd).sum()
        return float(np.exp(value + norm.logpdf(level) + norm.logpdf(shift)))

    levels = np.linspace(-3.0, 2.0, 81)
    inner = [quad(lambda s, a=a: density(a, s), -9.0, 1.0, limit=60)[0] for a in levels]
    wanted = float(np.log(np.trapezoid(inner, levels)))
    assert found.log_evidence == pytest.approx(wanted, abs=0.03)
    shift = case.sizes(found, rng)["cm_y shift (m)"]
    assert shift.mean == pytest.approx(-0.137, abs=0.003)


def test_published_cases_say_what_the_docs_say() -> None:
    """The closed form explains the FSDS case; the flight biases do not need a cause."""
    firsts = {}
    for name, case in (("c", fsds()), ("b", flight_2004()), ("d", a_branch()[1])):
        found = case.weighed(case.hypotheses(1.0), np.random.default_rng(1), 60_000)
        firsts[name] = ranked(found)
    assert firsts["c"].best.name == "pulse_shape, first-order closed form"
    assert firsts["b"].best.name == "none"
    assert firsts["d"].probabilities["none"] < 1e-6


TABLE_2 = ROOT_FOLDER / "priors" / "cassini_a_branch_2004_estimates.csv"


def test_estimates_of_table_2_weigh_like_the_published_case() -> None:
    """The example file gives the probabilities of the published case (b), built another way."""
    case = read_estimate_case([str(TABLE_2)], TABLE_2.with_suffix(".toml"))
    record = diagnose(case, np.random.default_rng(1)).record
    found = {cause["name"]: cause["probability"] for cause in record["causes"]}
    other = flight_2004()
    wanted = ranked(other.weighed(other.hypotheses(1.0), np.random.default_rng(2)))
    assert sum(found.values()) == pytest.approx(1.0)
    for name, probability in wanted.probabilities.items():
        assert found[name] == pytest.approx(probability, abs=0.01)
    # none is first: nothing is added, nothing gained
    assert (record["gain"]["elpd_diff"], record["gain"]["verdict"]) == (0.0, "no gain")
    assert record["baseline"]["rmse_nms"] is None
    assert record["baseline"]["rmse_n"] == pytest.approx(0.014, abs=1e-3)


def test_estimates_that_nothing_tells_apart_are_one_group() -> None:
    """Five biases with pulses of one width: whatever scales them is confounded with the rest."""
    case = flight_2004()
    verdict = ranked(case.weigh(np.random.default_rng(1), lambda _: None))
    assert verdict.best_cause is not None
    assert {"tail_off", "pulse_shape", "thrust_scale"} <= {
        verdict.best_cause.name,
        *verdict.confounded_with(verdict.best_cause.name),
    }


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("0.82,", "much,", "line 7, column thrust_n"),
        ("0.125,no", "0.125;0.25,no", "line 5, column on_time_per_pulse_s"),
        ("all,0.80", "q9,0.80", "line 5, column thruster"),
        ("pulses,on", "pulse,on", "line 4"),
    ],
)
def test_bad_estimates_are_refused(tmp_path: Path, old: str, new: str, told: str) -> None:
    """File, row and column of a bad cell are named in one line."""
    path = tmp_path / "estimates.csv"
    path.write_text(TABLE_2.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=told) as caught:
        read_estimates(path, ("z1a",))
    assert "\n" not in str(caught.value)


HEADER = (
    "id,thruster,thrust_n,thrust_sd_n,shared_sd,pulses,on_time_per_pulse_s,tail_corrected,source"
)


def table(path: Path, *rows: tuple[str, str]) -> Path:
    """A CSV of estimates of 0.8 N with these ids and shared errors."""
    lines = [f"{name},all,0.8,0.02,{shared},100,0.125,no,x" for name, shared in rows]
    path.write_text("\n".join([HEADER, *lines]), encoding="utf-8")
    return path


def test_estimates_of_two_files_are_read_as_those_of_one(tmp_path: Path) -> None:
    """The same case, whichever rows lie in which file."""
    one = table(tmp_path / "one.csv", ("a", "0.02"), ("b", "0.02"))
    first, second = (table(tmp_path / f"{name}.csv", (name, "0.02")) for name in "ab")
    priors = TABLE_2.with_suffix(".toml")
    whole = read_estimate_case([str(one)], priors)
    apart = read_estimate_case([str(first), str(second)], priors)
    assert apart.names == whole.names
    np.testing.assert_array_equal(apart.estimate_n, whole.estimate_n)


@pytest.mark.parametrize(
    ("row", "told"),
    [
        (("b", "0.2"), r"e2.csv: line 2, column shared_sd.*0.02 as in .*e1.csv: line 2"),
        (("a", "0.02"), r"e2.csv: line 2, column id.*e1.csv: line 2"),
    ],
)
def test_estimates_that_do_not_go_together_are_refused(
    tmp_path: Path, row: tuple[str, str], told: str
) -> None:
    """What all share differs, or one observation is there twice: both files are named.

    The first file's shared error had been that of all, and the same estimate had counted twice.
    """
    files = table(tmp_path / "e1.csv", ("a", "0.02")), table(tmp_path / "e2.csv", row)
    with pytest.raises(InputError, match=told):
        read_estimate_case([str(path) for path in files], TABLE_2.with_suffix(".toml"))
    table(tmp_path / "e1.csv", ("a", "0.02"), row)
    with pytest.raises(InputError, match=r"e1.csv: line 3, column"):
        read_estimate_case([str(files[0])], TABLE_2.with_suffix(".toml"))
