"""A fit of telemetry as its user holds it: read back, shown, given to ArviZ, predicted from."""

from __future__ import annotations

import json
import shutil
import tomllib
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import run_cases
import tomli_w
from event_cases import PRIORS, ROOT, priors, simulated
from prediction_cases import write_chained, write_earlier
from run_cases import B_BRANCH, EVENTS, FLIGHT, command, small_table
from totals_cases import flight

import cassini_bayes as cb
from cassini_bayes.computing.arviz_import import arviz, corner
from cassini_bayes.errors import InputError
from cassini_bayes.model import log_posterior
from cassini_bayes.pipeline import by_file, diagnoses, fits
from cassini_bayes.pipeline.fits import FitResult
from cassini_bayes.prediction.sources import read_sources, sources_of
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.report import sections_of
from cassini_bayes.results.review import Review

pytestmark = pytest.mark.usefixtures("short_warm_start")
SAMPLER = {"ensembles": 2, "walkers": 56, "target_ess": 100, "first_check": 64, "max_steps": 100}
FEW = {"draws_per_ensemble": 500, "prior_draws": 500}
BIAS = "rwa1: -200 -> 150, rwa2: 300 -> -100, rwa4: 250 -> -50"


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> FitResult:
    """A bias and slews, fitted and written as a run."""
    return cb.fit(
        [simulated() / "bias", simulated() / "slews"],
        PRIORS,
        sampler=SAMPLER,
        seed=3,
        folder=tmp_path_factory.mktemp("fits") / "run",
        report=False,
        **FEW,
    )


@pytest.fixture(scope="module")
def again(stored: FitResult) -> FitResult:
    """The same, read back from its folder."""
    assert stored.path is not None
    return cb.read_fit(stored.path.parent)


@pytest.fixture(scope="module")
def data(again: FitResult) -> Any:
    """ArviZ's view of it."""
    return again.to_arviz()


def test_what_is_read_back_is_the_same(stored: FitResult, again: FitResult) -> None:
    """Walked draws come back from the file: they have the density that was stored with them."""
    np.testing.assert_allclose(again.review.z, stored.review.z, atol=1e-6)
    lp = again.groups["sample_stats"]["lp"].values.reshape(-1)
    np.testing.assert_allclose(log_posterior(again.model, again.review.z), lp, atol=1e-4)
    assert again.review.convergence.equals(stored.review.convergence)
    assert dict(again.review.facts) == dict(stored.review.facts)
    assert again.warnings == stored.warnings


def test_slews_alone_have_a_page() -> None:
    """Nothing fires: no thrust is drawn, and none of its priors is made wider or narrower."""
    fitted = cb.fit([simulated() / "slews"], PRIORS, sampler=SAMPLER, seed=3, **FEW)
    offered = [s.frame for s in sections_of(fitted.review) if s.name == "prior_widths"]
    assert len(offered) == 1
    assert offered[0] is not None
    assert set(offered[0]["prior"]) >= {"inertia"}
    assert "common thrust" not in set(offered[0]["prior"])


def test_it_says_something_in_a_few_lines(again: FitResult) -> None:
    """No pages of nested records: the state, a few quantities with units beside their priors."""
    lines = repr(again).splitlines()
    assert len(lines) < 9
    assert "events bias, slews" in lines[0]
    assert any("thrust_common_n" in line and " N (prior" in line for line in lines)
    page = again._repr_html_()
    assert "90 % highest density" in page
    assert len(page) < 5_000


def test_a_summary_says_its_units_and_interval(again: FitResult) -> None:
    """One row per scalar; a name that is none is refused with the nearest."""
    table = again.summary(["thrust_level_n", "inertia_??_kg_m2"])
    assert len(table) == 8 + 6
    assert set(table["unit"]) == {"N", "kg m2"}
    assert table.attrs["interval"] == "90 % highest density"
    with pytest.raises(InputError, match="thrust_level_n"):
        again.summary("thrust_levels_n")


