"""The trend of a mission from its file to its page, resumed and updated, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from totals_cases import FLIGHT, ROOT
from typer.testing import CliRunner, Result

import cassini_bayes as cb
from cassini_bayes.cli import app
from cassini_bayes.errors import InputError
from cassini_bayes.model.mission.inputs import read_mission
from cassini_bayes.model.mission.mission_file import read_mission_file
from cassini_bayes.pipeline import trend_run
from cassini_bayes.results.mission.fitting import MissionFit
from cassini_bayes.results.record import read_fit

MISSION = """
events = [{events}]
priors = "{priors}"
[[dated]]
epoch = 2009-03-12
what = "branch_swap"
branch = "B"
source = "paper 001"
[pressure]
reference_kpa = 2000.0
readings = [{{ epoch = 2009-08-01, kpa = 2010.0 }}, {{ epoch = 2010-12-01, kpa = 1990.0 }}]
[trend]
reference_epoch = 2009-08-22
draws = 100
proposals = 500
[[trend.forecast]]
epoch = 2011-12-12
branch = "B"
pressure_kpa = 2000.0
"""
IDS = ("2009-08-22-bias", "2009-10-05-bias", "2010-02-13-bias")
PRIORS_OF_B = "cassini_b_branch_2010.toml"
FIXED = ("inertia", "thruster", "rwa", "tail_", "cm_x", "cm_z")


@pytest.fixture(scope="module")
def priors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The mission's priors with most nuisances fixed."""
    import tomllib

    import tomli_w

    table = tomllib.loads((ROOT / "priors" / "cassini_mission.toml").read_text("utf-8"))
    for name, entry in table["parameters"].items():
        if name.startswith(FIXED) and "loc" in entry:
            keep = {key: entry[key] for key in ("unit", "source")}
            table["parameters"][name] = {"fixed": entry["loc"], **keep}
    path = tmp_path_factory.mktemp("priors") / "priors.toml"
    path.write_text(tomli_w.dumps(table), "utf-8")
    return path


def write_mission(folder: Path, priors: Path, ids: tuple[str, ...]) -> Path:
    """A mission of some flight events."""
    events = ", ".join(f'"{FLIGHT}:{name}"' for name in ids)
    path = folder / "mission.toml"
    path.write_text(MISSION.format(events=events, priors=priors), "utf-8")
    return path


def without_pressure(mission: Path) -> None:
    """Take the tank pressure out of a mission file."""
    lines = mission.read_text("utf-8").splitlines()
    own = ("[pressure]", "reference_kpa", "readings")
    mission.write_text("\n".join(line for line in lines if not line.startswith(own)), "utf-8")


def test_a_trend_is_written_and_goes_on_with_new_events(tmp_path: Path, priors: Path) -> None:
    """Two events, then a third: tables, JSON, NetCDF with the branch, figures and page."""
    out, run = tmp_path / "out", CliRunner()
    mission = write_mission(tmp_path, priors, IDS[:2])
    first = run.invoke(app, ["trend", str(mission), "--out", str(out), "--no-report"])
    assert first.exit_code == 0, first.output
    assert not (out / "report.html").exists()
    write_mission(tmp_path, priors, IDS)
    again = run.invoke(app, ["trend", str(mission), "--out", str(out), "--json"])
    assert again.exit_code == 0, again.output
    assert "going on from the draws" in again.output
    record = json.loads((out / "trend.json").read_text("utf-8"))
    assert record["events"] == list(IDS)
    assert {row["thruster"] for row in record["health"]} >= {"z1", "y4"}
    # three events at nearly one pressure say nothing of the law
    assert abs(record["log_bayes_proportional_law"]) < 0.5
    assert record["forecast"][-1]["thruster"] == "mean"
    with xr.open_dataset(out / "trend.nc", group="posterior", engine="h5netcdf") as posterior:
        assert posterior["thrust_n"].dims == ("chain", "draw", "event", "thruster")
        assert posterior["branch"].values.tolist() == ["B"] * 3
        assert np.isfinite(posterior["thrust_n"].values).all()
    page = (out / "report.html").read_text("utf-8")
    assert "No alarm" in page
    assert sorted(p.name for p in (out / "figures").glob("*.png")) == [
        "losses_B.png",
        "normalised_B.png",
        "thrust_B.png",
    ]


