"""Cells of a sweep: weighted and fitted anew against closed forms and against each other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from scipy.stats import truncnorm
from sweep_cases import (
    TOY_NAMES,
    bounded_baseline,
    bounded_likelihood,
    small_fit,
    toy_baseline,
    toy_exact,
)
from telemetry_cases import event_of, made_up_samples, telemetry_priors
from totals_cases import flight

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.results.record import Fit
from cassini_bayes.sweep.cells import BY_CHAIN, REFITTED, REWEIGHTED, cell_arrays
from cassini_bayes.sweep.models import Factory, chosen_names
from cassini_bayes.sweep.plan import plan
from cassini_bayes.sweep.specification import GridTable, GroupTable, SweepFile, check_sweep
from cassini_bayes.sweep.variations import Group, Variation, blocks_of, grid_of, with_family
from cassini_bayes.sweep.weights import Weights, smoothed_weights

CENTRE = "centre of mass"


@pytest.fixture(scope="module")
def fitted() -> tuple[Factory, Fit]:
    """Two flight events, fitted by importance draws."""
    return small_fit()


@pytest.mark.parametrize(
    "variation",
    [
        Variation(CENTRE, "width", TOY_NAMES, amount=0.5),
        Variation(CENTRE, "width", TOY_NAMES, amount=1.5),
        Variation(CENTRE, "shift", ("cm_x_m",), amount=1.0),
        Variation("events", "without", event="datum"),
    ],
    ids=lambda v: v.key,
)
def test_toy_cells_agree_with_the_closed_form(variation: Variation) -> None:
    """Weighted where trusted, and fitted anew: mean and width of a conjugate normal, 4.5 s.e."""
    baseline = toy_baseline()
    arrays = cell_arrays(baseline, variation, "always")
    before_mean, before_sd = toy_exact(baseline.factory.priors)
    priors = variation.applied(baseline.factory.priors)
    if variation.kind == "without":
        distributions = [priors.parameters[name].distribution for name in TOY_NAMES]
        mean = np.array([d.keywords["loc"] for d in distributions if d is not None])
        sd = np.array([d.keywords["scale"] for d in distributions if d is not None])
    else:
        mean, sd = toy_exact(priors)
    assert str(arrays["1.kind"]) == REFITTED
    ways = ["0", "1"] if float(arrays["0.pareto_k"]) < 0.5 else ["1"]
    for way in ways:
        shift = (mean - before_mean) / before_sd
        # the baseline's own sd, the unit of the shift, has an error too
        slack = np.abs(shift) / np.sqrt(2 * 8_000)
        error = np.hypot(arrays[f"{way}.shift_error"], slack)
        assert (np.abs(arrays[f"{way}.shift"] - shift) < 4.5 * error).all()
        width = np.asarray(arrays[f"{way}.width"]) - sd / before_sd
        assert (np.abs(width) < 4.5 * arrays[f"{way}.width_error"]).all()


def test_untrusted_cells_are_fitted_anew_and_trusted_ones_are_not() -> None:
    """auto fits a four times wider prior anew, keeps a narrower one; never keeps both."""
    baseline = toy_baseline()
    wide = Variation(CENTRE, "width", TOY_NAMES, amount=4.0)
    near = Variation(CENTRE, "width", TOY_NAMES, amount=0.8)
    assert str(cell_arrays(baseline, wide, "auto")["1.kind"]) in (REFITTED, BY_CHAIN)
    assert "1.kind" not in cell_arrays(baseline, near, "auto")
    only = cell_arrays(baseline, wide, "never")
    assert str(only["0.kind"]) == REWEIGHTED
    assert "1.kind" not in only


@pytest.mark.parametrize(
    ("kind", "amount", "reached"),
    [("width", 2.0, False), ("shift", 1.0, False), ("width", 0.5, True)],
)
def test_values_that_the_old_prior_excluded_are_fitted_anew(
    kind: Literal["width", "shift"], amount: float, reached: bool
) -> None:
    """A uniform made wider or moved has weights that are all alike, and still is not trusted; its
    own fit is the truncated normal of the closed form (4.5 s.e.). Inside the old one weights do.
    """
    baseline = bounded_baseline()
    variation = Variation(CENTRE, kind, ("cm_x_m",), amount=amount)
    arrays = cell_arrays(baseline, variation, "auto")
    assert ("1.kind" in arrays) is not reached
    centre, width, _ = bounded_likelihood(baseline.factory.priors)
    changed = variation.applied(baseline.factory.priors).parameters["cm_x_m"].distribution
    assert changed is not None
    low, high = ((end - centre) / width for end in changed.support)
    before, after = truncnorm(0.5, 1.5, centre, width), truncnorm(low, high, centre, width)
    way = "0" if reached else "1"
    shift = (after.mean() - before.mean()) / before.std()
    error = np.hypot(arrays[f"{way}.shift_error"][0], abs(shift) / np.sqrt(2 * 8_000))
    assert abs(arrays[f"{way}.shift"][0] - shift) < 4.5 * error
    ratio = after.std() / before.std()
    assert abs(arrays[f"{way}.width"][0] - ratio) < 4.5 * arrays[f"{way}.width_error"][0]
    if not reached:
        only = cell_arrays(baseline, variation, "never")
        assert float(only["0.pareto_k"]) == np.inf
        assert np.isnan(only["0.shift"]).all()


def test_a_chain_stands_in_where_importance_draws_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """With no weights trusted the cell is a chain's, and is that of the closed form (4.5 s.e.)."""

    def distrusted(log_ratio: Array) -> Weights:
        return replace(smoothed_weights(log_ratio), pareto_k=9.0)

    monkeypatch.setattr("cassini_bayes.sweep.cells.smoothed_weights", distrusted)
    baseline = toy_baseline()
    wide = Variation(CENTRE, "width", TOY_NAMES, amount=4.0)
    arrays = cell_arrays(baseline, wide, "auto")
    before_mean, before_sd = toy_exact(baseline.factory.priors)
    mean, sd = toy_exact(wide.applied(baseline.factory.priors))
    assert str(arrays["1.kind"]) == BY_CHAIN
    shift = arrays["1.shift"] - (mean - before_mean) / before_sd
    assert (np.abs(shift) < 4.5 * arrays["1.shift_error"]).all()
    assert (np.abs(arrays["1.width"] - sd / before_sd) < 4.5 * arrays["1.width_error"]).all()


