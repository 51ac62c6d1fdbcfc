"""The comparison of error bars: sizes as printed, standard errors, coverage counted right."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import curve_fit
from totals_cases import B_BRANCH, FLIGHT, cassini_arm, cassini_wheel_axis, flight, point

from cassini_bayes.model import build_model
from cassini_bayes.studies.perturbation_campaign import holds_claim, verdict
from cassini_bayes.studies.perturbation_coverage import (
    CLAIMS,
    ESTIMANDS,
    EVENT_MEAN,
    LAPLACE,
    METHODS,
    POSTERIOR,
    READINGS,
    RSS,
    SQUARES,
    THRUSTER,
    THRUSTER_EVENT,
    WORST,
    CoverageCampaign,
    coverage_table,
    covered_set,
    squares_errors,
    stated_priors,
)


def test_priors_have_the_printed_sizes() -> None:
    """Paper 003's list as one sigma and as maximum; what is not in the list stays."""
    _, priors = flight(1)
    sizes = {
        "cm_x_m": 0.1 * 0.13, "inertia_xx_kg_m2": 0.05 * 6558, "inertia_xy_kg_m2": 0.5 * 164,
        "rwa1_inertia_kg_m2": 0.01 * 0.161, "rwa4_tilt_u_rad": 0.01, "thruster_lx_m": 0.01 * 1.234,
        "tau_fall_s": 0.1 * 0.05,
    }  # fmt: skip
    normal, uniform = (stated_priors(priors, reading).parameters for reading in READINGS)
    for name, size in sizes.items():
        one, most = normal[name].distribution, uniform[name].distribution
        assert one is not None
        assert most is not None
        assert one.sd() == pytest.approx(size)
        assert np.diff(most.support)[0] == pytest.approx(2 * size)
        assert one.mean() == pytest.approx(most.mean())
    for name in ("thrust_common_n", "hold_rate_rad_s", "tau_rise_s", "mass_factor"):
        assert normal[name] == priors.parameters[name]


def test_standard_errors_are_those_of_a_least_squares_program() -> None:
    """scipy's curve_fit on balances written out by hand gives the same errors, pooled and mean."""
    rows, priors = flight()
    model = build_model(rows, priors, delta_v="ignore")
    nominal = model.space.centre()
    values = point(model, np.zeros((1, model.space.dimension))) | nominal
    errors = squares_errors(model, nominal)
    couples = (("z1",), ("z2",), ("z3",), ("z4",), ("y1", "y3"), ("y2", "y4"))
    columns, change = np.zeros((8, 3, 6)), np.zeros((8, 3))
    for e, event in enumerate(rows):
        on_time = dict(zip(event.thrusters, event.on_time_s, strict=True))
        for g, group in enumerate(couples):
            columns[e, :, g] = sum(cassini_arm(n, values) * on_time[n] for n in group)
        for number, start, end in zip(
            event.wheels, event.rwa_start_rpm, event.rwa_end_rpm, strict=True
        ):
            inertia = values[f"rwa{number}_inertia_kg_m2"]
            turn = (end - start) * 2 * np.pi / 60
            change[e] += inertia * turn * cassini_wheel_axis(number, values)

    def by_scipy(design: np.ndarray, target: np.ndarray) -> np.ndarray:
        start = np.full(design.shape[1], 0.9)
        _, covariance = curve_fit(lambda x, *f: x @ np.array(f), design, target, p0=start)
        return np.sqrt(np.diagonal(covariance))

    def stretch(on_time: np.ndarray, pulses: np.ndarray) -> np.ndarray:
        return 1 + (values["tau_fall_s"] - values["tau_rise_s"]) * pulses / on_time

    pulses = np.array([event.pulses for event in rows])
    on_times = np.array([event.on_time_s for event in rows])
    pooled = by_scipy(columns.reshape(24, 6), change.reshape(24))[[0, 1, 2, 3, 4, 5, 4, 5]]
    error, freedom = errors[THRUSTER]
    assert freedom == 24 - 6
    assert error == pytest.approx(pooled / stretch(on_times.sum(0), pulses.sum(0)), rel=1e-5)
    error, freedom = errors[EVENT_MEAN]
    assert freedom == 3 - 1
    for e in range(8):
        alone = by_scipy(columns[e].sum(1, keepdims=True), change[e])[0]
        assert error[e] == pytest.approx(
            alone / stretch(on_times[e].sum(), pulses[e].sum()), rel=1e-5
        )


