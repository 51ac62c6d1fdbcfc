"""The posterior of one fit as the prior of the next."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import partial
from pathlib import Path

import event_cases
import numpy as np
import pytest
import tomli_w
import xarray as xr
from totals_cases import B_BRANCH, flight

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model import (
    Model,
    ReducedEvent,
    build_model,
    collapse,
    draw,
    draw_prior,
    log_posterior,
    observability,
    reduce_event,
)
from cassini_bayes.priors.chaining import EarlierFit, inertia_wheels
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.results.groups import build_fit
from cassini_bayes.results.record import Fit, save_fit
from cassini_bayes.sampling.warmstart import WarmStart, warm_start
from cassini_bayes.simulation import scenario_of
from cassini_bayes.spacecraft import Spacecraft, load_spacecraft
from cassini_bayes.studies.scenario import simulate_file, write_simulation
from cassini_bayes.sweep.models import walked_values

LEVELS = "thrust_level_n"
DRAWS = 8_000
MORE_DRAWS = 5_000  # of telemetry, whose walked parameters are more
FEW_DRAWS = 1_500  # where one event alone has to be far off
Chained = tuple[Path, tuple[TotalsEvent, ...], Priors]


def fitted(model: Model, seed: int, draws: int = DRAWS) -> tuple[WarmStart, Fit]:
    """Importance draws of a model, resampled, as a fit."""
    rng = np.random.default_rng(seed)
    density = partial(log_posterior, model)
    warm = warm_start(density, model.space.dimension, rng, draws=draws)
    z = warm.draws.resample(rng, draws)
    return warm, build_fit(model, z[None], density(z)[None], rng, {"walkers": 1}, 500)


def priors_file(folder: Path, fit: str = "") -> Path:
    """B-branch priors under which one event says much of its thrusters; ``fit`` is chained."""
    table = tomllib.loads(B_BRANCH.read_text())
    for name, scale in (
        ("tau_fall_s", 0.004),
        ("thrust_individual_n", 0.06),
        ("thrust_event_n", 0.003),
        ("thrust_jitter_n", 0.003),
    ):
        table["parameters"][name]["scale"] = scale
    # with an unknown rate one event's draws would be a scale mixture, which is refused
    rate = {"fixed": 4e-5, "unit": "rad/s", "source": "test"}
    table["parameters"]["hold_rate_rad_s"] = rate
    path = folder / ("chained.toml" if fit else "plain.toml")
    path.write_text(tomli_w.dumps({**({"from_fit": fit} if fit else {}), **table}))
    return path


def chained_file(folder: Path, fit: str = "first.nc") -> Path:
    """The same priors with ``from_fit``."""
    return priors_file(folder, fit)


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Chained:
    """A folder with the fit of one event, the two events, and the plain priors."""
    folder = tmp_path_factory.mktemp("chain")
    rows, _ = flight(2)
    priors = read_priors(priors_file(folder))
    first = build_model(rows[:1], priors, delta_v="ignore")
    save_fit(fitted(first, 1)[1], folder / "first.nc")
    return folder, rows, priors


@pytest.fixture(scope="module")
def later_fit(chain: Chained) -> tuple[WarmStart, Fit]:
    """The second event fitted with the first one's posterior as its prior."""
    folder, rows, _ = chain
    later = read_priors(chained_file(folder))
    return fitted(build_model(rows[1:], later, delta_v="ignore"), 3)


def scalars(fit: Fit, last: str = "2009-10-05-bias") -> dict[str, Array]:
    """Draws of the shared parameters, the levels and the thrusts of the ``last`` event."""
    found: dict[str, Array] = {}
    for name, variable in fit.posterior.data_vars.items():
        values = variable
        if "event" in variable.dims:
            if name != "thrust_n":
                continue
            values = variable.sel(event=last)
        flat = values.values.reshape(fit.posterior.sizes["draw"], -1)
        found |= {f"{name}{i}": flat[:, i] for i in range(flat.shape[1])}
    return found


@pytest.mark.statistical
def test_two_events_in_sequence_equal_both_at_once(
    chain: Chained, later_fit: tuple[WarmStart, Fit]
) -> None:
    """Means and widths of shared scalars and of the later thrusts, within Monte Carlo error."""
    _, rows, priors = chain
    both, both_fit = fitted(build_model(rows, priors, delta_v="ignore"), 2)
    after, after_fit = later_fit
    assert both.draws.pareto_k < 0.7
    assert after.draws.pareto_k < 0.7
    effective = [warm.draws.efficiency * DRAWS for warm in (both, after)]
    # the moments handed on have the first fit's own Monte Carlo error
    error = np.sqrt(1 / effective[0] + 1 / effective[1] + 2 / DRAWS)
    ours, theirs = scalars(after_fit), scalars(both_fit)
    assert set(ours) == set(theirs)
    for name, values in theirs.items():
        if values.std() == 0:
            continue
        shift = (ours[name].mean() - values.mean()) / values.std()
        assert abs(shift) < 5 * error, name
        assert abs(ours[name].std() / values.std() - 1) < 5 * error, name