def test_cells_do_not_depend_on_the_order_they_are_worked_out_in() -> None:
    """The same cell gives the same numbers again: its random stream is its own."""
    baseline = toy_baseline()
    cell = Variation(CENTRE, "width", TOY_NAMES, amount=4.0)
    first, again = (cell_arrays(baseline, cell, "auto") for _ in range(2))
    assert first.keys() == again.keys()
    assert all(np.array_equal(first[key], again[key]) for key in first)


@pytest.mark.statistical
def test_weighted_and_fitted_anew_agree_where_the_weights_are_good(
    fitted: tuple[Factory, Fit],
) -> None:
    """Flight events: every trusted cell agrees with its own fit within Monte Carlo error."""
    factory, fit = fitted
    sweep = SweepFile(
        quantities=["thrust_level_n", "tau_fall_s", "thrust_n[2009-08-22-bias,z1]"],
        blocks=["tail-off", "thrust"],
        grid=GridTable(widths=[0.5, 1.5], shifts=[1.0], families=["student-t"]),
    )
    study = plan(factory, fit, sweep, "test")
    cells = [
        cell
        for cell in study.cells.values()
        if cell.kind != "shift" or cell.parameters[0] in ("tau_fall_s", "thrust_common_n")
    ]
    scores = []
    for cell in cells:
        arrays = cell_arrays(study.baseline, cell, "always")
        if not (float(arrays["0.pareto_k"]) <= 0.7 and float(arrays["0.effective"]) >= 400):
            continue
        for what in ("shift", "width"):
            error = np.hypot(arrays[f"0.{what}_error"], arrays[f"1.{what}_error"])
            score = (arrays[f"0.{what}"] - arrays[f"1.{what}"]) / error
            scores.append(score[np.isfinite(score)])
    every = np.concatenate(scores)
    assert len(scores) >= 12  # six cells at least, shift and width of each
    assert np.abs(every).max() < 4.5
    assert np.sqrt((every**2).mean()) < 1.4


def test_wrong_weights_would_be_seen(fitted: tuple[Factory, Fit]) -> None:
    """Negative control: weights of another change than the one fitted are many errors off."""
    factory, fit = fitted
    sweep = SweepFile(quantities=["thrust_level_n"], blocks=["tail-off"])
    study = plan(factory, fit, sweep, "test")
    up, down = (
        Variation("tail-off", "shift", ("tau_fall_s",), amount=amount) for amount in (1.0, -1.0)
    )
    weighted = cell_arrays(study.baseline, up, "never")
    anew = cell_arrays(study.baseline, down, "always")
    error = np.hypot(weighted["0.shift_error"], anew["1.shift_error"])
    assert (np.abs(weighted["0.shift"] - anew["1.shift"]) > 8 * error).all()


def test_fits_of_other_priors_are_refused(fitted: tuple[Factory, Fit]) -> None:
    """A fit whose log density the model does not give back is not swept."""
    factory, fit = fitted
    other = replace(factory, priors=factory.priors.scaled(["hold_rate_rad_s"], shift=0.1))
    with pytest.raises(InputError, match="run the fit again"):
        plan(other, fit, SweepFile(), "test")


