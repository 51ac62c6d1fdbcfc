"""The pieces of prediction against independent oracles: integration, scipy, plain algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from prediction_cases import SIZE, beliefs, flights, learned, model, physics
from scipy import stats
from scipy.optimize import linprog
from spacecraft_cases import TWELVE

from cassini_bayes.computing.arrays import Array, picked
from cassini_bayes.errors import InputError
from cassini_bayes.prediction.demand import pair_layout, pair_solver
from cassini_bayes.prediction.firing import (
    NAMES,
    Features,
    Observation,
    draw_firing,
    expected_minor,
    firing_space,
    log_likelihood,
    observe,
)
from cassini_bayes.prediction.ground_software import ideal_on_times, specific_impulse_s
from cassini_bayes.prediction.learning import joint_draws
from cassini_bayes.prediction.physics import arms_of, wheel_momentum
from cassini_bayes.prediction.predict import SOURCES, Prediction, predict
from cassini_bayes.prediction.regressions import conditional, regress
from cassini_bayes.prediction.requests import parse_bias, request_of
from cassini_bayes.prediction.scores import covered, crps, interval_score
from cassini_bayes.prediction.wheel_profile import (
    WheelManager,
    duration_s,
    rates_rpm,
    segments_rpm,
)
from cassini_bayes.spacecraft import load_spacecraft
from cassini_bayes.spacecraft.description import CONTROL_CYCLE_S
from cassini_bayes.spacecraft.pulses import effective_on_time

MANAGER = WheelManager({1: 0.562, 2: 0.5585, 4: 0.5585}, 16.5)


def sphere(rng: np.random.Generator, n: int) -> Array:
    """Random directions."""
    found = rng.standard_normal((n, 3))
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


# ---- wheel profile ------------------------------------------------------------------------------


@pytest.mark.parametrize("change", [1744.0, -1059.0, 10.0])
def test_the_profile_is_that_of_a_limited_loop(change: float) -> None:
    """Stepping ρ̇ = (ρ_f − ρ)/τ with the acceleration limited gives the closed form."""
    time = np.arange(0.0, duration_s(MANAGER, (1,), np.array([change])), 0.05)
    rate, found, limit = 0.0, [], 1.0 / MANAGER.ramp_s_per_rpm[1]
    for _ in time:
        found.append(rate)
        for _ in range(5):  # five Euler steps of 10 ms
            rate += 0.01 * min(max((change - rate) / MANAGER.loop_s, -limit), limit)
    closed = rates_rpm(MANAGER, (1,), np.zeros(1), np.array([change]), time)[:, 0]
    np.testing.assert_allclose(closed, found, atol=2e-4 * abs(change) + 1e-3)


def test_pieces_add_up_to_the_change_and_keep_their_direction() -> None:
    """However the wheels overlap, the pieces sum to the commanded change, none overshoots."""
    start, end = np.array([-1118.0, 1290.0, 330.0]), np.array([626.0, 1300.0, -729.0])
    pieces = segments_rpm(MANAGER, (1, 2, 4), start, end)
    np.testing.assert_allclose(pieces.sum(0), end - start, rtol=1e-12)
    assert (pieces * np.sign(end - start) >= 0.0).all()


def test_the_durations_of_the_tables_come_out() -> None:
    """Paper 001's eight durations within a percent or a few seconds, inertias as in the priors."""
    for event in flights()[0]:
        change = event.rwa_end_rpm - event.rwa_start_rpm
        found = duration_s(MANAGER, event.wheels, change)
        assert abs(found - event.duration_s) < max(0.011 * event.duration_s, 5.0)


# ---- pairs --------------------------------------------------------------------------------------


def test_one_sided_on_times_deliver_the_momentum() -> None:
    """Never negative, at most one pair per axis, torque times time equal to the impulse."""
    drawn, layout = physics(50), pair_layout(model().spacecraft, "B")
    solver = pair_solver(arms_of(model(), drawn), drawn.level_n, layout.pairs)
    impulse = 30.0 * sphere(np.random.default_rng(1), 50 * 40).reshape(50, 40, 3)
    found = solver.on_times(impulse)
    assert (found >= 0.0).all()
    assert (np.minimum(found[..., 0::2], found[..., 1::2]) == 0.0).all()
    np.testing.assert_allclose(np.einsum("nij,nsj->nsi", solver.torque, found), impulse, atol=1e-9)