def made_up(sets: int = 400) -> dict[str, np.ndarray]:
    """Unit normal errors: intervals of the right, half and no length; every fourth not valid."""
    rng = np.random.default_rng(2)
    found = {}
    for name in ESTIMANDS:
        truth = rng.standard_normal((sets, 4))
        valid = np.ones((sets, 4))
        valid[:, 3] = 0.0
        found[f"{name}.truth"], found[f"{name}.valid"] = truth, valid
        for method in METHODS:
            for claim, half in zip(CLAIMS, (0.9945, 1.6449), strict=True):
                width = {RSS: 0.5, SQUARES: 0.01, WORST: 3.0}.get(method, 1.0) * half
                ends = np.stack([np.full_like(truth, -width), np.full_like(truth, width)], -1)
                ends[:, 3] = 0.0
                found[f"{name}.{method}.{claim}"] = ends
    return found


def test_coverage_and_length_are_counted_over_valid_estimates() -> None:
    """Right intervals hold what they claim, half as long ones do not; errors are binomial."""
    table = coverage_table({reading: made_up() for reading in READINGS})
    own = table[(table["reading"] == READINGS[0]) & (table["estimand"] == EVENT_MEAN)]
    right = own[own["method"] == POSTERIOR].set_index("claim")
    half = own[own["method"] == RSS].set_index("claim")
    assert right["intervals"].tolist() == [1_200, 1_200]
    assert holds_claim(right.reset_index()).all()
    assert not holds_claim(half.reset_index()).any()
    assert right.loc[0.9, "coverage_error"] == pytest.approx(np.sqrt(0.09 / 1_200), rel=0.2)
    assert right.loc[0.9, "mean_length_n"] == pytest.approx(2 * 1.6449)
    text = verdict(table)
    assert "posterior 12 of 12" in text
    assert "RSS 0 of 8 (8 too short)" in text
    assert "together are 1.0 to 1.0 times as long" in text


def test_a_set_has_every_interval_and_repeats_itself() -> None:
    """One simulated set: ends in order, truths near, the same numbers from the same seed."""
    campaign = CoverageCampaign(FLIGHT, B_BRANCH, "maximum", seed=5)
    found = covered_set(campaign, 2)
    again = covered_set(campaign, 2)
    assert all(np.array_equal(found[key], again[key]) for key in found)
    assert found[f"{EVENT_MEAN}.truth"].shape == (8,)
    assert found[f"{THRUSTER_EVENT}.truth"].shape == (64,)
    for name in ESTIMANDS:
        for method in METHODS:
            for claim in CLAIMS:
                ends = found.get(f"{name}.{method}.{claim}")
                if ends is None:
                    assert name == THRUSTER_EVENT
                    continue
                kept = found[f"{name}.valid"] > 0
                assert (ends[kept, 0] < ends[kept, 1]).all()
        middle = found[f"{name}.{POSTERIOR}.0.9"].mean(-1)
        laplace = found[f"{name}.{LAPLACE}.0.9"].mean(-1)
        assert np.abs(middle - found[f"{name}.truth"]).max() < 0.15
        assert np.abs(middle - laplace).max() < 0.02
    assert found["pareto_k"] < 0.7


def test_point_of_a_uniform_prior_is_inside_it() -> None:
    """Walked coordinates of the maximum reading never leave the stated sizes."""
    rows, priors = flight(1)
    model = build_model(rows, stated_priors(priors, "maximum"), delta_v="ignore")
    far = point(model, np.full((1, model.space.dimension), 9.0))
    assert far["cm_x_m"] == pytest.approx(1.1 * 0.13)
