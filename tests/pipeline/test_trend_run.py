"""The trend of a mission from its file to its page, resumed and updated, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from totals_cases import FLIGHT, ROOT
from typer.testing import CliRunner

from cassini_bayes.cli import app
from cassini_bayes.errors import InputError
from cassini_bayes.model.mission.inputs import read_mission
from cassini_bayes.model.mission.mission_file import read_mission_file

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


def test_another_spacecraft_and_an_event_twice_are_refused(tmp_path: Path, priors: Path) -> None:
    """One line each."""
    path = write_mission(tmp_path, priors, (IDS[0], IDS[0]))
    with pytest.raises(InputError, match="each event once in a mission"):
        read_mission(read_mission_file(path), tmp_path, "mission.toml")
    path.write_text('spacecraft = { name = "juno" }\n' + path.read_text("utf-8"), "utf-8")
    with pytest.raises(InputError, match=r"spacecraft\.name: expected 'cassini'"):
        read_mission(read_mission_file(path), tmp_path, "mission.toml")
