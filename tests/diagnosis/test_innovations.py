"""What a diagnosis shows: exact bands, whiteness, discrepancy curves, and the extended fit."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from event_cases import at_rest
from scipy.stats import kstest
from telemetry_cases import event_of, made_up_samples, telemetry_priors

from cassini_bayes.balance.linearised import fitted_away
from cassini_bayes.diagnosis import correlations
from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.correlations import (
    InnovationTests,
    family_band,
    innovation_tests,
    running_mean,
)
from cassini_bayes.diagnosis.discrepancy import Curve, curves_of
from cassini_bayes.diagnosis.hypotheses import (
    Hypothesis,
    compact,
    extend,
    none_hypothesis,
    thrust_factors,
)
from cassini_bayes.diagnosis.innovations import (
    SMOOTHED_ROWS,
    effect_momentum,
    innovations,
    linearise,
    smoothed,
    thrust_columns,
)
from cassini_bayes.diagnosis.modes import highest_mode
from cassini_bayes.diagnosis.nuisances import traded
from cassini_bayes.diagnosis.overlay import cause_part, fit_percent, overlays
from cassini_bayes.diagnosis.refit import fit_extended
from cassini_bayes.diagnosis.symptoms import find_symptoms
from cassini_bayes.diagnosis.verdict import Verdict, weigh
from cassini_bayes.effects.effect import Remainder
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.results.record import read_fit
from cassini_bayes.sampling.ensembles import SamplerSettings
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.blind.flights import reduced
from cassini_bayes.studies.scenario import Simulation, simulate_file

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
LEAK_N = 1.0e-4
LAGGED = range(1, 6)


@cache
def flight(leak: bool) -> Simulation:
    """A bias and slews, Z3 leaking or nothing hidden."""
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    document["event"] = [e for e in document["event"] if e["id"] in ("bias-1", "slews")]
    hidden = {"name": "thruster_leak:z3", "parameters": {"leak_n": LEAK_N}}
    document["effect"] = [hidden] if leak else []
    return simulate_file(scenario_of(document, SCENARIO.parent), 7, priors=PRIORS)


@cache
def case_of(leak: bool) -> BalanceCase:
    """The events of a flight with that one cause."""
    events = reduced(flight(leak), PRIORS)
    only = (events.catalogue.effect("thruster_leak:z3"),)
    return BalanceCase(replace(events, catalogue=replace(events.catalogue, effects=only)))


@cache
def verdict(leak: bool) -> Verdict[Hypothesis]:
    """The verdict on a flight."""
    return weigh(case_of(leak), np.random.default_rng(1), pairs=False)


def left_by(own: Verdict[Hypothesis]) -> Remainder:
    """What the baseline leaves."""
    assert own.none.remainder is not None
    return own.none.remainder


def shown(own: Verdict[Hypothesis]) -> InnovationTests:
    """Tests of the baseline's innovations."""
    left = left_by(own)
    return innovation_tests(left.linear, left.rows, np.random.default_rng(2))


def curves(leak: bool) -> dict[str, Curve]:
    """Discrepancy curves by event."""
    found = curves_of(case_of(leak).events, verdict(leak).unknown, np.random.default_rng(3))
    return {curve.event: curve for curve in found}


def test_a_rows_own_noise_is_in_none_of_its_running_means() -> None:
    """Of a row that is moved only its neighbours' means move, by a thirtieth of it."""
    event = event_of(made_up_samples(np.random.default_rng(3), 160), telemetry_priors())
    rows, layout = event.usable_rows, event.statistics.layout
    places = range(layout.rate.start, layout.wheel.stop)
    columns = [p - len(layout.vector) for p in places if p != layout.one]
    scalar = rows.scalar.copy()
    scalar[60, columns] += 1.0
    moved = smoothed(replace(rows, scalar=scalar), layout).scalar - smoothed(rows, layout).scalar
    wanted = np.zeros(len(scalar))
    wanted[45:76] = 1.0 / (SMOOTHED_ROWS - 1)
    wanted[60] = 0.0
    for column in columns:
        assert moved[:, column] == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_innovations_of_a_body_at_rest_do_not_go_with_its_rates(seed: int) -> None:
    """An hour at 1 Hz, all as modelled: z of the rate about an axis is within its family band.

    With the row itself in the running mean, whose noise is in its innovation, it is 5 to 10.
    """
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    document["event"] = [at_rest(3600.0)]
    quiet = simulate_file(scenario_of(document, SCENARIO.parent), seed, priors=PRIORS)
    none = compact(none_hypothesis(reduced(quiet, PRIORS)))
    mode = highest_mode(none.log_density, none.model.starts)
    left = innovations(none, mode.point)

    def farthest() -> float:
        """Largest |z| of a rate about the axis of an innovation, over the band."""
        found = innovation_tests(left.linear, left.rows, np.random.default_rng(2))
        own = [t.z for t in found.drivers if t.driver == f"rate about {t.axis.upper()}"]
        return float(np.nanmax(np.abs(own)) / found.family_z)

    assert farthest() < 1.0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(correlations, "mean_of_others", running_mean)
        assert farthest() > 1.5