def test_figures_are_drawn(again: FitResult) -> None:
    """Corner and trace from the draws alone, thrusts and any other of the report by its name."""
    names = ["thrust_common_n", "tau_fall_s"]
    corner_plot = again.plot_corner(names)
    assert corner_plot is not None
    assert len(corner_plot.axes) == 3
    trace = again.plot_trace(names)
    assert trace is not None
    assert [axes.get_title(loc="left") for axes in trace.axes] == names
    assert again.plot_thrusts() is not None
    assert "nuisances" in again.figures
    with pytest.raises(InputError, match="expected one of"):
        again.plot("nothing")


def test_arviz_takes_it(data: Any) -> None:
    """Summary without a gap although slews have no thrust, trace, replicates, prior sensitivity."""
    az = arviz()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = az.summary(data, var_names=["thrust_n", "tau_fall_s"])
        assert np.isfinite(table[["mean", "sd", "hdi_3%"]].to_numpy()).all()
        assert len(table) == 8 + 1
        az.plot_trace(data, var_names=["tau_fall_s"])
        az.plot_ppc(data, var_names=["rwa_rpm"], num_pp_samples=3)
        for component in ("prior", "likelihood"):
            found = az.psens(data, component=component, var_names=["tau_fall_s"])
            assert np.isfinite(float(found))
        corner().corner(data, var_names=["thrust_common_n", "tau_fall_s"])


def test_the_event_is_the_unit_of_leaving_one_out(again: FitResult, data: Any) -> None:
    """One k̂ an event; given an event's own unknowns, too, more parameters would be counted."""
    az = arviz()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        own = az.loo(data, pointwise=True)
        full = az.loo(again.to_arviz(marginal=False), pointwise=True)
    assert own.pareto_k.dims == ("event",)
    assert own.pareto_k.shape == (2,)
    assert float(own.p_loo) < float(full.p_loo)


def test_a_fit_of_telemetry_predicts(again: FitResult) -> None:
    """The bias flown again: the recorded on-times lie within the predicted spread."""
    found = cb.predict(again, BIAS)
    row = read_sources(again.path, None).events[0]
    drawn = found.predictions[0].on_time_s
    assert (np.abs(drawn.mean(0) - row.on_time_s) < 4.0 * drawn.std(0) + 0.5).all()
    table = found.summary()
    assert {"on_time_z1", "duration"} <= set(table["quantity"])
    assert table.attrs["interval"] == "90 % central"
    group = found.to_arviz().predictions
    assert group["on_time_s"].dims == ("chain", "draw", "bias", "thruster")
    plan = cb.plan(again, "tau_fall_s", levels=1, top=2)
    assert "nan" not in repr(plan)
    json.dumps(plan.as_record(), allow_nan=False)
    assert len(plan.summary()) == len(plan.plan.candidates)


def test_a_fit_in_memory_predicts_as_one_in_a_folder(again: FitResult) -> None:
    """The recordings of its model are the events that its run's files give."""
    kept, read = sources_of(again.model), read_sources(again.path, None)
    assert [event.id for event in kept.events] == [event.id for event in read.events]
    np.testing.assert_array_equal(kept.events[0].on_time_s, read.events[0].on_time_s)
    in_memory = replace(again, path=None)
    one, other = (cb.predict(own, BIAS).predictions[0] for own in (in_memory, again))
    np.testing.assert_array_equal(one.on_time_s, other.on_time_s)


def test_slews_teach_no_prediction(stored: FitResult, tmp_path: Path) -> None:
    """Negative control: without a wheel bias nothing is known of the firing logic."""
    run = tmp_path / "slews"
    run.mkdir()
    resolved = (stored.path.parent / "resolved.toml").read_text()
    (run / "resolved.toml").write_text(resolved.replace(f'    "{simulated() / "bias"}",\n', ""))
    (run / "fit.nc").symlink_to(stored.path)
    with pytest.raises(InputError, match="wheel biases among its events"):
        cb.predict(run, BIAS)


