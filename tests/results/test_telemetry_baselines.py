"""The papers' least squares on telemetry: exact where their assumptions hold."""

from __future__ import annotations

import json

import numpy as np
import pytest
from event_cases import model, simulated

from cassini_bayes.results.baselines import MEAN, PER_EVENT, assumed_points
from cassini_bayes.results.inertia_baselines import all_axes, axis_by_axis, inertia_methods
from cassini_bayes.results.telemetry_baselines import (
    UNCORRECTED,
    PlainRows,
    drift_torque,
    individual_and_paired,
    mean_thrust,
    ratio,
    thrust_methods,
)

COUPLES = ((0,), (1,), (2,), (3,), (4, 6), (5, 7))


def lever_columns(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Lever arms of Z and paired Y thrusters times growing on-times: (1, rows, 3, 8), on-times."""
    z = np.array([[-1.5, -1.5, 1.7, 1.7], [1.1, -1.3, -1.3, 1.1], [0.0, 0.0, 0.0, 0.0]])
    y = np.array([[1.8, 1.8, -1.8, -1.8], [0.0, 0.0, 0.0, 0.0], [-1.1, 1.3, -1.3, 1.1]])
    own = np.cumsum(rng.random((40, 6)), axis=0)
    on_time = own[:, [0, 1, 2, 3, 4, 5, 4, 5]]
    return (np.concatenate([z, y], axis=1) * on_time[:, None, :])[None], on_time


def test_individual_and_paired_thrusts_are_exact_without_noise() -> None:
    """Paper 000 eqs. 18-21 as one least squares: Z thrusters apart, Y thrusters in pairs."""
    columns, _ = lever_columns(np.random.default_rng(2))
    thrust = np.array([0.7, 0.8, 0.75, 0.65, 0.9, 0.6, 0.9, 0.6])
    found = individual_and_paired(columns, columns @ thrust, COUPLES)
    assert found[0] == pytest.approx(thrust, rel=1e-9)


def test_means_over_thrusters_are_exact_when_they_are_equal() -> None:
    """Paper 000 eqs. 22 and 23; the mean of the Y thrusters ignores what Z thrusters do."""
    columns, _ = lever_columns(np.random.default_rng(3))
    equal = np.full(8, 0.731)
    assert mean_thrust(columns, columns @ equal, range(8))[0] == pytest.approx(equal, rel=1e-9)
    thrust = np.array([0.1, 0.2, 0.3, 0.4, 0.731, 0.731, 0.731, 0.731])
    found = mean_thrust(columns, columns @ thrust, [4, 5, 6, 7])[0]
    assert found[4:] == pytest.approx(np.full(4, 0.731), rel=1e-9)
    assert np.isnan(found[:4]).all()


def test_impulse_ratio_of_the_fsds_case() -> None:
    """Paper 000: 133 pulses of 125 ms, 16 of 250, one of 500, one of 750: R = 1.3406, 0.731 N."""
    widths = np.repeat([0.125, 0.25, 0.5, 0.75], [133, 16, 1, 1])
    gaps = np.zeros(2 * len(widths) + 1)
    gaps[1::2] = widths  # every pulse is followed by a quiet interval
    on_time = np.cumsum(gaps)[:, None]
    pulses = np.cumsum(gaps > 0)[:, None].astype(float)
    rows = len(on_time)
    data = PlainRows(np.arange(float(rows)), np.empty(0), np.empty(0), np.empty(0), on_time, pulses)
    taus = {"tau_delay_s": 0.005, "tau_rise_s": 0.020, "tau_fall_s": 0.065}
    found = ratio(data, {name: np.array([value]) for name, value in taus.items()})
    assert on_time[-1, 0] == pytest.approx(21.875)
    assert found[0, 0] == pytest.approx(1.3406, abs=5e-4)
    assert 0.98 / found[0, 0] == pytest.approx(0.731, abs=5e-4)


def exchanged_by(tensor: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Momentum that a body with this tensor takes up, (1, rows, 3)."""
    return (rate @ tensor.T)[None]


TENSOR = np.array([[8655.2, -144.0, 132.1], [-144.0, 7922.7, 192.1], [132.1, 192.1, 4586.2]])


def test_inertia_methods_are_exact_on_exact_rates() -> None:
    """Slews about one axis at a time give paper 000 eq. 8's tensor back, both ways."""
    profile = np.sin(np.linspace(0.0, np.pi, 50))
    rate = np.concatenate([np.outer(profile, axis) for axis in 1e-3 * np.eye(3)])
    exchanged = exchanged_by(TENSOR, rate)
    expected = [8655.2, 7922.7, 4586.2, -144.0, 132.1, 192.1]
    assert axis_by_axis(rate, exchanged)[0] == pytest.approx(expected, rel=1e-9)
    assert all_axes(rate, exchanged)[0] == pytest.approx(expected, rel=1e-9)


def test_one_slew_leaves_elements_undetermined() -> None:
    """A slew about X alone: eq. 7 gives the first column, eqs. 10-11 have no answer."""
    rate = np.outer(np.sin(np.linspace(0.0, np.pi, 50)), [1e-3, 0.0, 0.0])
    exchanged = exchanged_by(TENSOR, rate)
    found = axis_by_axis(rate, exchanged)[0]
    assert found[[0, 3, 4]] == pytest.approx([8655.2, -144.0, 132.1], rel=1e-9)
    assert np.isnan(found[[1, 2, 5]]).all()
    assert np.isnan(all_axes(rate, exchanged)).all()


def test_simulated_slews_give_the_true_moments_within_the_bars() -> None:
    """Moments within three bars of the truth; bars are hand-picked, wheel inertia drives them."""
    truth = json.loads((simulated() / "truth.json").read_text())["parameters"]
    table = inertia_methods(model("bias", "slews"))
    assert list(dict.fromkeys(table["event"])) == ["slews"]
    for _, row in table[table["element"].isin(["xx", "yy", "zz"])].iterrows():
        error = row["estimate_kg_m2"] - truth[f"inertia_{row['element']}_kg_m2"]
        assert abs(error) < 3 * row["bar_rss_kg_m2"]


def test_simulated_bias_needs_the_correction_and_short_on_times_are_not_valid() -> None:
    """Rectangular pulses overestimate by the tail-off; below 5 s of on-time nothing is valid."""
    table = thrust_methods(model("bias", "slews"))
    assert list(dict.fromkeys(table["event"])) == ["bias"]
    by_method = table.set_index(["method", "thruster"])["estimate_n"]
    raw, divided = by_method[MEAN + UNCORRECTED, "z1"], by_method[MEAN, "z1"]
    assert 1.1 < raw / divided < 1.5
    own = table[table["method"] == PER_EVENT]
    assert (own["valid"] == (own["on_time_s"] >= 5.0)).all()
    assert not own["valid"].all()


def test_torque_from_the_drift_of_the_wheels() -> None:
    """Paper 000 App. A: wheels that drift at a steady rate give T diag(I_w) times that rate back.

    The published totals (Table A1) in, the same out; drift rates in rpm are not printed.
    """
    joint = model("slews")
    published = 1e-6 * np.array([-0.53, -2.11, 1.83])
    (term,) = joint.telemetry
    physics = assumed_points(joint, joint.space.centre()).physics(())
    weights = term.balance.wheel_weights(physics)[0]
    drift = np.linalg.solve(weights, published)
    time = np.arange(0.0, 7200.0, 4.0)
    data = PlainRows(
        time, np.empty(0), np.empty(0), 50.0 + np.outer(time, drift), np.empty(0), np.empty(0)
    )
    found = drift_torque(term, physics, data)
    assert found[0] == pytest.approx(published, rel=1e-9)