def test_a_common_thrust_that_is_walked_moves_all_thrusts() -> None:
    """A normal prior with a bound is walked: its column is that of all thrusters, times its sd.

    It had been nothing, as if the mean of what is walked were what is expected.
    """
    normal = PRIORS.parameters["thrust_common_n"].distribution
    assert normal is not None
    bounded = replace(normal, low=0.0)
    walked = none_hypothesis(
        reduced(flight(leak=False), PRIORS.with_distribution("thrust_common_n", bounded))
    )
    d = walked.dimension
    at = walked.model.space.names.index("thrust_common_n")
    linear, (factor, *_) = linearise(walked, np.zeros(d))
    first = linear.columns.parts[0]
    column = first.values[:, list(first.places).index(at)]
    levels = thrust_columns(walked, np.zeros(d), 0).sum(axis=2)
    wanted = bounded.sd() * (levels @ np.linalg.inv(factor).T).reshape(-1)
    assert column == pytest.approx(wanted, rel=1e-3, abs=1e-3 * np.abs(wanted).max())


@cache
def beside_a_weak_thruster(second: str) -> tuple[Hypothesis, Hypothesis, np.ndarray]:
    """Z3 with its factor at the middle of its prior, that with a second effect; the point (d,)."""
    catalogue = reduced(flight(leak=False), PRIORS).catalogue
    events = case_of(leak=False).events
    base = extend(none_hypothesis(events), [catalogue.effect("thruster_degraded:z3")])
    return base, extend(base, [catalogue.effect(second)]), np.zeros(base.dimension)


@pytest.mark.parametrize("second", ["center_of_mass:y", "inertia:xx"])
def test_a_second_effect_of_no_size_adds_nothing_beside_a_thrust_factor(second: str) -> None:
    """All that differs is the size, and that is nothing.

    Control: against full thrust, as it had been counted, such columns hold what the first cause
    takes off: 0.95 N m s.
    """
    base, both, z = beside_a_weak_thruster(second)
    for added in effect_momentum(base, z, [(both, np.zeros((1, 1)))]):
        assert not added.any()
    located = base.model.points(z[None])
    term = base.model.telemetry[0]
    lost = located.mean_levels_n[0] * (thrust_factors(term, located)[0] - 1.0)
    assert np.abs(thrust_columns(base, z, 0) @ lost).max() > 0.9


@pytest.mark.parametrize("second", ["thruster_leak:y1", "pulse_shape", "thruster_degraded:z4"])
def test_what_a_second_effect_adds_is_the_difference_of_two_models(second: str) -> None:
    """Beside a thrust factor, against the rows of both models about the same point."""
    base, both, z = beside_a_weak_thruster(second)
    added = effect_momentum(base, z, [(both, np.ones((1, 1)))])
    shown = []
    for hypothesis, point in ((base, z), (both, np.r_[z, 1.0])):
        linear, factors = linearise(hypothesis, point)
        rows = zip(linear.parts, factors, strict=True)
        shown.append([linear.target[own].reshape(-1, 3) @ factor.T for own, factor in rows])
    for own, without, with_it in zip(added, *shown, strict=True):
        assert own[:, :, 0] == pytest.approx(without - with_it, abs=1e-9 * np.abs(without).max())
    assert np.abs(added[0]).max() > 0.01