def test_a_fit_that_stands_alone_says_what_it_lacks(stored: FitResult, tmp_path: Path) -> None:
    """Draws, summary and corner need the file alone; the model needs its run."""
    stored.save(tmp_path / "alone.nc")
    alone = cb.read_fit(tmp_path / "alone.nc")
    assert alone.plot_corner(["thrust_common_n", "tau_fall_s"]) is not None
    assert alone.to_arviz(marginal=False).posterior.sizes["draw"] > 400
    with pytest.raises(InputError, match="stands alone"):
        alone.to_arviz()


def test_bad_calls_are_one_line(tmp_path: Path) -> None:
    """What a notebook's user gets wrong: the message says what to give instead."""
    with pytest.raises(InputError, match="expected a priors file, got none"):
        cb.fit(simulated() / "bias")
    with pytest.raises(InputError, match="got dict; read it with"):
        cb.fit([{}], PRIORS)
    with pytest.raises(InputError, match="named by their paths"):
        cb.fit([simulated() / "bias"], priors(), folder=tmp_path / "x")
    with pytest.raises(InputError, match="some of ensembles"):
        cb.fit(simulated() / "bias", PRIORS, sampler={"chains": 4})
    with pytest.raises(InputError, match="'ensemble'; did you mean 'ensembles'"):
        cb.fit(simulated() / "bias", PRIORS, sampler={"ensemble": 2})
    with pytest.raises(InputError, match=r"ensembles: expected a whole number .*'two'"):
        cb.fit(simulated() / "bias", PRIORS, sampler={"ensembles": "two"})
    for call in (cb.fit, cb.diagnose):
        for seed in (-1, 1.5, 2**70):
            with pytest.raises(InputError, match="seed: expected a whole number from 0"):
                call(simulated() / "bias", PRIORS, seed=seed)
    with pytest.raises(InputError, match="a run file alone"):
        cb.fit("runs/flight_2009_2010.toml", PRIORS)
    for said in ({"report": False}, {"draws_per_ensemble": 600}, {"prior_draws": 600}):
        with pytest.raises(InputError, match="a run file alone"):
            cb.fit("runs/flight_2009_2010.toml", **said)
    row = cb.read_totals(FLIGHT, priors().spacecraft)[0]
    for one in (row, cb.build_model(simulated() / "bias", PRIORS)):
        with pytest.raises(InputError, match="named by their paths"):
            cb.fit(one, PRIORS, folder=tmp_path / "x")
    for call in (cb.fit, cb.diagnose):
        with pytest.raises(InputError, match="events: expected at least one path, got none"):
            call([], PRIORS, folder=tmp_path / "x")
    with pytest.raises(InputError, match=r"small.toml: accept: expected one of"):
        cb.fit(run_cases.write_run(tmp_path, small_table() | {"accept": ["nothing"]}))
    with pytest.raises(InputError, match="expected a priors file, got none"):
        cb.check(simulated() / "bias")


@pytest.mark.parametrize("verb", [cb.fit, cb.check])
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("priors", PRIORS),
        ("effects", ["tail_off"]),
        ("effect_files", ["plume.py"]),
        ("pulse_shape", "rectangular"),
        ("delta_v", "ignore"),
        ("source", "gsw_ideal"),
        ("accept", ["wheel-order"]),
        ("leave_out", True),
    ],
)
def test_what_a_model_has_already_is_refused_beside_it(
    verb: Callable[..., object], name: str, value: object
) -> None:
    """It had been ignored; the message names what was given."""
    rows, known = flight(1)
    with pytest.raises(InputError, match=f"^{name}: expected a model alone, got {name} beside it"):
        verb(cb.build_model(rows, known), **{name: value})