def test_the_same_events_again_have_the_same_numbers(
    tmp_path: Path, priors: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a trend that was updated, once more and after a kill before its tables were written."""
    mission, run = tmp_path / "mission.toml", CliRunner()

    def trend(out: Path) -> Result:
        return run.invoke(app, ["trend", str(mission), "--out", str(out), "--no-report"])

    def written(out: Path) -> tuple[dict[str, Any], str]:
        done = trend(out)
        assert done.exit_code == 0, done.output
        return json.loads((out / "trend.json").read_text("utf-8")), done.output

    write_mission(tmp_path, priors, IDS[:2])
    for name in ("out", "killed"):
        written(tmp_path / name)
    write_mission(tmp_path, priors, IDS)
    updated, _ = written(tmp_path / "out")
    again, told = written(tmp_path / "out")
    assert again == updated
    assert "going on" not in told
    with monkeypatch.context() as patch:
        patch.setattr(trend_run, "trend_of", killed)
        assert str(trend(tmp_path / "killed").exception) == "killed"
    assert written(tmp_path / "killed")[0] == updated
    # negative control: a trend that is made at once has other draws
    assert written(tmp_path / "anew")[0]["log_evidence"] != updated["log_evidence"]


def killed(*_: Any) -> None:
    """What a process that is ended goes no further than."""
    raise RuntimeError("killed")


def test_a_trend_of_one_event_has_a_page(tmp_path: Path, priors: Path) -> None:
    """Nothing can set in, and no loss is asked to be tabulated: the page is whole still. Without a
    tank pressure none is stated.
    """
    mission, out = write_mission(tmp_path, priors, IDS[:1]), tmp_path / "out"
    without_pressure(mission)
    text = mission.read_text("utf-8").replace("draws = 100", "draws = 100\ndegraded = []")
    mission.write_text(text, "utf-8")
    done = CliRunner().invoke(app, ["trend", str(mission), "--out", str(out)])
    assert done.exit_code == 0, done.output
    page = (out / "report.html").read_text("utf-8")
    assert "Health of every thruster" in page
    assert "P(&gt;" not in page
    assert (out / "figures" / "losses_B.png").exists()
    assert pd.read_csv(out / "trend.csv")["pressure_kpa"].isna().all()
    record = json.loads((out / "trend.json").read_text("utf-8"))
    assert {row["pressure_kpa"] for row in record["forecast"]} == {None}


def test_beliefs_on_losses_are_checked_before_events_are_read(tmp_path: Path, priors: Path) -> None:
    """A fixed share of what is lost is refused although the events are not there."""
    text = priors.read_text("utf-8").replace('dist = "halfnorm"\nscale = 0.15', "fixed = 0.1")
    (tmp_path / "priors.toml").write_text(text, "utf-8")
    mission = write_mission(tmp_path, tmp_path / "priors.toml", IDS[:1])
    mission.write_text(mission.read_text("utf-8").replace(str(FLIGHT), "none.csv"), "utf-8")
    with pytest.raises(InputError, match="halfnorm"):
        read_mission(read_mission_file(mission), tmp_path, "mission.toml")


def test_another_spacecraft_and_an_event_twice_are_refused(tmp_path: Path, priors: Path) -> None:
    """One line each."""
    path = write_mission(tmp_path, priors, (IDS[0], IDS[0]))
    with pytest.raises(InputError, match="each event once in a mission"):
        read_mission(read_mission_file(path), tmp_path, "mission.toml")
    path.write_text('spacecraft = { name = "juno" }\n' + path.read_text("utf-8"), "utf-8")
    with pytest.raises(InputError, match=r"spacecraft\.name: expected 'cassini'"):
        read_mission(read_mission_file(path), tmp_path, "mission.toml")


def test_events_of_both_branches_in_one_fit(
    tmp_path: Path, priors: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """`fit --mission` takes a mix that a fit refuses; fit.nc has the coordinate `branch`."""
    text = Path(FLIGHT).read_text("utf-8").splitlines()
    own = next(row for row in text if row.startswith(IDS[0]) and row.endswith("flight"))
    other = own.replace(IDS[0], "2007-05-01-bias").replace("2009-08-22", "2007-05-01")
    other = other.replace(
        ",B,1 2 4,-1118,1290,,330,626,1300,,-729,", ",A,1 2 3,-1118,1290,330,,626,1300,-729,,"
    )
    events = tmp_path / "events.csv"
    events.write_text("\n".join([text[0], other, own]) + "\n", "utf-8")
    mission = write_mission(tmp_path, priors, IDS[:1])
    without_pressure(mission)
    out, run = tmp_path / "out", CliRunner()
    arguments = ["fit", str(events), "--mission", str(mission), "--out", str(out)]
    refused = run.invoke(app, ["fit", str(events), "--priors", str(priors), "--out", str(out)])
    assert "cassini-bayes trend MISSION.toml" in str(refused.exception)
    done = run.invoke(app, arguments)
    assert done.exit_code == 0, done.output
    fit = read_fit(out / "fit.nc")
    assert fit.posterior["branch"].values.tolist() == ["A", "B"]
    assert fit.posterior["event"].values.tolist() == ["2007-05-01-bias", IDS[0]]
    assert fit.posterior["thrust_n"].dims == ("chain", "draw", "event", "thruster")
    thrust, before = fit.posterior["thrust_n"], fit.prior["thrust_n"]
    assert np.isfinite(thrust.values).all()
    assert (thrust.std(("chain", "draw")) < before.std(("chain", "draw")) * 1.2).all()
    assert {"A.tau_fall_s", "B.tau_fall_s", "cm_y_m"} <= set(fit.posterior.data_vars)
    told = cb.read_fit(out / "fit.nc").summary().set_index("name")
    tail = fit.posterior["B.tau_fall_s"].values
    assert told.loc["B.tau_fall_s", "mean"] == pytest.approx(tail.mean())
    assert told.loc["B.tau_fall_s", "ess_bulk"] > 0.3 * tail.size
    assert told["rhat"].isna().all()
    assert not caplog.records
    assert np.isfinite(fit.groups["log_likelihood"]["event_data"].values).all()
    observed = fit.groups["observed_data"]["on_time_s"].values
    simulated = fit.groups["posterior_predictive"]["on_time_s"]
    assert simulated.shape[2:] == observed.shape
    assert_nothing_is_planned_with_it(out, events, priors)
    for option in (["--effect", "thruster_leak:z3"], ["--force"], ["--resume"], ["--no-report"]):
        mixed = run.invoke(app, [*arguments, *option])
        assert "no option about effects" in str(mixed.exception)


def assert_nothing_is_planned_with_it(mission: Path, events: Path, priors: Path) -> None:
    """A fit of a mission has no quantity of plans, and predictions and plans say why."""
    listed = cb.quantities(mission)
    of_plans = {"thrust_level_z1_n", "thrust_mean_n", "impulse_per_on_time_z1_n"}
    assert of_plans.isdisjoint(listed["name"])
    assert set(listed["used_by"]) == {"summary"}
    given = {"events": f"{events}:{IDS[0]}", "priors": str(ROOT / "priors" / PRIORS_OF_B)}
    for where in ({}, {"events": str(events), "priors": str(priors)}, given):
        with pytest.raises(InputError, match="expected a fit of one branch, got one of a mission"):
            cb.predict(
                mission, "rwa1: -1118 -> 626, rwa2: 1290 -> 1300, rwa4: 330 -> -729", **where
            )
        with pytest.raises(InputError, match="fit of that branch's events"):
            cb.plan(mission, "thrust_mean_n", **where)
    with pytest.raises(InputError):
        cb.sweep(mission)


def test_mistakes_in_a_mission_are_refused(tmp_path: Path, priors: Path) -> None:
    """Wheels exchanged in a table, and a row under a second id; accepted, they stand among the
    warnings, and with `--strict` make the exit status 1.
    """
    text = Path(FLIGHT).read_text("utf-8").splitlines()
    rows = [row for row in text[1:] if row.startswith(IDS) and row.endswith("flight")]
    names = text[0].replace("rwa1", "rwa0").replace("rwa2", "rwa1").replace("rwa0", "rwa2")
    table = tmp_path / "events.csv"
    table.write_text("\n".join([names, *rows]) + "\n", "utf-8")
    mission = write_mission(tmp_path, priors, IDS)
    told = mission.read_text("utf-8").splitlines()
    told[1] = 'events = ["events.csv"]'
    mission.write_text("\n".join(told), "utf-8")
    with pytest.raises(InputError, match="--accept wheel-order"):
        read_mission(read_mission_file(mission), tmp_path, "mission.toml")
    copied = rows[0].replace(IDS[0], "2009-08-23-copy")
    table.write_text("\n".join([text[0], rows[0], copied, *rows[1:]]) + "\n", "utf-8")
    with pytest.raises(InputError, match="under another name"):
        read_mission(read_mission_file(mission), tmp_path, "mission.toml")
    run = ["trend", str(mission), "--out", str(tmp_path / "out"), "--no-report", "--quiet"]
    accepted = CliRunner().invoke(app, [*run, "--accept", "same-telemetry", "--strict"])
    assert accepted.exit_code == 1, accepted.output
    assert "warning: " in accepted.output
    record = json.loads((tmp_path / "out" / "trend.json").read_text("utf-8"))
    assert [warning.count("same-telemetry") for warning in record["warnings"]] == [1]


def test_the_mission_of_the_reference_runs(tmp_path: Path) -> None:
    """The file that the page on mission files prints, as it stands, with its forecast."""
    out = tmp_path / "trend"
    example = ROOT / "docs" / "examples" / "mission.toml"
    result = CliRunner().invoke(app, ["trend", str(example), "--out", str(out), "--quiet"])
    assert result.exit_code == 0, result.output
    assert "2012-01-01" in (out / "report.html").read_text("utf-8")


def test_a_run_stays_what_it_is_of(tmp_path: Path, priors: Path) -> None:
    """A trend into the folder of a run or diagnosis would replace half of it: it is refused."""
    mission = write_mission(tmp_path, priors, IDS[:1])
    (tmp_path / "resolved.toml").write_text("", "utf-8")
    for command in (["trend"], ["fit", f"{FLIGHT}:{IDS[0]}", "--mission"]):
        refused = CliRunner().invoke(app, [*command, str(mission), "--out", str(tmp_path)])
        assert "a run or diagnosis (with resolved.toml)" in str(refused.exception)


def test_the_rows_that_a_mission_file_asks_for_are_those_of_its_fit(
    tmp_path: Path, priors: Path
) -> None:
    """`source` of the mission file counts where the command line says nothing else."""
    mission = write_mission(tmp_path, priors, IDS[:1])
    text = mission.read_text("utf-8")
    mission.write_text('source = "nobody"\n' + text, "utf-8")
    arguments = ["fit", str(FLIGHT), "--mission", str(mission), "--out", str(tmp_path / "out")]
    refused = CliRunner().invoke(app, arguments)
    assert "nobody" in str(refused.exception)


def test_a_trend_of_too_few_draws_is_written_all_the_same(
    tmp_path: Path, priors: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pareto k̂ of fewer than five weights is infinite: null in the record, and exit status 1."""
    fitted = trend_run.fit_mission

    def poor(*args: Any, **named: Any) -> MissionFit:
        return replace(fitted(*args, **named), pareto_k=np.inf)

    monkeypatch.setattr(trend_run, "fit_mission", poor)
    mission, out = write_mission(tmp_path, priors, IDS[:1]), tmp_path / "out"
    done = CliRunner().invoke(app, ["trend", str(mission), "--out", str(out), "--no-report"])
    assert done.exit_code == 1, done.output
    assert "NOT CONVERGED" in done.output
    record = json.loads((out / "trend.json").read_text("utf-8"))
    assert record["pareto_k"] is None
    assert record["converged"] is False