def test_correlations_are_standard_normal_if_the_model_is_true() -> None:
    """Targets drawn from the linear model itself give uniform p-values for one driver."""
    own = left_by(verdict(False))
    rng, z, largest = np.random.default_rng(4), [], []
    linear = own.linear
    for _ in range(20):
        sd = 1.0 / np.sqrt(linear.precision)
        target = linear.columns @ (sd * rng.standard_normal(len(sd)))
        target += rng.standard_normal(len(target))
        left = fitted_away(linear, target)
        rows = []
        for event, part in zip(own.rows, linear.parts, strict=True):
            white = left[part].reshape(-1, 3)
            rows.append(replace(event, white=white, residual_n_m_s=white @ event.noise_factor.T))
        found = innovation_tests(replace(linear, target=target), rows, rng)
        values = [t.z for t in found.drivers]
        z.append(values[found.drivers.index(next(t for t in found.drivers if t.driver == "time"))])
        largest.append(np.nanmax(np.abs(values)) < found.family_z)
    assert kstest(z, "norm").pvalue > 1e-3
    assert np.mean(largest) > 0.75  # 95 % less four standard deviations of 20 trials


def test_family_band_of_independent_and_equal_tests() -> None:
    """Ten independent tests need the Šidák half-width, ten equal ones that of one alone."""
    rng = np.random.default_rng(5)
    assert family_band(np.eye(10), rng) == pytest.approx(2.80, abs=0.08)
    assert family_band(np.ones((10, 10)), rng) == pytest.approx(1.96, abs=0.08)


def test_wheels_are_named_by_number_and_a_leak_is_seen() -> None:
    """Drivers name rwa4, not a third wheel; the leak leaves its mark in bands and sentences."""
    found = shown(verdict(True))
    drivers = {t.driver for t in found.drivers}
    assert {"speed of wheel 4", "acceleration of wheel 4", "on-time of Z3", "time"} <= drivers
    assert not any("rwa3" in name for name in drivers)
    assert max(abs(t.z) for t in found.drivers if np.isfinite(t.z)) > found.family_z
    assert any("not white" in s.what for s in find_symptoms(left_by(verdict(True)).rows, found))


def test_autocorrelations_get_back_what_fitting_takes_out() -> None:
    """Against the covariance of all unknowns, written out: X (XᵀX + P)⁻¹ Xᵀ at every lag."""
    left = left_by(verdict(False))
    linear, found = left.linear, iter(shown(verdict(False)).whiteness)
    covariance = np.linalg.inv(linear.gram())
    every = linear.columns.written_out()
    for event, part in zip(left.rows, linear.parts, strict=True):
        n = len(event.time_s)
        columns = every[part].reshape(n, 3, -1)
        in_axes = np.einsum("ab,nbp->anp", event.noise_factor, columns)
        for residual, own in zip(event.residual_n_m_s.T, in_axes, strict=True):
            taken = own @ covariance
            lags = range(len(LAGGED) + 1)
            sums = [residual[k:] @ residual[: n - k] for k in lags]
            sums = [s + (taken[k:] * own[: n - k]).sum() for k, s in zip(lags, sums, strict=True)]
            assert next(found).value[: len(LAGGED)] == pytest.approx(
                np.array(sums[1:]) / sums[0], rel=1e-4, abs=1e-6
            )


def test_nothing_hidden_stays_in_the_bands() -> None:
    """Without an effect innovations are in the bands and the curve's band holds zero."""
    found = shown(verdict(False))
    assert np.nanmax([abs(t.z) for t in found.drivers]) < 1.3 * found.family_z
    assert all(abs(w.portmanteau_z) < 4.0 for w in found.whiteness)
    assert all(abs(t.z) < 4.0 for t in found.closure)
    for curve in curves(False).values():
        assert ((curve.low <= 0.0) & (curve.high >= 0.0)).mean() > 0.95


def test_curve_grows_by_the_momentum_of_the_leak() -> None:
    """In the slews g(T) is (r − e) × d F T about X and Y, and nothing about Z."""
    curve = curves(True)["slews"]
    arm = np.cross([-1.234, -1.580, 0.0], [0.0, 0.0, -1.0]) - np.cross(
        [0.13, 0.057, 0.0], [0.0, 0.0, -1.0]
    )
    truth = arm * LEAK_N * curve.time_s[-1]
    half = 0.5 * (curve.high[-1] - curve.low[-1])
    assert np.abs(curve.mean[-1] - truth)[:2] == pytest.approx(0.0, abs=0.1 * np.abs(truth).max())
    assert (np.abs(curve.mean[-1] - truth) < 3.0 * half).all()
    assert curve.low[-1, 0] > 0.0 > curve.high[-1, 1]
    assert abs(curve.mean[-1, 2]) < 0.1 * np.abs(truth).max()