def test_the_report_command_goes_on_from_the_stored_draws(
    stored: FitResult,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It writes what a run writes, of the same draws, into the run's folder or another.

    The few draws have not converged: it says so and ends with 1, as the run did.
    """
    written: list[tuple[Review, Path]] = []

    def write(review: Review, folder: Path, log: object, *, report: bool) -> None:
        assert report
        written.append((review, folder))

    monkeypatch.setattr(fits, "write_results", write)
    run = str(stored.path.parent)
    assert command(["report", run, "--quiet"]) == 1
    assert command(["report", run, "--out", str(tmp_path), "--quiet"]) == 1
    assert capsys.readouterr().err.count("not converged: ") == 2
    assert [str(folder) for _, folder in written] == [run, str(tmp_path)]
    assert written[0][0].summary.equals(stored.review.summary)
    assert command(["report", str(tmp_path), "--quiet"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_what_a_caller_gives_of_the_sampler_is_what_the_file_has_not(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A setting that is given counts, also where it is the default; others stay the file's."""
    seen: list[Any] = []

    def execute(run: Any, *_: object, **__: object) -> Any:
        seen.append(run.sampler)
        raise InputError("stop", "here", "here", "here")

    monkeypatch.setattr(fits, "execute", execute)
    table = small_table() | {
        "sampler": {"ensembles": 8, "max_steps": 20_000, "seed": 7},
        "output": {},
    }
    path = run_cases.write_run(tmp_path, table)
    given = {"ensembles": 4, "max_steps": 5_000}
    with pytest.raises(InputError, match="stop"):
        cb.fit(path, sampler=given)
    assert (seen[-1].ensembles, seen[-1].max_steps, seen[-1].seed) == (4, 5_000, 7)
    # a first check that nobody gave is no reason to refuse fewer steps
    with pytest.raises(InputError, match="stop"):
        cb.fit(simulated() / "bias", PRIORS, sampler={"max_steps": 100}, folder=tmp_path / "x")
    assert seen[-1].max_steps == 100


def test_inputs_that_moved_are_those_of_the_fit(stored: FitResult, tmp_path: Path) -> None:
    """Beside `base` they are compared by content: copies are taken, one edited is named."""
    base, run = tmp_path / "moved", tmp_path / "run"
    for name in ("bias", "slews"):
        shutil.copytree(simulated() / name, base / name)
    shutil.copy(PRIORS, base / "priors.toml")
    shutil.copytree(stored.path.parent, run)
    said = tomllib.loads((run / "resolved.toml").read_text())
    said |= {"events": ["bias", "slews"], "priors": "priors.toml"}
    (run / "resolved.toml").write_text(tomli_w.dumps(said))
    np.testing.assert_array_equal(
        cb.read_fit(run, base=base).review.z, cb.read_fit(stored.path).review.z
    )
    with (base / "priors.toml").open("a") as stream:
        stream.write("# changed\n")
    with pytest.raises(InputError, match=r"got others: the content of priors\.toml; restore"):
        cb.report(run, base=base)


def test_a_fit_whose_priors_began_with_another_fit_is_not_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The earlier fit was replaced since; as it was (control) there is a review."""
    monkeypatch.setattr(fits, "facts_of", lambda *_: {})  # of a sampler that did not run
    earlier, fit = write_chained(tmp_path)
    assert cb.read_fit(fit).review.priors.earlier is not None
    write_earlier(earlier, seed=3)
    with pytest.raises(InputError, match=r"got others: the content of .*first/fit\.nc"):
        cb.report(fit.parent)


def test_a_report_goes_into_no_other_run(stored: FitResult, tmp_path: Path) -> None:
    """Its tables would stand beside that run's settings and draws."""
    (tmp_path / "resolved.toml").write_text('events = ["e.csv"]\npriors = "p.toml"\n')
    with pytest.raises(InputError, match="another run or diagnosis"):
        cb.report(stored, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["resolved.toml"]


def test_throughput_counts_every_event_of_the_fit(again: FitResult) -> None:
    """Of a fit in a folder and of one in memory, what an event fires that is no bias is added."""
    given = {"minimise": "z_throughput", "to": "rwa1: 400, rwa4: 600"}
    observed = again.groups["observed_data"]
    own = {str(k): float(v) for k, v in observed["on_time_s"].sel(event="bias").to_series().items()}
    assert {row.thruster: row.past_s for row in cb.plan(again, **given).throughput} == own
    assert observed["on_time_s"].sel(event="slews").isnull().all()
    on_time = observed["on_time_s"].fillna(10.0)
    groups = {**again.groups, "observed_data": observed.assign(on_time_s=on_time)}
    for row in cb.plan(replace(again, path=None, groups=groups), **given).throughput:
        assert row.past_s == pytest.approx(own[row.thruster] + 10.0)


def test_seeds_of_numpy_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They become plain numbers, which records can hold."""
    seen: list[Any] = []

    def stop(*given: Any, **_: object) -> Any:
        seen.append(given[0])
        raise InputError("stop", "here", "here", "here")

    monkeypatch.setattr(fits, "execute", stop)
    monkeypatch.setattr(diagnoses, "diagnose_case", stop)
    monkeypatch.setattr(by_file, "execute_trend", stop)
    seed, row = np.int64(3), f"{FLIGHT}:{EVENTS[0]}"
    mission = ROOT / "runs" / "cassini_mission.toml"
    for call in (
        lambda: cb.fit(row, B_BRANCH, seed=seed, folder=tmp_path / "fit"),
        lambda: cb.diagnose(row, B_BRANCH, seed=seed, folder=tmp_path / "diagnosis"),
        lambda: cb.trend(mission, tmp_path / "trend", seed=seed),
    ):
        with pytest.raises(InputError, match="stop"):
            call()
    said = tomllib.loads((tmp_path / "diagnosis" / "resolved.toml").read_text())
    for found in (seen[0].sampler.seed, said["seed"], seen[2].trend.seed):
        assert found == 3
        assert type(found) is int


def test_seeds_are_checked_by_every_call(tmp_path: Path) -> None:
    """Minus one is no seed of anything."""
    scenario = ROOT / "runs" / "scenarios" / "calibration.toml"
    with pytest.raises(InputError, match="seed: expected a whole number from 0"):
        cb.simulate(scenario, seed=-1)
    with pytest.raises(InputError, match="seed: expected a whole number from 0"):
        cb.plan(tmp_path, "thrust_mean_n", seed=-1)


@pytest.mark.parametrize("verb", [cb.fit, cb.check, cb.diagnose])
def test_priors_with_nothing_to_walk_are_refused(verb: Callable[..., object]) -> None:
    """Thrusts alone have distributions: one line names the file and what to give one."""
    rows, known = flight(1)
    for name, prior in known.parameters.items():
        if prior.distribution is not None and not name.startswith("thrust_"):
            known = known.with_fixed(name, prior.median)
    with pytest.raises(InputError, match=r"all of them fixed; give one a distribution, e\.g\. t"):
        verb(rows, known)


def test_a_run_with_nothing_to_walk_leaves_no_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refused before anything is written."""
    priors_of_run = tomllib.loads(run_cases.B_BRANCH.read_text("utf-8"))
    medians = read_priors(run_cases.B_BRANCH).medians(priors_of_run["parameters"])
    for name, own in priors_of_run["parameters"].items():
        if "dist" in own and not name.startswith("thrust_"):
            kept = {key: own[key] for key in ("unit", "source")}
            priors_of_run["parameters"][name] = {"fixed": medians[name], **kept}
    (tmp_path / "fixed.toml").write_text(tomli_w.dumps(priors_of_run), "utf-8")
    run = run_cases.write_run(tmp_path, {**small_table(), "priors": "fixed.toml"})
    assert command(["run", str(run), "--quiet"]) == 2
    assert "all of them fixed" in capsys.readouterr().err
    assert not (tmp_path / "small").exists()