def test_forgetting_the_first_event_would_be_seen(
    chain: Chained, later_fit: tuple[WarmStart, Fit]
) -> None:
    """Negative control: the second event alone has wider levels than the chain has."""
    _, rows, priors = chain
    alone = fitted(build_model(rows[1:], priors, delta_v="ignore"), 4, FEW_DRAWS)[1]
    widths = [fit.posterior[LEVELS].values[0].std(0) for fit in (alone, later_fit[1])]
    assert (widths[0] / widths[1]).max() > 1.1


def test_prior_of_the_chained_model_is_the_posterior_of_the_first(
    chain: Chained,
) -> None:
    """Prior draws have the first fit's means, widths and correlation of tail-off and levels."""
    folder, rows, _ = chain
    later = read_priors(chained_file(folder))
    model = build_model(rows[1:], later, delta_v="ignore")
    drawn = draw_prior(model, 20_000, np.random.default_rng(6))
    draws = drawn.thrusts
    with xr.open_dataset(folder / "first.nc", group="posterior", engine="h5netcdf") as stored:
        levels = stored[LEVELS].values.reshape(-1, 8)
        fall = stored["tau_fall_s"].values.reshape(-1)
        common = stored["thrust_common_n"].values.reshape(-1)
    assert draws.level_n.mean(0) == pytest.approx(levels.mean(0), abs=0.05 * levels.std())
    assert draws.level_n.std(0) == pytest.approx(levels.std(0), rel=0.05)
    assert draws.common_n.mean() == pytest.approx(common.mean(), abs=0.05 * common.std())
    assert draws.common_n.std() == pytest.approx(common.std(), rel=0.05)
    before = np.corrcoef(fall, levels[:, 0])[0, 1]
    after = np.corrcoef(np.asarray(drawn.parameters["tau_fall_s"]), draws.level_n[:, 0])[0, 1]
    assert after == pytest.approx(before, abs=0.04)
    assert abs(before) > 0.3


def test_coordinates_of_a_chained_space_go_there_and_back(
    chain: Chained,
) -> None:
    """to_standard undoes to_parameters; without an earlier fit nothing has changed."""
    folder, rows, priors = chain
    model = build_model(rows[1:], read_priors(chained_file(folder)), delta_v="ignore")
    z = model.space.sample(np.random.default_rng(7), 50)
    assert model.space.to_standard(model.space.to_parameters(z)) == pytest.approx(z, abs=1e-7)
    assert model.space.joint is not None
    assert build_model(rows[1:], priors, delta_v="ignore").space.joint is None


def test_moved_information_is_the_same_function() -> None:
    """log L(F) does not depend on the level it is counted from."""
    rows, priors = flight(2)
    model = build_model(rows, priors, delta_v="ignore")
    rng = np.random.default_rng(8)
    z = 0.3 * model.space.sample(rng, 3)
    (rows,) = collapse(model, z).terms
    plain = rows.information
    offset = 0.05 * rng.standard_normal((3, 8))
    moved = plain.about(offset)
    departure = 0.05 * rng.standard_normal((3, 2, 8))

    def value(information: object, d: Array) -> Array:
        info = information
        assert isinstance(info, type(plain))
        quadratic = np.einsum("nek,nekl,nel->ne", d, info.matrix, d)
        return np.asarray(info.constant + (info.vector * d).sum(-1) - 0.5 * quadratic)

    assert value(moved, departure - offset[:, None]) == pytest.approx(value(plain, departure))


def spoilt(folder: Path, name: str, change: str) -> str:
    """The first fit with its tail-off changed into something that is not normal."""
    with xr.open_dataset(folder / "first.nc", group="posterior", engine="h5netcdf") as stored:
        data = stored.load()
    fall = data["tau_fall_s"]
    centred = fall - fall.mean()
    if change == "two modes":
        data["tau_fall_s"] = 0.06 + 0.01 * np.sign(centred) + 0.05 * centred
    elif change == "skewed":
        data["tau_fall_s"] = 0.02 + 0.01 * np.exp(1.0 * centred / centred.std())
    else:
        data = data.isel(draw=slice(0, 300))
    data.to_netcdf(folder / name, group="posterior", engine="h5netcdf")
    return name