def test_fits_without_the_log_prior_of_a_block_are_refused(
    fitted: tuple[Factory, Fit],
) -> None:
    """A fit of an older version would lose a block's power scaling without a word."""
    factory, fit = fitted
    older = fit.groups["log_prior"].drop_vars("thrust")
    with pytest.raises(InputError, match="the block thrust"):
        plan(factory, replace(fit, groups={**fit.groups, "log_prior": older}), SweepFile(), "test")


def test_groups_that_would_share_a_file_are_refused(fitted: tuple[Factory, Fit]) -> None:
    """Names that differ only in signs a file name cannot have: no cell replaces another."""
    factory, fit = fitted
    groups = [
        GroupTable(name=name, parameters=[parameter])
        for name, parameter in (("my arm", "cm_x_m"), ("my/arm", "cm_y_m"))
    ]
    with pytest.raises(InputError, match="rename one"):
        plan(factory, fit, SweepFile(group=groups), "test")


def test_an_edited_sweep_takes_no_cell_of_the_earlier_one(fitted: tuple[Factory, Fit]) -> None:
    """Other parameters under a group's name, or another seventh digit, are other files; what was
    not edited keeps its own.
    """
    factory, fit = fitted

    def files(parameters: list[str], width: float) -> list[str]:
        grid = GridTable(widths=[0.5, width], shifts=[], families=[], events=False)
        group = GroupTable(name="mine", parameters=parameters)
        return list(plan(factory, fit, SweepFile(group=[group], grid=grid), "test").cells)

    before = files(["cm_x_m"], 2.0)
    assert files(["cm_x_m"], 2.0) == before
    assert not set(files(["tau_fall_s"], 2.0)) & set(before)
    assert not set(files(["cm_x_m", "cm_y_m"], 2.0)) & set(before)
    edited = files(["cm_x_m"], 2.0000001)
    assert edited[0] == before[0]
    assert edited[1] != before[1]


def test_priors_beyond_arithmetic_are_one_line(fitted: tuple[Factory, Fit]) -> None:
    """A width under which a matrix cannot be factored is an input error that names the cell."""
    factory, fit = fitted
    study = plan(factory, fit, SweepFile(blocks=["thrust"]), "test")
    thrusts = next(cell for cell in study.cells.values() if cell.kind == "width").parameters
    wild = Variation("thrust", "width", thrusts, amount=1e12)
    with pytest.raises(InputError, match=r"thrust, width × 1e\+12.*milder"):
        cell_arrays(study.baseline, wild, "always")


@pytest.mark.parametrize(
    ("block", "shift", "said"),
    [
        ("tail-off", -100.0, "tail-off, tau_rise_s − 100 σ: .* of the norm's probability"),
        (CENTRE, 100.0, r"centre of mass, cm_x_m \+ 100 σ: .* torque about y is positive"),
        ("thrust", -100.0, "thrust, thrust_common_n − 100 σ: .* a positive mean"),
    ],
)
def test_a_change_too_extreme_for_prior_or_model_is_named(
    fitted: tuple[Factory, Fit], block: str, shift: float, said: str
) -> None:
    """One line says which group and change it is, wherever it fails."""
    factory, fit = fitted
    grid = GridTable(widths=[], shifts=[shift], families=[], events=False)

    def sweep() -> None:
        study = plan(factory, fit, SweepFile(blocks=[block], grid=grid), "test")
        for cell in study.cells.values():
            cell_arrays(study.baseline, cell, "never")

    with pytest.raises(InputError, match=f"^sweep: {said}.*or leave this change out"):
        sweep()


def test_quantities_are_chosen_by_name_element_and_star(
    fitted: tuple[Factory, Fit],
) -> None:
    """A quantity means all its elements, * any part; what is fixed or unknown is refused."""
    posterior = fitted[1].posterior
    assert len(chosen_names(posterior, ["thrust_level_n"], "t")) == 8
    assert chosen_names(posterior, ["thrust_n[*,z1]"], "t") == (
        "thrust_n[2009-08-22-bias,z1]",
        "thrust_n[2009-10-05-bias,z1]",
    )
    with pytest.raises(InputError, match="did you mean 'tau_fall_s'"):
        chosen_names(posterior, ["tau_fal_s"], "t")


def test_every_block_is_swept_by_default(fitted: tuple[Factory, Fit]) -> None:
    """The grid covers the blocks the model has, and changes something in every cell."""
    factory, fit = fitted
    study = plan(factory, fit, SweepFile(), "test")
    groups = {cell.group for cell in study.cells.values()}
    assert groups >= {
        CENTRE, "wheel inertia", "wheel alignment", "tail-off", "geometry", "thrust", "inertia",
        "noise", "events",
    }  # fmt: skip
    assert len({cell.key for cell in study.cells.values()}) == len(study.cells)
    shifted = {c.parameters[0] for c in study.cells.values() if c.kind == "shift"}
    assert "thrust_common_n" in shifted
    assert not shifted & {"thrust_individual_n", "thrust_event_n", "thrust_jitter_n"}