def test_the_layout_is_that_of_paper_001() -> None:
    """X and Y share the Z thrusters in a ring, Y1–Y3 and Y2–Y4 are the couples."""
    layout, names = pair_layout(model().spacecraft, "B"), model().totals_rows.stack.thrusters
    assert [[names[k] for k in row] for row in layout.ring] == [["z4", "z3"], ["z1", "z2"]]
    units = ["-".join(names[k] for k in unit) for unit in layout.units]
    assert units == ["y1-y3", "y2-y4", "z1", "z2", "z3", "z4"]


def test_ideal_on_times_are_the_least_that_will_do() -> None:
    """The ring's two thrusters are the optimum of a linear programme (scipy), step by step."""
    layout = pair_layout(model().spacecraft, "B")
    arms = arms_of(model(), physics(1))[0]
    steps = sphere(np.random.default_rng(2), 25)
    found = ideal_on_times(steps, arms, layout)
    np.testing.assert_allclose(found @ arms.T, steps, atol=1e-9)
    columns = np.stack([arms[:, list(unit)].sum(1) for unit in layout.units], axis=1)
    first = [unit[0] for unit in layout.units]
    for step, own in zip(steps, found[:, first], strict=True):
        best = linprog(np.ones(6), A_eq=columns, b_eq=step, bounds=[(0, None)] * 6)
        assert own.sum() == pytest.approx(best.fun, rel=1e-6)


def test_specific_impulse_is_equation_19() -> None:
    """At no duty cycle P0 − P1 − P3, at a large one P0."""
    p = (180.0, 20.0, 50.0, 5.0, 500.0)
    np.testing.assert_allclose(
        specific_impulse_s(np.array([0.0, 0.02, 10.0]), p),
        [155.0, 180.0 - 20.0 * np.exp(-1.0) - 5.0 * np.exp(-10.0), 180.0],
    )


# ---- firing logic -------------------------------------------------------------------------------


def on_times_from(x: tuple[float, float], y: tuple[float, float], alone: float) -> Array:
    """Z1 … Z4, Y1 … Y4 of given +x, −x, +y, −y pairs, the busiest corner alone for a while."""
    z1, z2, z3, z4 = x[1] + y[0], x[1] + y[1], x[0] + y[1], x[0] + y[0]
    found = np.array([z1, z2, z3, z4, 0.5, 3.0, 0.5, 3.0])
    found[[3, 2, 0, 1][2 * (x[1] > x[0]) + (y[1] > y[0])]] += alone
    return found


@pytest.mark.parametrize("x", [(4.0, 0.6), (0.6, 4.0)])
@pytest.mark.parametrize("y", [(9.0, 0.3), (0.3, 9.0)])
@pytest.mark.parametrize("alone", [0.0, 1.25])
def test_lesser_sides_are_read_off_the_totals(
    x: tuple[float, float], y: tuple[float, float], alone: float
) -> None:
    """Whatever the signs of the demands, and with cycles of the shared thruster alone."""
    seen = observe(on_times_from(x, y, alone), pair_layout(model().spacecraft, "B"))
    assert seen.minor_ring_s == pytest.approx(0.9)
    assert seen.minor_couple_s == pytest.approx(0.5)
    assert seen.shared_cycles == round(alone / CONTROL_CYCLE_S)


def plain_features() -> Features:
    """One event, one draw."""
    return Features(*(np.array([v]) for v in (900.0, 0.3, 0.1, 12.0, 4.0, 3.0)))


def test_the_likelihood_is_gamma_and_negative_binomial() -> None:
    """Against scipy, event multiplier integrated by the trapezoid rule on a fine grid."""
    p = dict(zip(NAMES, (0.1, 4e-4, 0.03, 0.12, 0.4, 0.7, 0.5), strict=True))
    f, o = plain_features(), Observation(1.7, 0.6, 4)
    axis = 0.1 + 4e-4 * 900.0
    grid = np.linspace(-8.0, 8.0, 4001)
    g = np.exp(0.4 * grid - 0.08)
    density = stats.norm.pdf(grid)
    for own, reversal, minor in ((2 * axis + 0.36, 0.3, 1.7), (axis + 0.12, 0.1, 0.6)):
        mean = g * own + reversal
        variance = 0.12 * (g * own + min(reversal, 0.12))
        density = density * stats.gamma.pdf(minor, mean**2 / variance, scale=variance / mean)
    expected = np.log(np.trapezoid(density, grid))
    expected += stats.nbinom.logpmf(4, 0.5, 0.5 / (0.5 + 0.7 * 3.0))
    parameters = {name: np.array([value]) for name, value in p.items()}
    assert log_likelihood(parameters, [f], [o])[0] == pytest.approx(expected, abs=1e-3)