@pytest.mark.parametrize("change", ["two modes", "skewed", "few"])
def test_draws_that_are_visibly_not_normal_are_refused(chain: Chained, change: str) -> None:
    """Two modes, a skewed parameter, too few draws: the message names file and key."""
    folder = chain[0]
    name = spoilt(folder, f"{change.replace(' ', '-')}.nc", change)
    wanted = "too few" if change == "few" else "skewness"
    with pytest.raises(InputError, match=wanted) as caught:
        read_priors(chained_file(folder, name))
    assert "from_fit" in caught.value.where


def test_a_file_that_fixes_all_that_was_walked_is_refused(chain: Chained) -> None:
    """Nothing would be handed on but levels, whose mean is a regression on what was walked."""
    folder = chain[0]
    table = tomllib.loads(chained_file(folder).read_text())
    for entry in table["parameters"].values():
        if "dist" in entry:
            kept = {key: entry[key] for key in ("unit", "source")}
            entry.clear()
            entry |= {"fixed": 0.0, **kept}
    table["parameters"]["thrust_common_n"]["fixed"] = 1.0
    path = folder / "all_fixed.toml"
    path.write_text(tomli_w.dumps(table))
    with pytest.raises(InputError, match=r"from_fit: expected a free parameter .*first\.nc walked"):
        read_priors(path)


def shared_inertia() -> Spacecraft:
    """Cassini, all of whose wheels have the inertia parameter of the first."""
    craft = load_spacecraft("cassini")
    parameter = craft.wheels[0].inertia_parameter
    wheels = tuple(replace(wheel, inertia_parameter=parameter) for wheel in craft.wheels)
    return replace(craft, wheels=wheels)


def test_a_shared_inertia_is_that_of_the_first_wheel_in_the_fit() -> None:
    """Prime wheels alone are in a fit: the last of the file may not be, and was asked for."""
    craft = shared_inertia()
    parameter = craft.wheels[0].inertia_parameter
    values = np.random.default_rng(1).random((1, 5, 2))
    for prime in (["rwa1", "rwa2"], ["rwa2", "rwa3"]):
        posterior = xr.Dataset(
            {"rwa_inertia_kg_m2": (("chain", "draw", "wheel"), values)}, {"wheel": prime}
        )
        assert inertia_wheels(posterior, craft) == {parameter: prime[0]}
        found = walked_values(posterior, [parameter], craft)[parameter]
        assert found == pytest.approx(values[0, :, 0])
    assert inertia_wheels(xr.Dataset(), craft) == {}


def test_misuse_is_refused(chain: Chained) -> None:
    """A missing fit, a computed ΔV, another branch, a changed chained prior: one line each."""
    folder, rows, _ = chain
    with pytest.raises(InputError, match=r"did you mean 'first.nc'"):
        read_priors(chained_file(folder, "frist.nc"))
    later = read_priors(chained_file(folder))
    with pytest.raises(InputError, match="ignore"):
        build_model(rows[1:], later)
    with pytest.raises(InputError, match="from_fit"):
        later.scaled(["tau_fall_s"], width=2.0)
    assert later.scaled(["mass_factor"], width=2.0).earlier is later.earlier
    assert isinstance(later.earlier, EarlierFit)
    other = replace(later.earlier, thrusters=("a",))
    assert other.thrusters != later.earlier.thrusters
    chained = build_model(rows[1:], later, delta_v="ignore")
    draws = draw(chained, np.zeros((2, 20)), np.random.default_rng(9))
    assert np.isfinite(draws.thrusts.level_n).all()


def telemetry_priors(folder: Path, fit: str = "") -> Path:
    """Telemetry priors under which one bias has near normal draws; ``fit`` is chained."""
    table = tomllib.loads(event_cases.PRIORS.read_text())
    for name in ("tau_fall_s", "thrust_event_n", "thrust_jitter_n"):
        table["parameters"][name]["scale"] = 0.004
    # with unknown noise levels the inertia's draws are a scale mixture, whose moments are less
    for name, value in (
        ("rate_noise_rad_s", 2e-6),
        ("wheel_noise_rpm", 0.2),
        ("torque_noise_n_m_s05", 1e-4),
        ("attitude_noise_rad", 2e-5),
        ("close_pulse_share", 0.3),
    ):
        unit = table["parameters"][name]["unit"]
        table["parameters"][name] = {"fixed": value, "unit": unit, "source": "test"}
    path = folder / ("chained.toml" if fit else "plain.toml")
    path.write_text(tomli_w.dumps({**({"from_fit": fit} if fit else {}), **table}))
    return path


