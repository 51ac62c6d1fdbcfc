"""A run on event folders and a totals row, from files to the page, truths inside."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from event_cases import PRIORS, events, model, priors, simulated
from test_run import Silent

from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import read_totals, write_totals
from cassini_bayes.model import collapse, draw, event_log_density
from cassini_bayes.model.telemetry import unknowns_of
from cassini_bayes.model.thrusts import normal_log_density
from cassini_bayes.pipeline.inputs import read_inputs
from cassini_bayes.pipeline.run import Outcome, execute
from cassini_bayes.pipeline.run_file import check_run
from cassini_bayes.report import pictures_of, render_report, sections_of
from cassini_bayes.report.page import Chapter
from cassini_bayes.results import fitting
from cassini_bayes.results.record import GROUPS, read_fit
from cassini_bayes.sampling.ensembles import SamplerSettings
from cassini_bayes.sampling.warmstart import WarmStart

pytestmark = pytest.mark.usefixtures("short_warm_start")
CHAPTERS = (Chapter.OBSERVABILITY, Chapter.INERTIA, Chapter.THRUSTS, Chapter.CHECKS)
SAMPLER = {"ensembles": 2, "walkers": 56, "target_ess": 100, "first_check": 64, "max_steps": 100}
OUTPUT = {"report": False, "draws_per_ensemble": 500, "prior_draws": 500}


def table(folder: Path) -> dict[str, object]:
    """Two event folders, and the bias once more as a totals row under another id."""
    row = read_totals(str(simulated() / "totals.csv"), priors().spacecraft, "simulation")[0]
    renamed = row.__class__(**{**row.__dict__, "id": "bias-again"})
    write_totals(folder / "again.csv", (renamed,), priors().spacecraft)
    return {
        "events": [
            str(simulated() / "bias"),
            str(folder / "again.csv"),
            str(simulated() / "slews"),
        ],
        "priors": str(PRIORS),
        "source": "simulation",
        "sampler": SAMPLER,
        "output": OUTPUT,
    }


def do(content: dict[str, object], folder: Path, *, resume: bool = False) -> tuple[Outcome, Silent]:
    """Execute a run, and what it said."""
    reporter = Silent()
    outcome = execute(
        check_run(content, "test"),
        Path(),
        folder,
        name="mixed",
        command=["test"],
        reporter=reporter,
        resume=resume,
    )
    return outcome, reporter


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Silent]:
    """One mixed run that several tests look at."""
    folder = tmp_path_factory.mktemp("mixed")
    return do(table(folder), folder / "run")


@cache
def truth() -> dict[str, float]:
    """True parameters of the simulation."""
    content = json.loads((simulated() / "truth.json").read_text())
    return dict(content["parameters"])


def test_a_mixed_run_is_complete(mixed: tuple[Outcome, Silent]) -> None:
    """Every group, the names of the format, tables, figures and the page are there."""
    folder = mixed[0].folder
    fit = read_fit(folder / "fit.nc")
    assert set(fit.groups) == set(GROUPS)
    names = {"thrust_n", "rwa_inertia_kg_m2", "external_torque_n_m", "cm_x_m", "tau_fall_s"}
    names |= {f"inertia_{e}_kg_m2" for e in ("xx", "yy", "zz", "xy", "xz", "yz")}
    assert names <= set(fit.posterior.data_vars)
    assert all(v.attrs.keys() >= {"units", "long_name"} for v in fit.posterior.data_vars.values())
    assert list(fit.posterior.coords["event"].values) == ["bias-again", "bias", "slews"]
    stored = {path.name for path in (folder / "tables").iterdir()}
    assert {"inertia.csv", "inertia_methods.csv", "observability.csv", "telemetry.csv"} <= stored
    provenance = json.loads((folder / "provenance.json").read_text())
    assert provenance["sha256"][str(simulated() / "bias")] == events("bias")[0].digest


def test_the_page_shows_what_telemetry_adds(mixed: tuple[Outcome, Silent]) -> None:
    """Sections, tables and pictures of telemetry are on the page, and those of totals rows stay."""
    review = mixed[0].review
    sections = sections_of(review)
    drawn = pictures_of([own for own in sections if own.chapter in CHAPTERS])
    assert {"observability", "inertia", "thrusts", "balance", "series_1", "series_2"} <= set(drawn)
    page = render_report(review, sections, drawn)
    for words in (
        "Thrust and inertia, with their uncertainty",
        "What these events can see",
        "Telemetry, row by row",
        "paper 000 eqs. 18–23",
        "On-times",
        "less the wheels&#39; spin inertia",
    ):
        assert words in page, words
    assert page.count("<figure") == len(drawn)


def test_a_slew_has_no_thrust_and_everything_else_is_finite(mixed: tuple[Outcome, Silent]) -> None:
    """NaN only where an event has no such quantity; the summary lists what there is."""
    fit = read_fit(mixed[0].folder / "fit.nc")
    thrust = fit.posterior["thrust_n"]
    assert np.isnan(thrust.sel(event="slews").values).all()
    assert np.isfinite(thrust.sel(event=["bias", "bias-again"]).values).all()
    assert np.isnan(fit.posterior["initial_momentum_n_m_s"].sel(event="bias-again").values).all()
    assert np.isfinite(fit.groups["log_likelihood"]["event_data"].values).all()
    summary = mixed[0].review.summary
    assert len(summary[summary["quantity"] == "thrust_n"]) == 2 * 8
    assert len(summary[summary["quantity"] == "external_torque_n_m"]) == 3 * 3
    assert np.isfinite(summary[["mean", "sd", "prior_sd"]].to_numpy()).all()


def test_truths_lie_inside(mixed: tuple[Outcome, Silent]) -> None:
    """True inertia and tail-off within four posterior standard deviations, most within two."""
    summary = mixed[0].review.summary.set_index("name")
    names = [
        name for name in summary.index if name.startswith(("inertia_", "tau_", "cm_", "thruster"))
    ]
    names = [name for name in names if name in truth()]
    assert len(names) >= 12
    score = np.array([(summary.loc[n, "mean"] - truth()[n]) / summary.loc[n, "sd"] for n in names])
    assert np.abs(score).max() < 4.0
    assert (np.abs(score) < 2.0).mean() > 0.7


def test_the_rows_lie_inside_the_band(mixed: tuple[Outcome, Silent]) -> None:
    """Nine rows in ten or more lie inside their 90 % band, on every axis of every event."""
    for series in mixed[0].review.series:
        # where tails may have been cut the band is wider than what became of them
        assert np.all(series.inside > 0.9 - 0.07)
        assert len(series.time_s) <= 2_000
    bias, slews = mixed[0].review.series
    left = mixed[0].review.balance.set_index("event").loc["bias", "residual_n_m_s"]
    assert left.to_numpy() == pytest.approx(-bias.residual[-1])
    stored = np.genfromtxt(
        mixed[0].folder / "tables" / "series_1.csv", delimiter=",", names=True, usecols=range(1, 17)
    )
    assert stored["residual_z_n_m_s"] == pytest.approx(bias.residual[:, 2], abs=1e-12)
    assert np.allclose(bias.measured - bias.predicted, bias.residual)
    # a slew's measured momentum is I ω of the file's rates
    rates = np.genfromtxt(
        simulated() / "slews" / "telemetry.csv", delimiter=",", names=True, usecols=(5, 6, 7)
    )
    measured = np.stack([rates[name] for name in rates.dtype.names], axis=-1)
    tensor = np.linalg.lstsq(measured, slews.measured, rcond=None)[0]
    assert np.allclose(tensor, tensor.T, atol=0.5)
    assert tensor[0, 0] == pytest.approx(truth()["inertia_xx_kg_m2"], rel=0.05)


def test_it_says_what_it_can_see_before_it_samples(mixed: tuple[Outcome, Silent]) -> None:
    """Rows read, then what can be expected, then sampling."""
    lines = mixed[1].lines
    # a slow machine is told of every few seconds of reading: that line may come first
    read = next(i for i, line in enumerate(lines) if "rows of telemetry" in line)
    expected = next(i for i, line in enumerate(lines) if line.startswith("Expected before"))
    warm = next(i for i, line in enumerate(lines) if line.startswith("warm start"))
    assert read < expected < warm


def test_resume_takes_the_cache_and_gives_the_same(mixed: tuple[Outcome, Silent]) -> None:
    """A resumed run takes its statistics from the cache and ends with the same draws."""
    outcome, _ = mixed
    before = read_fit(outcome.folder / "fit.nc")
    folder = outcome.folder.parent
    again, reporter = do(table(folder), outcome.folder, resume=True)
    assert all("from the cache" in line for line in reporter.lines if "rows of telemetry" in line)
    after = read_fit(again.folder / "fit.nc")
    assert before.posterior.identical(after.posterior)


def test_one_id_twice_is_refused() -> None:
    """The same event as telemetry and as a totals row would count twice."""
    content = {
        "events": [str(simulated() / "bias"), f"{simulated() / 'totals.csv'}:bias"],
        "priors": str(PRIORS),
        "source": "simulation",
    }
    with pytest.raises(InputError, match="each event once"):
        read_inputs(check_run(content, "test"), Path())


def test_event_density_is_the_collapsed_one_before_integrating() -> None:
    """log p(data | all) + log p(own) − log p(own | data) is the collapsed likelihood."""
    joint = model("slews")
    z = np.repeat(joint.space.sample(np.random.default_rng(4), 1) * 0.1, 3, axis=0)
    collapsed, draws = collapse(joint, z), draw(joint, z, np.random.default_rng(5))
    system = collapsed.terms[0].system
    own = unknowns_of(draws.thrusts.thrust_n, draws.integrated[0])
    mean, sd = system.own_mean, system.own_sd
    prior = normal_log_density(own - mean, sd).sum(-1)
    # the conditional normal from the normal equations, without their elimination
    precision = system.normal[:, :-1, :-1] + np.eye(len(mean)) / sd[:, None, :] ** 2
    pull = system.normal[:, :-1, -1] + mean / sd**2
    centre = np.linalg.solve(precision, pull[..., None])[..., 0]
    square = np.einsum("ni,nij,nj->n", own - centre, precision, own - centre)
    log_det = np.linalg.slogdet(precision)[1]
    given = 0.5 * (log_det - square - len(mean) * np.log(2.0 * np.pi))
    density = event_log_density(joint, z, draws)[:, 0]
    assert density + prior - given == pytest.approx(collapsed.log_likelihood, rel=1e-9)
    assert np.ptp(own[:, 0]) > 0
    assert sd[0, 0] == joint.telemetry[0].balance.initial_sd_n_m_s


def test_a_bad_proposal_is_said_and_survived(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pareto k̂ above 0.7: told before sampling, differential evolution takes over, warned of."""
    original = fitting.warm_start

    def spoilt(*arguments: Any, **options: Any) -> WarmStart:
        warm = original(*arguments, **options)
        return replace(warm, draws=replace(warm.draws, pareto_k=0.9))

    monkeypatch.setattr(fitting, "warm_start", spoilt)
    said: list[str] = []
    sampled = fitting.fit_model(
        model("slews"),
        SamplerSettings(ensembles=2, target_ess=100, first_check=40, max_steps=40),
        draws_per_ensemble=500,
        prior_draws=500,
        log=said.append,
    )
    assert any("falling back on differential evolution" in line for line in said)
    assert any("not reliable" in line for line in sampled.warnings)