@pytest.mark.statistical
def test_draws_have_the_stated_means() -> None:
    """Five standard errors around reversal + expected opposing firing, and around c·min(U)."""
    n = 40_000
    f = Features(**{k: np.full(n, v[0]) for k, v in vars(plain_features()).items()})
    p = dict(zip(NAMES, (0.1, 4e-4, 0.03, 0.12, 0.4, 0.7, 0.5), strict=True))
    drawn = draw_firing(p, f, np.random.default_rng(3), CONTROL_CYCLE_S)
    ring, couple = expected_minor(p, f)
    for values, mean in (
        (drawn.minor_ring_s, ring[0] + 0.3),
        (drawn.minor_couple_s, couple[0] + 0.1),
        (drawn.shared_s, CONTROL_CYCLE_S * 2.1),
    ):
        assert abs(values.mean() - mean) < 5.0 * values.std() / np.sqrt(n)


def test_the_posterior_of_the_firing_logic_is_that_of_a_brute_force_chain() -> None:
    """Means of the joint draws agree with importance sampling from the prior, physics typical."""
    events, _ = flights()
    from cassini_bayes.prediction.learning import training_features
    from cassini_bayes.prediction.wheel_profile import WheelManager as Manager

    manager = Manager(dict(MANAGER.ramp_s_per_rpm), MANAGER.loop_s)
    layout = pair_layout(model().spacecraft, "B")
    mean = picked(physics().at_mean(), np.zeros(1, dtype=np.int64))
    features = training_features(model(), events, mean, manager, 7.66)
    seen = [observe(event.on_time_s, layout) for event in events]
    space = firing_space(beliefs())
    z = np.random.default_rng(8).standard_normal((60_000, len(NAMES)))
    parameters = space.to_parameters(z)
    log_weight = log_likelihood(parameters, features, seen)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    assert 1.0 / (weight**2).sum() > 300
    for name in ("minor_per_duration", "minor_per_demand", "event_spread"):
        draws = np.asarray(parameters[name])
        centre = float(weight @ draws)
        spread = float(np.sqrt(weight @ (draws - centre) ** 2))
        assert abs(np.mean(learned().firing[name]) - centre) < 0.3 * spread


@pytest.mark.statistical
def test_the_firing_logic_is_calibrated_on_its_own_events() -> None:
    """Parameters from the prior, eight events flown by the model, ranks of the truth uniform.

    Holm over seven parameters at 1 %; a posterior learned from other events' figures fails.
    """
    space, rng = firing_space(beliefs()), np.random.default_rng(10)
    base = [
        Features(*(np.full(1, v) for v in values))
        for values in rng.uniform(
            (200.0, 0.0, 0.0, 2.0, 0.5, 0.5), (1400.0, 0.6, 0.5, 22.0, 20.0, 5.0), (8, 6)
        )
    ]
    ranks, wrong = [], []
    for _ in range(60):
        z = rng.standard_normal((1, space.dimension))
        truth = space.to_parameters(z)
        seen = []
        for f in base:
            drawn = draw_firing(truth, f, rng, CONTROL_CYCLE_S)
            seen.append(
                Observation(
                    max(float(drawn.minor_ring_s[0]), 1e-3),
                    max(float(drawn.minor_couple_s[0]), 1e-3),
                    round(float(drawn.shared_s[0]) / CONTROL_CYCLE_S),
                )
            )
        found, _, effective = joint_draws(base, seen, beliefs(), rng, 1, 200, pairings=4_000)
        assert effective > 100
        own = np.array([float(np.asarray(truth[name])[0]) for name in NAMES])
        drawn_z = np.array([np.asarray(found[name]) for name in NAMES])
        ranks.append((drawn_z < own[:, None]).mean(1))
        wrong.append((drawn_z < 1.5 * own[:, None]).mean(1))
    p_values = [stats.kstest(column, "uniform").pvalue for column in np.array(ranks).T]
    assert min(p_values) * len(p_values) > 0.01
    biased = [stats.kstest(column, "uniform").pvalue for column in np.array(wrong).T]
    assert min(biased) * len(biased) < 0.01


# ---- regressions --------------------------------------------------------------------------------