@pytest.fixture(scope="module")
def telemetry(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, tuple[ReducedEvent, ...], WarmStart]:
    """A folder with the fit of one of two biases, both of them reduced, and that fit's draws."""
    folder = tmp_path_factory.mktemp("telemetry-chain")
    priors = read_priors(telemetry_priors(folder))
    document = event_cases.document()
    first = document["event"][0]
    rates = {"from_rpm": [250.0, -300.0, 100.0], "to_rpm": [-150.0, 200.0, 350.0]}
    second = first | rates | {"id": "later", "epoch": "2010-06-01T00:00:00Z"}
    document |= {"event": [first, second]}
    document["truth"] = document["truth"] | {"draw_from": str(folder / "plain.toml")}
    write_simulation(simulate_file(scenario_of(document), 7), folder)
    events = tuple(reduce_event(folder / n, priors, "first_order") for n in ("bias", "later"))
    warm, fit = fitted(build_model(events[:1], priors), 1, MORE_DRAWS)
    save_fit(fit, folder / "first.nc")
    return folder, events, warm


@pytest.mark.statistical
def test_two_telemetry_events_in_sequence_equal_both_at_once(
    telemetry: tuple[Path, tuple[ReducedEvent, ...], WarmStart],
) -> None:
    """Evidence, means and widths are those of both at once; the later bias alone is far off."""
    folder, events, first = telemetry
    plain, later = (read_priors(telemetry_priors(folder, fit)) for fit in ("", "first.nc"))
    both, both_fit = fitted(build_model(events, plain), 2, MORE_DRAWS)
    after, after_fit = fitted(build_model(events[1:], later), 3, MORE_DRAWS)
    _, alone_fit = fitted(build_model(events[1:], plain), 4, FEW_DRAWS)
    in_turn = first.draws.log_evidence + after.draws.log_evidence
    # a normal prior drops what the first posterior has beyond two moments: 0.18 nats, measured
    assert in_turn == pytest.approx(both.draws.log_evidence, abs=0.3)
    theirs, ours, alone = (scalars(fit, "later") for fit in (both_fit, after_fit, alone_fit))
    assert set(ours) == set(theirs)
    far = 0.0
    for name, values in theirs.items():
        if (width := values.std()) == 0:
            continue
        assert ours[name].mean() == pytest.approx(values.mean(), abs=0.15 * width), name
        assert ours[name].std() == pytest.approx(width, rel=0.1), name
        far = max(far, abs(alone[name].mean() - values.mean()) / width)
    assert far > 1.0


def test_what_a_chained_model_can_see(
    telemetry: tuple[Path, tuple[ReducedEvent, ...], WarmStart],
) -> None:
    """Prior widths are those after the first bias, expected ones those of both together."""
    folder, events, _ = telemetry
    plain, later = (read_priors(telemetry_priors(folder, fit)) for fit in ("", "first.nc"))
    first, both, chained = (
        observability(model).table.set_index("quantity")
        for model in (
            build_model(events[:1], plain),
            build_model(events, plain),
            build_model(events[1:], later),
        )
    )
    shared = [name for name in chained.index if "later" not in name]
    before, after = (chained.loc[shared, c] for c in ("prior_sd", "expected_sd"))
    # linearised at prior means: of how alike pairs of pulses are, too, which the bias tells
    np.testing.assert_allclose(before, first.loc[shared, "expected_sd"], rtol=0.08)
    np.testing.assert_allclose(after, both.loc[shared, "expected_sd"], rtol=0.1)
    ratio = chained.loc[shared, "ratio"]
    assert ratio["rwa4_tilt_u_rad"] < 0.6  # the first bias left it to the later one


def test_slews_start_from_what_a_bias_says_of_the_inertia(
    telemetry: tuple[Path, tuple[ReducedEvent, ...], WarmStart],
) -> None:
    """Where nothing fires levels have no place, and inertia has the earlier fit's width."""
    folder, _, _ = telemetry
    model = build_model(
        event_cases.events("slews"), read_priors(telemetry_priors(folder, "first.nc"))
    )
    assert not model.fires
    assert model.thrust_prior.chained is None
    drawn = draw_prior(model, 20_000, np.random.default_rng(6)).parameters["inertia_xy_kg_m2"]
    with xr.open_dataset(folder / "first.nc", group="posterior", engine="h5netcdf") as stored:
        width = float(stored["inertia_xy_kg_m2"].std())
    assert np.std(drawn) == pytest.approx(width, rel=0.05)