def test_every_cell_of_telemetry_alone_can_be_computed() -> None:
    """No change of the default grid asks a telemetry model for a parameter it cannot walk."""
    priors = telemetry_priors()
    factory = Factory((event_of(made_up_samples(np.random.default_rng(1)), priors),), priors)
    model = factory.build(priors)
    grid = GridTable()
    cells = grid_of(blocks_of(model, priors), model, priors, grid, "sweep")
    assert {cell.group for cell in cells} >= {"thrust", "inertia", "torque", "tail-off"}
    for cell in cells:
        changed = factory.build(cell.applied(priors))
        middle = np.zeros((1, changed.space.dimension))
        assert np.isfinite(changed.log_likelihood(middle)).all(), cell.key


def test_groups_of_unknown_or_fixed_parameters_are_refused() -> None:
    """A parameter the model does not use, or a group with nothing free, is an input error."""
    rows, priors = flight(1)
    model = Factory(rows, priors, delta_v="ignore").build(priors)
    grid = GridTable(widths=[2.0], shifts=[], families=[])
    with pytest.raises(InputError, match="mass_factor"):
        grid_of([Group("own", ("mass_factor",))], model, priors, grid, "sweep")
    fixed = priors.with_fixed("cm_x_m", 0.1)
    with pytest.raises(InputError, match="distribution"):
        grid_of([Group("own", ("cm_x_m",))], model, fixed, grid, "sweep")
    assert "mass" not in [group.name for group in blocks_of(model, priors)]


@pytest.mark.parametrize("family", ["normal", "student-t", "uniform"])
def test_families_keep_centre_spread_and_bounds(family: str) -> None:
    """Mean and standard deviation stay; a log-normal keeps both in the logarithm."""
    plain = with_family(Distribution("norm", {"loc": 3.0, "scale": 0.5}), family)
    assert plain.mean() == pytest.approx(3.0)
    assert plain.sd() == pytest.approx(0.5, rel=1e-3)
    bounded = with_family(Distribution("norm", {"loc": 0.05, "scale": 0.02}, low=0.0), family)
    assert bounded.low == 0.0
    skew = with_family(Distribution("lognorm", {"s": 0.5, "scale": 4e-5}), family)
    logs = np.log(skew.sample(np.random.default_rng(1), 40_000))
    assert logs.mean() == pytest.approx(np.log(4e-5), abs=0.015)
    assert logs.std() == pytest.approx(0.5, rel=0.03)


@pytest.mark.parametrize("family", ["normal", "student-t"])
@pytest.mark.parametrize(
    ("distribution", "support"),
    [
        (Distribution("uniform", {"loc": 0.0, "scale": 0.6}), (0.0, 0.6)),
        (Distribution("halfnorm", {"scale": 0.2}), (0.0, np.inf)),
        (Distribution("beta", {"a": 2.0, "b": 3.0}, high=0.9), (0.0, 0.9)),
    ],
    ids=lambda value: value.name if isinstance(value, Distribution) else "",
)
def test_other_families_keep_the_ends_of_the_support(
    distribution: Distribution, support: tuple[float, float], family: str
) -> None:
    """A share stays one whatever the family: a normal in place of a uniform is cut at its ends."""
    assert with_family(distribution, family).support == support


@pytest.mark.parametrize(
    ("distribution", "family"),
    [
        (Distribution("uniform", {"loc": 0.1, "scale": 0.6}), "uniform"),
        (Distribution("norm", {"loc": 0.1, "scale": 0.3}, low=0.0), "normal"),
        (Distribution("t", {"df": 2.0, "loc": 0.1}), "student-t"),
        (Distribution("lognorm", {"s": 0.5}), "normal"),
    ],
)
def test_a_family_that_a_prior_has_changes_nothing(distribution: Distribution, family: str) -> None:
    """Not even the last digit: a cell that changes nothing is left out of a sweep."""
    assert with_family(distribution, family) is distribution


@pytest.mark.parametrize(
    ("grid", "said"),
    [
        (
            {"shifts": [2_000.0]},
            r"s: grid.shifts\[1\]: expected a shift in prior standard deviations, 100 at most",
        ),
        ({"widths": [0.5, 1e9]}, r"s: grid.widths\[2\]: expected a factor above 0, 0.001 to 1000"),
        ({"widths": [0.0]}, r"s: grid.widths\[1\]"),
    ],
)
def test_amounts_that_no_float_can_hold_are_refused(grid: dict[str, Any], said: str) -> None:
    """A prior moved by two thousand of its widths is a slip, and overflows a lognormal."""
    with pytest.raises(InputError, match=said):
        check_sweep({"grid": grid}, "s")