def test_extended_fit_is_read_back(tmp_path: Path) -> None:
    """``fit.nc`` has the §3 groups, and the leak as a posterior variable with its unit."""
    own = verdict(True)
    leak = next(w for w in own.weighed if w.name == "thruster_leak:z3")
    short = SamplerSettings(ensembles=2, first_check=100, max_steps=100, target_ess=100)
    fit_extended(leak, tmp_path / "fit", 1, lambda _: None, short)
    fit = read_fit(tmp_path / "fit" / "fit.nc")
    found = fit.groups["posterior"]["thruster_leak_z3_leak_n"]
    assert found.attrs["units"] == "N"
    # three posterior standard deviations
    assert float(found.mean()) == pytest.approx(LEAK_N, abs=3.0 * float(found.std()))
    channels = fit.groups["posterior_predictive"]["rate_rad_s"].sel(event="slews")
    assert np.isfinite(channels.values).all(axis=(0, 2)).sum() > 100
    assert "thruster_leak_z3_leak_n" in fit.groups["prior"]
    assert {"thrust_n", "inertia_xx_kg_m2"} <= set(fit.groups["posterior"])


def test_the_part_of_a_cause_is_what_its_torque_adds_up_to() -> None:
    """A leak at a lever arm turns the body by leak × arm × time: by hand, from the geometry."""
    extended = case_of(True).examined(verdict(True).best)
    bias = extended.remainder.rows[0]  # type: ignore[union-attr]
    part = cause_part(case_of(True).events, extended)[0]
    (leak,) = case_of(True).sizes(extended, np.random.default_rng(1)).values()
    value = PRIORS.means()
    place = np.array([-value["thruster_lx_m"], -value["thruster_ly_m"], value["thruster_lzz_m"]])
    centre = np.array([value[f"cm_{axis}_m"] for axis in "xyz"])
    torque = leak.mean * np.cross(place - centre, [0.0, 0.0, -1.0])
    slope = np.polyfit(bias.time_s, part, 1)[0]
    assert slope == pytest.approx(torque, rel=0.03, abs=0.02 * np.abs(torque).max())


def test_rates_and_wheels_laid_over_differ_by_the_same_momentum() -> None:
    """J Δω is A I Δρ in every row: both channels are the one balance, seen from either side."""
    none = verdict(True).none
    (bias, _) = overlays(case_of(True).events, none, None)
    change = {c.name: c.measured - c.baseline for c in bias.channels}
    assert all(c.extended is None and c.fit[1] is None for c in bias.channels)
    residual = none.remainder.rows[0].residual_n_m_s  # type: ignore[union-attr]
    value = PRIORS.means()
    moments = np.array([value[f"inertia_{axis * 2}_kg_m2"] for axis in "xyz"])
    turned = np.stack([change[f"rate {axis}"] for axis in "XYZ"], axis=1) / 1e3 * moments
    # products of inertia are a few per cent of the moments, which are known to some per cent
    assert (turned - residual).std() < 0.2 * residual.std()
    spun = np.stack([change[f"wheel {n}"] for n in (1, 2, 4)], axis=1) * 2.0 * np.pi / 60.0
    assert spun.std() * value["rwa1_inertia_kg_m2"] == pytest.approx(residual.std(), rel=0.3)


def test_the_fit_is_100_for_the_data_and_0_for_their_mean() -> None:
    """The ends of the scale, and a known case between: half the amplitude is 50 per cent."""
    wave = np.sin(np.linspace(0.0, 20.0 * np.pi, 1000))
    assert fit_percent(wave, wave) == 100.0
    assert fit_percent(wave, np.full(1000, wave.mean())) == pytest.approx(0.0)
    assert fit_percent(wave, 0.5 * (wave - wave.mean()) + wave.mean()) == pytest.approx(50.0)
    assert np.isnan(fit_percent(np.ones(5), np.zeros(5)))


def test_a_size_is_traded_against_something_that_is_free() -> None:
    """Draws of the normal approximation have the size's mean and width, priors are as stated."""
    extended = case_of(True).examined(verdict(True).best)
    trade = traded(extended, np.random.default_rng(2))
    assert trade is not None
    (leak,) = case_of(True).sizes(extended, np.random.default_rng(1)).values()
    assert trade.posterior[:, 0].mean() == pytest.approx(leak.mean, abs=leak.sd)
    assert trade.posterior[:, 0].std() == pytest.approx(leak.sd, rel=0.3)
    found = float(np.corrcoef(trade.posterior.T)[0, 1])
    assert trade.correlation == pytest.approx(found)
    # half a normal of 30 µN about zero has a mean of 24 µN
    assert trade.prior[:, 0].mean() == pytest.approx(3e-5 * np.sqrt(2.0 / np.pi), rel=0.06)