@pytest.mark.statistical
def test_regressions_draw_from_the_conjugate_posterior() -> None:
    """Mean and covariance of the draws are those of Bayes' rule, to Monte Carlo error."""
    rng = np.random.default_rng(5)
    x, y = rng.standard_normal((6, 2)), rng.standard_normal(6)
    variance, m0, s0 = np.linspace(0.5, 1.5, 6), np.array([0.3, -0.2]), np.array([0.5, 2.0])
    mean, factor = conditional(x, y, variance, m0, s0, 1.0)
    covariance = np.linalg.inv(x.T @ (x / variance[:, None]) + np.diag(s0**-2))
    expected = covariance @ (x.T @ (y / variance) + m0 / s0**2)
    np.testing.assert_allclose(mean, expected, rtol=1e-9)
    inverse = np.linalg.inv(factor)
    np.testing.assert_allclose(np.outer(s0, s0) * (inverse.T @ inverse), covariance, rtol=1e-9)
    # draws, whitened by the conditional at their own noise scales, are standard normals
    found = regress(x, y, variance, list(zip(m0, s0, strict=True)), rng, size=40_000)
    means, factors = conditional(
        np.broadcast_to(x, (40_000, *x.shape)), y, variance, m0, s0, found.scale_square
    )
    departure = ((found.coefficients - means) / s0)[..., None]
    white = (np.swapaxes(factors, -1, -2) @ departure)[..., 0]
    np.testing.assert_allclose(white.mean(0), 0.0, atol=5 * np.sqrt(1 / 40_000))
    np.testing.assert_allclose(np.cov(white.T), np.eye(2), atol=0.04)


def test_the_noise_scale_follows_the_residuals() -> None:
    """Ten times larger residuals give about ten times the scale; without data, the prior's."""
    rng = np.random.default_rng(6)
    x, noise = np.ones((40, 1)), rng.standard_normal(40)
    scales = [
        np.sqrt(
            np.median(
                regress(
                    x,
                    factor * noise,
                    np.ones(40),
                    [(0.0, 1.0)],
                    rng,
                    size=400,
                ).scale_square
            )
        )
        for factor in (1.0, 10.0)
    ]
    assert 7.0 < scales[1] / scales[0] < 11.0


# ---- prediction ---------------------------------------------------------------------------------


def one(hold: frozenset[str] = frozenset(), seed: int = 7, text: str | None = None) -> Prediction:
    """A prediction of the first flight event, or of a line."""
    request = request_of(flights()[0][0])
    if text is not None:
        request = parse_bias(text, model().spacecraft)
    return predict(learned(), request, np.random.default_rng(seed), hold)  # type: ignore[arg-type]


def test_predicted_on_times_balance_the_momentum() -> None:
    """With the ends quiet, Σ q F s is the wheels' change plus the external torque, draw by draw.

    On-times are chosen with the mean pulse rate, so delivered impulse is compared at that rate.
    """
    event, drawn = flights()[0][0], learned().physics
    quiet = one(frozenset({"rates at the ends", "thrust of the event"}))
    rate = learned().pulses.coefficients[:, 0]
    times = (np.asarray(drawn.parameters[n]) for n in ("tau_delay_s", "tau_rise_s", "tau_fall_s"))
    pulses = quiet.on_time_s * rate[:, None]
    effective = effective_on_time(
        model().totals_rows.pulse_shape,
        quiet.on_time_s,
        pulses,
        *(np.atleast_1d(t)[:, None] for t in times),
    )
    trend = learned().thrust_trend
    moved = float((trend.at(event.epoch) - trend.centre).mean())
    force = (drawn.level_n + moved) * effective
    impulse = (arms_of(model(), drawn) @ force[..., None])[..., 0]
    change = (event.rwa_end_rpm - event.rwa_start_rpm)[None]
    wanted = wheel_momentum(model(), drawn, event.wheels, change)[:, 0]
    np.testing.assert_allclose(impulse, wanted, atol=1e-6)


def test_the_same_seed_gives_the_same_draws_and_another_does_not() -> None:
    """Repeatable, and not constant."""
    np.testing.assert_array_equal(one().on_time_s, one().on_time_s)
    assert not np.array_equal(one().on_time_s, one(seed=8).on_time_s)


def test_couples_fire_together_and_counts_are_whole() -> None:
    """Y1 = Y3, Y2 = Y4; pulses are integers, none without on-time, nothing is negative."""
    p = one()
    np.testing.assert_allclose(p.on_time_s[:, 4], p.on_time_s[:, 6])
    np.testing.assert_array_equal(p.pulses[:, 5], p.pulses[:, 7])
    np.testing.assert_array_equal(p.pulses, np.rint(p.pulses))
    assert (p.on_time_s >= 0).all()
    assert (p.pulses[p.on_time_s > 0] >= 1).all()


