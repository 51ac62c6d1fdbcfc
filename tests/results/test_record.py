"""fit.nc: complete, labelled, readable by ArviZ, and never half-written."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import arviz
import numpy as np
import pytest
import xarray as xr
from run_cases import B_BRANCH, FLIGHT

from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import read_totals
from cassini_bayes.files import storage
from cassini_bayes.model import Model, build_model, draw_prior, log_posterior
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.results.groups import build_fit
from cassini_bayes.results.record import GROUPS, Fit, read_fit, save_fit
from cassini_bayes.spacecraft import thruster_directions

DIMS = {"chain", "draw", "event", "thruster", "wheel", "axis"}
UNITS = ("1", "N", "s", "m", "kg", "kg m2", "N m", "N m s", "rad", "rad/s", "rpm", "m/s", "m s-1")


def make_fit(priors_file: Path = B_BRANCH, **fixed: float) -> tuple[Model, Fit]:
    """A fit of two flight events to prior draws taken as posterior ones: quick, and complete."""
    priors = read_priors(priors_file)
    for name, value in fixed.items():
        priors = priors.with_fixed(name, value)
    model = build_model(read_totals(FLIGHT, priors.spacecraft)[:2], priors)
    rng = np.random.default_rng(0)
    z = 0.1 * rng.normal(size=(2, 30, len(model.space.names)))
    density = log_posterior(model, z.reshape(60, -1)).reshape(2, 30)
    attributes = {"seed": 3, "log_evidence": -1.25, "stop_rule": "all criteria met"}
    return model, build_fit(model, z, density, rng, attributes, 40)


@pytest.fixture(scope="module")
def fit() -> Fit:
    """The fit that most tests look at."""
    return make_fit()[1]


def test_what_is_saved_reads_back(tmp_path: Path, fit: Fit) -> None:
    """Every group, variable, coordinate and attribute, exactly."""
    save_fit(fit, tmp_path / "fit.nc")
    again = read_fit(tmp_path / "fit.nc")
    assert tuple(again.groups) == GROUPS
    for name in GROUPS:
        xr.testing.assert_identical(again.groups[name], fit.groups[name])
    assert dict(again.attributes) == dict(fit.attributes)
    assert [path.name for path in tmp_path.iterdir()] == ["fit.nc"]


def test_events_carry_their_branch(fit: Fit) -> None:
    """Wherever a group has events it has the branch that flew them."""
    groups = [group for group in fit.groups.values() if "event" in group.dims]
    assert len(groups) >= 5
    for group in groups:
        assert group["branch"].values.tolist() == ["B", "B"]


def test_arviz_reads_it(tmp_path: Path, fit: Fit) -> None:
    """arviz.from_netcdf finds every group, log_prior too, with the named dimensions."""
    save_fit(fit, tmp_path / "fit.nc")
    data = arviz.from_netcdf(tmp_path / "fit.nc")
    assert set(data.groups()) == set(GROUPS)
    assert data.posterior["thrust_n"].dims == ("chain", "draw", "event", "thruster")
    assert data.posterior["thrust_n"].values.tobytes() == (
        fit.posterior["thrust_n"].values.tobytes()
    )
    assert list(data.posterior["thruster"].values) == [f"{a}{i}" for a in "zy" for i in "1234"]
    assert list(data.posterior["axis"].values) == ["x", "y", "z"]
    assert list(data.posterior["wheel"].values) == ["rwa1", "rwa2", "rwa4"]
    assert data.posterior["event"].values[0] == "2009-08-22-bias"
    assert {"tail_off", "centre_of_mass", "thrust", "torque"} <= set(data.log_prior.data_vars)
    summary = arviz.summary(data, var_names=["tau_fall_s"])
    assert summary.index.tolist() == ["tau_fall_s"]


def test_names_of_the_format_are_there(fit: Fit) -> None:
    """The variables that the format fixes, with their dimensions."""
    wanted: Mapping[str, tuple[str, ...]] = {
        "thrust_n": ("event", "thruster"),
        **{f"inertia_{e}_kg_m2": () for e in ("xx", "yy", "zz", "xy", "xz", "yz")},
        **{f"cm_{axis}_m": () for axis in "xyz"},
        "rwa_inertia_kg_m2": ("wheel",),
        "rwa4_tilt_u_rad": (),
        "rwa4_tilt_v_rad": (),
        "tau_fall_s": (),
        "tau_rise_s": (),
        "external_torque_n_m": ("event", "axis"),
        "mass_kg": ("event",),
    }
    present = {**fit.posterior.data_vars, **fit.groups["constant_data"].data_vars}
    for name, dims in wanted.items():
        assert name in present, name
        assert tuple(d for d in present[name].dims if d not in ("chain", "draw")) == dims
    assert set(fit.prior.data_vars) == set(fit.posterior.data_vars)


@pytest.mark.parametrize("group", GROUPS)
def test_every_variable_is_labelled(fit: Fit, group: str) -> None:
    """Unit and long name on every variable, known dimensions only, no NaN among the draws."""
    dataset = fit.groups[group]
    assert dataset.data_vars
    assert set(map(str, dataset.dims)) <= DIMS
    for name, variable in dataset.data_vars.items():
        assert variable.attrs["units"] in UNITS, name
        assert len(variable.attrs["long_name"]) > 3, name
        if "draw" in variable.dims:
            assert variable.dims[:2] == ("chain", "draw")
            assert np.isfinite(variable.values).all(), name


def test_fixed_parameters_are_constants() -> None:
    """A fixed parameter is no draw but a constant with its unit; the rest of the fit stands."""
    model, fit = make_fit(tau_rise_s=0.02)
    assert "tau_rise_s" not in fit.posterior
    constant = fit.groups["constant_data"]["tau_rise_s"]
    assert (float(constant), constant.attrs["units"]) == (0.02, "s")
    assert "tau_rise_s" not in model.space.names


def test_a_second_seed_changes_draws_only() -> None:
    """The same generator gives the same fit; log priors add up to the prior of z."""
    model, fit = make_fit()
    _, again = make_fit()
    xr.testing.assert_identical(fit.posterior, again.posterior)
    collapsed = {"thrust", "torque", "flight_software"}  # densities of their own draws
    blocks = fit.groups["log_prior"].data_vars
    total = sum(blocks[name].values for name in blocks if name not in collapsed)
    lp = fit.groups["sample_stats"]["lp"].values
    assert total.shape == lp.shape
    rng = np.random.default_rng(0)
    z = 0.1 * rng.normal(size=(2, 30, len(model.space.names)))
    assert total == pytest.approx(-0.5 * (z**2 + np.log(2 * np.pi)).sum(-1))


@pytest.mark.statistical
def test_prior_draws_have_the_priors_moments() -> None:
    """Thrusts before the data: mean and spread of common + individual + event + jitter."""
    model, _ = make_fit()
    n = 4_000
    draws = draw_prior(model, n, np.random.default_rng(1))
    priors = read_priors(B_BRANCH)
    scales = {
        name: priors.parameters[name].distribution
        for name in (
            "thrust_common_n",
            "thrust_individual_n",
            "thrust_event_n",
            "thrust_jitter_n",
        )
    }
    variance = sum(d.sd() ** 2 for d in scales.values() if d is not None)
    common = scales["thrust_common_n"]
    assert common is not None
    thrust = draws.thrusts.thrust_n
    assert thrust.shape == (n, 2, thruster_directions(model.spacecraft, "B").shape[1])
    assert thrust.mean(0) == pytest.approx(common.mean(), abs=5 * np.sqrt(variance / n))
    assert thrust.var(0) == pytest.approx(variance, rel=5 * np.sqrt(2 / n))
    # the common level is shared by all: thrusts of two events are correlated accordingly
    shared = common.sd() ** 2 / variance
    found = np.corrcoef(thrust[:, 0, 0], thrust[:, 1, 5])[0, 1]
    assert found == pytest.approx(shared, abs=5 / np.sqrt(n))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_refused(tmp_path: Path, fit: Fit, share: float) -> None:
    """Cut anywhere: one line that names the file."""
    path = tmp_path / "fit.nc"
    save_fit(fit, path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError) as caught:
        read_fit(path)
    assert str(path) in caught.value.where
    assert "\n" not in str(caught.value)


def test_other_files_are_refused(tmp_path: Path, fit: Fit) -> None:
    """A missing file, a folder, text, and NetCDF without the groups."""
    (tmp_path / "text.nc").write_text("not a NetCDF file")
    fit.groups["posterior"].to_netcdf(tmp_path / "bare.nc", engine="h5netcdf")
    for name in ("missing.nc", "text.nc", "bare.nc", "."):
        with pytest.raises(InputError):
            read_fit(tmp_path / name)
    with pytest.raises(InputError, match="no such file"):
        read_fit(tmp_path / "missing.nc")
    with pytest.raises(InputError, match="not NetCDF; name a file that this package wrote"):
        read_fit(tmp_path / "text.nc")


def test_a_full_disk_keeps_the_old_file(
    tmp_path: Path, fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ENOSPC while fit.nc is written: one line, the old fit readable, no temporary file."""
    path = tmp_path / "fit.nc"
    save_fit(fit, path)
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(storage.os, "fsync", full)
        with pytest.raises(InputError, match="No space left"):
            save_fit(replace(fit, attributes={"seed": 4}), path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["fit.nc"]


def test_a_really_full_disk_is_survived(tmp_path: Path, fit: Fit) -> None:
    """A limit on the size of files, as the kernel enforces it: the process lives to say so."""
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(InputError, match="large"):
            save_fit(fit, tmp_path / "fit.nc")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(tmp_path.iterdir())
    save_fit(fit, tmp_path / "fit.nc")
    assert (tmp_path / "fit.nc").stat().st_size > 20_000  # negative control: the limit was hit