def test_holding_a_source_takes_spread_away() -> None:
    """All sources held leave little; each alone never adds much."""

    def spread(p: Prediction) -> float:
        assert p.delta_v_computed_m_s is not None
        return float(np.subtract(*np.quantile(p.delta_v_computed_m_s[:, 2], [0.84, 0.16])))

    full = spread(one())
    for source in SOURCES:
        assert spread(one(frozenset({source}))) < 1.1 * full
    assert spread(one(frozenset(SOURCES))) < 0.2 * full


def test_printed_delta_v_scatters_across_and_along_the_thrust_independently() -> None:
    """With only the on-board ΔV drawn, its components go their own ways: no correlation in 400."""
    (others,) = (frozenset(SOURCES) - {source} for source in SOURCES if source == "on-board ΔV")
    drawn = one(others).delta_v_computed_m_s
    assert drawn is not None
    correlation = np.corrcoef(drawn.T)
    assert np.abs(correlation[~np.eye(3, dtype=bool)]).max() < 4.0 / np.sqrt(SIZE)


def test_a_larger_bias_takes_more_of_everything() -> None:
    """Twice the wheel change: more on-time, hydrazine, ΔV and duration."""
    small = one(text="rwa1: -600 -> 0")
    large = one(text="rwa1: -600 -> 600")
    for name in ("on_time_s", "hydrazine_g", "duration_s"):
        assert getattr(large, name).mean() > 1.5 * getattr(small, name).mean()


def test_predictions_extrapolate_the_printed_thrust() -> None:
    """A year after the last event the printed thrust's trend asks for more on-time."""
    now = request_of(flights()[0][5])
    assert now.epoch is not None
    later = replace(now, epoch=now.epoch.replace(year=now.epoch.year + 1))
    first, second = (
        predict(learned(), r, np.random.default_rng(1)).on_time_s.sum(1).mean()
        for r in (now, later)
    )
    assert 1.02 < second / first < 1.12


def test_another_layout_of_thrusters_is_refused() -> None:
    """The made-up spacecraft has the layout too; with pairs that do not form a ring it has not."""
    craft = load_spacecraft(TWELVE)
    assert pair_layout(craft, craft.branches[0]).ring.shape == (2, 2)
    other = replace(craft, axis_pairs={**craft.axis_pairs, "+y": ("p1", "p2")})
    with pytest.raises(InputError, match="layout"):
        pair_layout(other, craft.branches[0])


# ---- scores and frames --------------------------------------------------------------------------


def test_crps_is_the_integral_of_the_squared_difference_of_distributions() -> None:
    """Numerical ∫ (F − H)² of a normal against the draws' score; exact for two draws."""
    rng = np.random.default_rng(9)
    draws = rng.standard_normal(20_000)
    grid = np.linspace(-8, 8, 8001)
    wanted = np.trapezoid((stats.norm.cdf(grid) - (grid >= 0.7)) ** 2, grid)
    assert crps(draws, 0.7) == pytest.approx(wanted, abs=0.01)
    assert crps(np.array([0.0, 2.0]), 1.0) == pytest.approx(1.0 - 1.0)


def test_interval_score_and_coverage() -> None:
    """Width inside; twenty times the distance more outside a 90 % interval."""
    draws = np.linspace(0.0, 1.0, 100_001)
    assert interval_score(draws, 0.5) == pytest.approx(0.9, abs=1e-4)
    assert interval_score(draws, 1.05) == pytest.approx(0.9 + 20 * 0.1, abs=1e-3)
    assert covered(draws, 0.06)
    assert not covered(draws, 0.04)


def test_learning_keeps_every_draw() -> None:
    """As many as the fit had."""
    assert learned().size == SIZE


def test_cycles_are_those_of_the_spacecraft() -> None:
    """Twice the period of the controller: half as many cycles of it, each twice as long."""
    layout = pair_layout(replace(model().spacecraft, control_cycle_s=2 * CONTROL_CYCLE_S), "B")
    assert layout.cycle_s == 2 * CONTROL_CYCLE_S
    seen = observe(on_times_from((4.0, 0.6), (9.0, 0.3), 20 * CONTROL_CYCLE_S), layout)
    assert seen.shared_cycles == 10
    p = dict(zip(NAMES, (0.1, 4e-4, 0.03, 0.12, 0.4, 0.7, 0.5), strict=True))
    one, two = (
        draw_firing(p, plain_features(), np.random.default_rng(3), cycle_s).shared_s
        for cycle_s in (CONTROL_CYCLE_S, layout.cycle_s)
    )
    assert two == 2 * one
