"""Rows whose pulses are late: what is late, blocks of rows, and the slope at the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from telemetry_cases import made_up_samples, telemetry_priors

import cassini_bayes.balance.flat_motion
import cassini_bayes.balance.statistics.preparation
import cassini_bayes.model.posterior
import cassini_bayes.model.telemetry
from cassini_bayes.balance.flat_motion import in_thrust_units, pushed_information
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.statistics import Samples, layout_of, reduce_chunks
from cassini_bayes.balance.statistics.columns import effective_increments
from cassini_bayes.balance.statistics.counters import delivered_pulses, firings
from cassini_bayes.balance.statistics.late import body_share, late_pulses
from cassini_bayes.balance.statistics.pairs import close_pairs
from cassini_bayes.balance.statistics.preparation import prepare
from cassini_bayes.balance.statistics.rows import rows_at_readings
from cassini_bayes.balance.telemetry_balance import TelemetryBalance
from cassini_bayes.balance.telemetry_noise import open_scales
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.events import prepare as prepare_diagnosis
from cassini_bayes.diagnosis.hypotheses import none_hypothesis, unknown_hypothesis
from cassini_bayes.diagnosis.modes import find_mode
from cassini_bayes.effects.catalogue import named_effects
from cassini_bayes.errors import InputError
from cassini_bayes.model import build_model
from cassini_bayes.model.draws import draw
from cassini_bayes.model.event_reduction import sampling_of
from cassini_bayes.model.posterior import Model, log_posterior
from cassini_bayes.model.terms import Points
from cassini_bayes.simulation import SimulatedEvent
from cassini_bayes.spacecraft.parameters import LATE_FACTOR
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES
from cassini_bayes.studies.blind.flights import Blind
from cassini_bayes.studies.blind.strata import OVER_CONDITIONS
from cassini_bayes.studies.conditions import Condition, beliefs_under, scenario_under
from cassini_bayes.studies.scenario import simulate_file
from cassini_bayes.studies.telemetry_calibration import flat_truth, reduced_simulation

SHAPE = PULSE_SHAPES["first_order"]
WITH_THRUSTS = cassini_bayes.model.posterior._with_thrusts
TAU_S = (0.005, 0.02, 0.05)
ROOT = Path(__file__).parents[2]
INERTIAS = ("inertia_xx_kg_m2", "inertia_yy_kg_m2", "inertia_zz_kg_m2")


@pytest.mark.parametrize(
    ("rise", "fall", "offset"),
    [
        (0.02, 0.05, 0.0),
        (0.015, 0.09, 0.0),
        (0.025, 0.02, 0.0),
        (0.02, 0.15, 0.0),
        (0.02, 0.25, 0.0),
        (0.02, 0.02, 0.06),
        (0.02, 0.09, 0.08),
    ],
)
def test_what_is_late_is_that_of_pulses_at_any_time(
    rise: float, fall: float, offset: float
) -> None:
    """Moments of pulses begun at random, each credit and impulse worked out by itself.

    Tails of several times the reference, too: taken as tails of 0.1 s they would have a tenth of
    the variance at 0.25 s. And pulses that go on for longer than counters say.
    """
    rng, width, rate, past = np.random.default_rng(3), 0.125, 0.4, 2.4
    ages = rng.uniform(0.0, past, 4_000)  # of the last pulse; later than that nothing is late
    tau = (TAU_S[0], rise, fall)
    longer = width + offset
    whole = float(SHAPE.effective_time(longer, *tau))
    curve = np.linspace(0.0, past, 48_001)
    thrust = SHAPE.thrust_fraction(curve, longer, *tau)
    delivered = np.r_[0.0, np.cumsum(0.5 * (thrust[1:] + thrust[:-1]) * np.diff(curve))]
    late = np.minimum(ages, width) + whole - width - np.interp(ages, curve, delivered)
    some = rng.random(len(ages)) < rate * past
    found = late_pulses(SHAPE, TAU_S, width, np.array([rate, 0.0]))
    variance = found.variance_s2(np.array([rise]), np.array([fall]), np.array([offset]))[0]
    values = np.where(some, late, 0.0)
    error = np.sqrt(2.0 * (values**4).mean() / len(values))
    assert variance[0] == pytest.approx(values.var(), abs=4.0 * error)
    assert variance[1] == 0.0
    # a pulse of long ago has delivered all that it was credited with
    impulse = quad(lambda t: float(SHAPE.thrust_fraction(t, longer, *tau)), 0.0, past, limit=400)[0]
    assert whole == pytest.approx(impulse, rel=3e-4)


def test_a_valve_without_delays_is_never_late() -> None:
    """Thrust that follows its command leaves nothing."""
    found = late_pulses(PULSE_SHAPES["rectangular"], TAU_S, 0.125, np.array([1.0]))
    assert found.variance_s2(np.array([0.02]), np.array([0.05]))[0, 0] < 1e-6
    assert body_share(PULSE_SHAPES["rectangular"], TAU_S, 0.125, 0.125, 0.125) == 0.0


@pytest.mark.parametrize("tau", [(0.0, 0.0, 0.05), (0.0, 0.03, 0.0), (0.0, 0.0, 0.0)])
def test_a_time_constant_fixed_at_zero_is_near_a_short_one(tau: tuple[float, ...]) -> None:
    """A thrust that rises, or falls, at once: what is late is as with a hundredth of a millisecond.

    It has no other values, so that its own is not looked at.
    """
    rate = np.array([0.4])
    found, near = (
        late_pulses(SHAPE, (own[0], own[1], own[2]), 0.125, rate)
        for own in (tau, tuple(max(value, 1e-5) for value in tau))
    )
    rise, fall = (np.array([max(value, 1e-5)]) for value in tau[1:])
    expected = near.variance_s2(rise, fall)[0]
    assert found.variance_s2(rise, fall)[0] == pytest.approx(expected, rel=0.02, abs=1e-6)


@pytest.mark.parametrize("fall", [0.02, 0.05, 0.09])
def test_the_body_has_a_share_of_what_is_late(fall: float) -> None:
    """Thrust that rises at once: tails are exponential, and sums over cycles geometric series.

    To some percent: the jump falls between two ages.
    """
    width, cycle = 0.125, 0.125
    tau, whole, left = (0.0, 1e-9, fall), width + fall, np.exp(-cycle / fall)
    first, every = fall / (1.0 - left), fall**2 / (1.0 - left**2)
    after = body_share(SHAPE, tau, width, cycle, cycle)
    assert after == pytest.approx(1.0 - 0.5 * whole * first / every, rel=0.02)
    # one that has just begun is credited with all beyond its width, and nothing has come
    with_begun = every - 0.5 * whole * (first - fall)
    share = body_share(SHAPE, tau, width, 0.0, cycle)
    assert share == pytest.approx(with_begun / (fall**2 + every), rel=0.02)


def test_the_share_is_that_of_pulses_found_at_any_time() -> None:
    """Mean product of momentum and what is late, of pulses found at random."""
    rng, width, tau = np.random.default_rng(4), 0.125, (0.005, 0.02, 0.06)
    curve = np.linspace(0.0, 0.7, 70_001)
    thrust = SHAPE.thrust_fraction(curve, width, *tau)
    came = np.r_[0.0, np.cumsum(0.5 * (thrust[1:] + thrust[:-1]) * np.diff(curve))]
    age = rng.uniform(0.0, 0.6, 200_000)
    whole = float(SHAPE.effective_time(width, *tau))
    brought = np.interp(age, curve, came)
    late = np.minimum(age, width) + whole - width - brought
    products = (brought - 0.5 * whole) * late
    error = products.std() / np.sqrt(len(age)) / (late**2).mean()
    share = -products.mean() / (late**2).mean()
    assert body_share(SHAPE, tau, width, 0.0, 0.0) == pytest.approx(share, abs=4.0 * error)


def test_a_thruster_that_never_pauses_fires_many_times() -> None:
    """A firing ends at the first idle interval, or after 32 pulses; none is lost."""
    begun = np.r_[np.full(40, 2.0), 0.0, np.ones(3)]
    found = firings(0.1 * begun, begun)
    assert found.pulses.tolist() == [32.0, 32.0, 16.0, 3.0]
    assert found.seconds.sum() == pytest.approx(0.1 * begun.sum())
    assert firings(0.1 * begun, begun, np.inf).pulses.tolist() == [80.0, 3.0]


def test_tails_are_where_pulses_begin() -> None:
    """Of a firing over three intervals, on-time is where counters have it, tails are by pulses."""
    on_time = np.array([[0.125], [0.250], [0.125]])
    pulses = np.array([[1.0], [1.0], [2.0]])

    def plain(mean: Array, _count: Array) -> Array:
        return (mean + 0.03)[:, None]

    found = effective_increments(on_time, pulses, plain)[:, 0, 0]
    assert found == pytest.approx([0.155, 0.280, 0.185])


def test_a_pulse_that_has_just_begun_at_a_reading_comes_with_the_next() -> None:
    """Pulses of one cycle, cut by readings: counted where their on-time is; longer ones hide it."""
    on_time = 0.125 * np.array([0.0, 1.0, 1.0, 2.0, 3.0, 3.0, 3.0, 5.0, 5.0])[:, None]
    pulses = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 3.0, 4.0, 5.0, 6.0])[:, None]
    found = delivered_pulses(on_time, pulses, 0.125)[:, 0]
    # the second and the third have just begun at their readings, the fourth as well; of the last
    # nothing came
    assert found.tolist() == [0.0, 1.0, 1.0, 2.0, 3.0, 3.0, 3.0, 5.0, 6.0]
    longer = on_time + 0.125 * np.arange(9.0)[:, None]
    assert delivered_pulses(longer, pulses, 0.125).tolist() == pulses.tolist()


def test_tails_of_pulses_that_readings_cut_are_not_credited_before_they_come() -> None:
    """Of 300 pulses of one cycle those that begin at a reading; with some of two cycles none."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 4_000.0, 10.0)
    begins = np.sort(0.125 * rng.choice(int(time[-1] / 0.125), 900, replace=False))
    priors = telemetry_priors()
    guard_s = sampling_of(priors, priors.spacecraft.thruster_names("B"), 1.0, "first_order").guard_s
    plain = made_up_samples(rng, len(time))
    for longer in (0, 90):
        width = np.full(len(begins), 0.125)
        width[:longer] = 0.25
        ages = np.subtract.outer(time, begins)
        pulses = np.tile((ages >= 0.0).sum(axis=1, dtype=np.float64)[:, None], (1, 8))
        on_time = np.tile(np.clip(ages, 0.0, width).sum(axis=1)[:, None], (1, 8))
        state = (plain.attitude, plain.rate_rad_s, plain.wheel_rad_s)
        found = prepare([Samples(time, *state, on_time, pulses)], 0.125, guard_s)
        assert found.found.late.block_s > 0.0
        assert found.found.late.every_s == 0.125
        assert found.found.late.first_s == (0.125 if longer == 0 else 0.0)
        late = np.tile((ages == 0.0).sum(axis=1)[:, None], (1, 8))
        late[-1] = 0
        wanted = pulses - late if longer == 0 else pulses
        read = np.searchsorted(time, found.found.read_s)
        assert np.array_equal(found.found.pulses, wanted[read])


def test_more_pulses_are_closer() -> None:
    """Pairs of an interval by their number and its length, and those about the reading before."""
    length = np.array([1.0, 1.0, 4.0, 1.0, 1.0])
    pulses = np.array([[2.0], [3.0], [4.0], [1.0], [9.0]])
    before = np.array([[0.0], [0.0], [0.0], [2.0], [9.0]])
    expected = [1.0, 2 * 1.5, 3 * 2 / 4, 2 / 6, 8 * 5 / 3 + 4 / 6]
    found = close_pairs(length, pulses, before, np.full((5, 1), 0.25))
    assert found[:, 0] == pytest.approx(expected)


@pytest.mark.parametrize("length_s", [1.0, 4.0])
@pytest.mark.parametrize("apart_s", [0.15, 0.4])
def test_close_pairs_are_about_a_reading_as_often_as_drawn_ones(
    length_s: float, apart_s: float
) -> None:
    """One pulse in ten has a second one soon after it, at any time between readings.

    Close pairs over those that counters allow by chance, within an interval and about a reading,
    are to each other as stated: four standard deviations of the counts.
    """
    rng = np.random.default_rng(20261201)
    first = rng.uniform(0.0, 1e6, size=200_000 // int(length_s))
    close = first[: len(first) // 10]
    count = np.bincount(np.floor(first / length_s).astype(np.intp))
    about = np.count_nonzero(np.floor((close + apart_s) / length_s) > np.floor(close / length_s))
    within = len(close) - about
    ratio = (about / (count[1:] @ count[:-1])) / (within / (count @ (count - 1) / 2))

    both = close_pairs(np.ones(2) * length_s, np.array([[2.0], [1.0]]), np.array([[0.0], [1.0]]),
                       np.full((2, 1), apart_s))[:, 0]  # fmt: skip
    tolerance = 4.0 * np.sqrt(1.0 / about + 1.0 / within)
    assert ratio == pytest.approx(both[1] / both[0], rel=tolerance)


def test_rows_at_readings_have_one_before() -> None:
    """A row counts where counters were read, and read before by the guard time at least."""
    found = rows_at_readings(np.arange(0.0, 6.0, 0.5), np.array([0.0, 1.0, 1.25, 3.0]), 0.5)
    assert np.flatnonzero(found).tolist() == [2, 6]
    assert not rows_at_readings(np.arange(3.0), np.zeros(0), 0.5).any()


def ceaseless(rows: int = 400) -> Samples:
    """Made-up rows every second with a pulse in every interval but one."""
    samples = made_up_samples(np.random.default_rng(5), rows)
    pulses = np.tile(np.arange(rows, dtype=np.float64)[:, None], (1, 8))
    pulses[200:] -= 1.0
    return Samples(
        np.arange(rows, dtype=np.float64),
        samples.attitude,
        samples.rate_rad_s,
        samples.wheel_rad_s,
        0.125 * pulses,
        pulses,
    )


def test_blocks_do_not_depend_on_chunks() -> None:
    """Rows are means over 32 s, however they come; few quiet rows are what asks for it."""
    samples, priors = ceaseless(), telemetry_priors()
    sampling = sampling_of(priors, priors.spacecraft.thruster_names("B"), 399.0, "first_order")
    layout = layout_of((1, 2, 4), priors.spacecraft.thruster_names("B"), sampling)
    found = prepare([samples], 0.125, sampling.guard_s).found
    assert found.late.block_s == 32.0
    assert found.late.width_s == pytest.approx(0.125)
    assert found.late.rate_hz == pytest.approx([398.0 / 399.0] * 8)

    def chunks(at: int) -> Iterator[Samples]:
        yield samples.part(0, at)
        yield samples.part(at)

    whole = reduce_chunks("e", "bias", [samples], layout, sampling, prepared=found)
    parts = reduce_chunks("e", "bias", chunks(207), layout, sampling, prepared=found)
    assert whole.rows == 13
    assert whole.counters.averaged == pytest.approx(400 / 13)
    assert whole.turns.pieces == 0
    assert parts.gram == pytest.approx(whole.gram, rel=1e-12)
    rates = [
        samples.rate_rad_s[max(start, 1) : start + 32].mean(axis=0) for start in range(0, 400, 32)
    ]
    one, rate = layout.one, layout.rate
    assert whole.gram[0, 0, one, rate] == pytest.approx(np.sum(rates, axis=0), rel=1e-9)
    quiet = made_up_samples(np.random.default_rng(5), 400)
    assert prepare([quiet], 0.125, sampling.guard_s).found.late.block_s == 0.0


def by_body(event: TelemetryBalance, physics: Physics) -> Array:
    """What the measure grows with in other events."""
    return np.log(np.abs(np.linalg.det(physics.inertia_kg_m2))) - event.log_size


@cache
def ceaseless_flight(
    seed: int,
    cadence: str = "4 s",
    rates: str = "as flown",
    tau_fall_s: float | None = None,
    drive: str = "30 mN m",
) -> tuple[SimulatedEvent, dict[str, float], Condition]:
    """A bias whose controller fires in every interval, and its truth."""
    condition = Condition(
        "B branch",
        "one bias",
        cadence,
        "1 ms",
        "0.1 rpm",
        rates,
        "high gain, union",
        "inferred",
        drive,
    )
    rng = np.random.default_rng(seed)
    file = scenario_under(condition, ROOT / "runs/scenarios/calibration.toml", ROOT / "priors", rng)
    priors = beliefs_under(condition, ROOT / "priors")
    if tau_fall_s is not None:
        priors = priors.with_fixed("tau_fall_s", tau_fall_s)
    flight = simulate_file(file, int(rng.integers(2**62)), priors=priors)
    return flight.events[0], flat_truth(flight), condition


Flight = tuple[SimulatedEvent, dict[str, float], Condition]


def at_the_truth(
    event: SimulatedEvent, truth: dict[str, float], condition: Condition
) -> tuple[Model, Array]:
    """The model of a flight, and the coordinates (d,) of its truth."""
    priors = beliefs_under(condition, ROOT / "priors")
    model = build_model([reduced_simulation(event, priors)], priors)
    assert LATE_FACTOR in model.space.names
    values = {
        name: truth.get(name, float(prior.mean()))
        for name, prior in zip(model.space.names, model.space.distributions, strict=True)
    }
    return model, model.space.to_standard(values)


def slope_of_inertias(flights: Sequence[Flight]) -> float:
    """Slopes at the truth in the moments of inertia, together over their standard deviation.

    Slopes scatter by the curvature; that of one flight alone may be next to nothing.
    """
    step, slopes, curvatures = 0.02, [], []
    for flight in flights:
        model, z = at_the_truth(*flight)
        for name in INERTIAS:
            move = step * np.eye(len(z))[model.space.names.index(name)]
            points = np.stack([z + move, z, z - move])
            up, here, down = log_posterior(model, points) + 0.5 * (points**2).sum(axis=1)
            slopes.append(0.5 * (up - down) / step)
            curvatures.append((2.0 * here - up - down) / step**2)
    return float(np.sum(slopes) / np.sqrt(np.sum(curvatures)))


@pytest.mark.statistical
def test_the_slope_at_the_truth_is_zero_where_pulses_are_late(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Moments of inertia are drawn neither way; a measure that grows with the body draws them up.

    Twelve flights of a bias with a controller of high gain. The standard deviation of the sum of 36
    slopes is √3 if those of a flight are alike.
    """
    flights = [ceaseless_flight(seed) for seed in range(12)]
    assert abs(slope_of_inertias(flights)) < 3.0
    monkeypatch.setattr(cassini_bayes.balance.flat_motion, "_body_growth", by_body)
    assert slope_of_inertias(flights[:6]) > 4.0


@pytest.mark.statistical
def test_long_tails_do_not_draw_moments_of_inertia(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is late is most of the noise there, and the measure must know it.

    Twelve flights whose tails are 1.7 times as long as expected, readings every second: slopes as
    above. With the measure taken at the prior means moments are drawn up.
    """
    flights = [ceaseless_flight(seed, "1 s", tau_fall_s=0.085) for seed in range(12)]
    assert abs(slope_of_inertias(flights)) < 3.0 * np.sqrt(3.0)
    monkeypatch.setattr(cassini_bayes.model.posterior, "_with_thrusts", at_prior_means)
    assert slope_of_inertias(flights[:6]) > 8.0


def at_prior_means(model: Model, thrusts_n: Array, nominal: Points, _likely: Points) -> Model:
    """Nothing likelier is known than what the priors expect."""
    return WITH_THRUSTS(model, thrusts_n, nominal, nominal)


def thrust_errors(flights: Sequence[Flight]) -> Array:
    """Mean thrust of a flight's posterior less the true one, in standard deviations."""
    result = []
    for event, truth, condition in flights:
        model, z = at_the_truth(event, truth, condition)
        mode = find_mode(partial(log_posterior, model), len(z), z)
        rng = np.random.default_rng(0)
        moved = rng.standard_normal((400, len(mode.point))) @ mode.factor.T
        mean = draw(model, mode.point + moved, rng).thrusts.thrust_n[:, 0].mean(axis=1)
        names = [f"thrust_n[{event.plan.event.id},{thruster}]" for thruster in model.thrusters]
        result.append((mean.mean() - np.mean([truth[name] for name in names])) / mean.std())
    return np.array(result)


@pytest.mark.statistical
def test_thrusts_are_not_too_small_where_thrusters_push_to_and_fro(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is on the whole is little beside what is late, and thrusters answer that.

    Nine flights with wheels that are driven slowly: mean and root mean square of the errors, in
    standard deviations, within three of their own (0.33, and 0.24 above 1). Without the thrusts'
    part of the measure, which is errors in variables, thrusts of the first five come out too small.
    """
    slow = partial(ceaseless_flight, cadence="1 s", rates="ten times finer", drive="2 mN m")
    flights = [slow(seed) for seed in range(9)]
    found = thrust_errors(flights)
    assert abs(found.mean()) < 1.0
    assert np.sqrt((found**2).mean()) < 1.7
    monkeypatch.setattr(cassini_bayes.model.telemetry, "in_thrust_units", without_thrusts)
    assert thrust_errors(flights[:5]).mean() < -1.0


def without_thrusts(
    event: TelemetryBalance, _physics: Physics, _delivered: Array
) -> TelemetryBalance:
    """Thrusters answer nothing."""
    return event


@pytest.mark.parametrize("drive", ["30 mN m", "2 mN m"])
def test_thrusts_that_size_what_is_late_are_told_before_the_fit(drive: str) -> None:
    """To a tenth of most flights, whatever the tail, and to a third of all ten."""
    found = []
    for seed in range(10):
        event, truth, condition = ceaseless_flight(seed, "1 s", "ten times finer", drive=drive)
        model, _ = at_the_truth(event, truth, condition)
        true = np.mean([truth[f"thrust_n[bias-1,{thruster}]"] for thruster in model.thrusters])
        found.append(model.telemetry[0].balance.thrusts_n[0] / true)
    assert np.all(np.abs(np.array(found) - 1.0) < 0.33)
    assert np.mean(np.abs(np.array(found) - 1.0) < 0.1) >= 0.8


def test_an_event_without_late_pulses_keeps_its_thrusts_one_by_one() -> None:
    """Beside one that has them; those of the other are all the same."""
    late, _, condition = ceaseless_flight(0, "1 s", "ten times finer")
    priors = beliefs_under(condition, ROOT / "priors")
    calm = replace(condition, controller="hysteresis")
    rng = np.random.default_rng(7)
    file = scenario_under(calm, ROOT / "runs/scenarios/calibration.toml", ROOT / "priors", rng)
    other = simulate_file(file, 11, priors=priors).events[0]
    reduced = [reduced_simulation(own, priors) for own in (late, other)]
    reduced[1] = replace(reduced[1], statistics=replace(reduced[1].statistics, event_id="calm"))
    model = build_model(reduced, priors)
    of_late, of_other = (term.balance.thrusts_n for term in model.telemetry)
    assert np.ptp(of_late) == 0.0
    assert np.ptp(of_other) > 0.0


def test_slews_do_not_decide_what_is_likely_of_late_pulses() -> None:
    """A bias with late pulses beside slews, of 2.3e-6 rad/s: noise of rates within a factor 1.6.

    At prior means slews leave what only four times that would explain. Noise and thrusts by which
    late pulses are weighed are those of all hypotheses, with torque noise and without.
    """
    scenario, beliefs = ROOT / "runs" / "scenarios" / "calibration.toml", ROOT / "priors"
    campaign = Blind(scenario, beliefs, 20263301, (), OVER_CONDITIONS, over_conditions=True)
    scene = campaign.scene(campaign.stream(17))
    events, truth = scene.fly(()), scene.truth().parameters["rate_noise_rad_s"]
    found = []
    for hypothesis in (none_hypothesis(events), unknown_hypothesis(events)):
        (late,) = (t.balance for t in hypothesis.model.telemetry if t.balance.late is not None)
        noise = dict(late.sampling.reference_noise)["rate_noise_rad_s"]
        found.append((noise, *late.thrusts_n))
    assert np.abs(np.log(found[0][0] / truth)) < np.log(1.6)
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_the_thrusts_part_of_the_measure_is_a_logarithm_to_second_order() -> None:
    """Value, slope and curvature at the event's thrusts, by the logarithm itself.

    Y thrusters push in couples, whose torques about X cancel: they have no part in it.
    """
    model, z = at_the_truth(*ceaseless_flight(3))
    (term,) = model.telemetry
    delivered = term.delivered(term.physics(model.points(z[None])), 1)
    event, step = term.balance, 1e-2
    assert event.answered is not None
    rows, weights = event.answered.rows, event.answered.weights
    assert np.all((rows > 1.0) & (rows < term.event.statistics.rows))
    of_couples = [place for place, name in enumerate(model.thrusters) if name.startswith("y")]
    assert np.all(weights[:2, of_couples] == 0.0)
    assert np.all(weights[2, of_couples] != 0.0)

    def exact(thrust: Array) -> float:
        return float(rows @ np.log((weights * delivered[0]) @ thrust))

    def quadratic(thrust: Array, common: float) -> float:
        found = pushed_information(event, delivered, np.array([common]))
        matrix, vector, constant = (own[0] for own in found)
        d = thrust - common
        return float(constant + vector @ d - 0.5 * d @ matrix @ d)

    rng = np.random.default_rng(0)
    for common in (0.7, 0.0):  # the densities of a fit count from 0
        for _ in range(3):
            move = step * rng.standard_normal(len(event.thrusts_n))
            at = [event.thrusts_n + side * move for side in (-1.0, 0.0, 1.0)]
            values = np.array([[quadratic(own, common), exact(own)] for own in at])
            assert values[1, 0] == pytest.approx(values[1, 1], abs=1e-9)
            slope, curvature = values[2] - values[0], values[2] - 2.0 * values[1] + values[0]
            assert slope[0] == pytest.approx(slope[1], rel=0.01)
            assert curvature[0] == pytest.approx(curvature[1], rel=0.02)


def test_an_axis_that_nothing_pushes_has_no_part_in_the_measure() -> None:
    """No arms about X: all numbers are finite, and the other axes have what they had."""
    model, z = at_the_truth(*ceaseless_flight(3))
    (term,) = model.telemetry
    points = model.points(z[None])
    physics = term.physics(points)
    flat = replace(physics, arms_m=physics.arms_m * np.array([0.0, 1.0, 1.0])[:, None])
    found = [in_thrust_units(term.balance, own, term.delivered(own, 1)) for own in (physics, flat)]
    (rows, weights, *_), (flat_rows, flat_weights, *_) = (own.answered for own in found)
    assert flat_rows.tolist() == [0.0, *rows[1:]]
    assert np.all(flat_weights[0] == 0.0)
    np.testing.assert_array_equal(flat_weights[1:], weights[1:])
    parts = pushed_information(found[1], term.delivered(flat, 1), np.zeros(1))
    assert all(np.isfinite(part).all() for part in parts)


@pytest.mark.statistical
def test_longer_means_leave_less_of_what_thrusters_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tails of 12 ms, whose mean product with the body's momentum draws inertias up.

    Twelve flights with fine rates: slopes at the truth in means over 16 s are 2.9 standard
    deviations together, over 32 s 1.1.
    """
    flights = [ceaseless_flight(seed, "1 s", "ten times finer", 0.012) for seed in range(12)]
    found = slope_of_inertias(flights)
    monkeypatch.setattr(cassini_bayes.balance.statistics.preparation, "BLOCK_S", 16.0)
    shorter = slope_of_inertias(flights)
    assert shorter > 2.0
    assert found < 0.7 * shorter


def test_what_is_cut_scatters_by_the_factor_of_what_is_late() -> None:
    """Twice the factor is twice the variance of cut tails, and their mean as it was.

    In events with rows between firings the factor says nothing.
    """
    event, _, condition = ceaseless_flight(3)
    priors = beliefs_under(condition, ROOT / "priors")
    model = build_model([reduced_simulation(event, priors)], priors)
    (term,) = model.telemetry
    physics = term.physics(model.points(np.zeros((2, model.space.dimension))))
    factors = replace(physics, late_factor=np.array([1.0, 2.0]))
    late = open_scales(term.balance, factors).lost
    settled = open_scales(replace(term.balance, late=None), factors).lost
    assert late.variance_s2[1] == pytest.approx(2.0 * late.variance_s2[0])
    assert late.variance_s2[0] == pytest.approx(settled.variance_s2[0])
    assert late.mean_s[1] == late.mean_s[0]
    assert settled.variance_s2[1] == settled.variance_s2[0] > 0.0


def test_late_records_are_not_weighed_where_pulses_are_late() -> None:
    """What is late in rows is what a time offset is: that cause is left out, all others stay."""
    event, _, condition = ceaseless_flight(3)
    priors = beliefs_under(condition, ROOT / "priors")
    reduced = reduced_simulation(event, priors)
    settled = replace(reduced, sampling=replace(reduced.sampling, block_s=0.0))
    late, every = (prepare_diagnosis([one], priors).catalogue.names for one in (reduced, settled))
    assert set(every) - set(late) == {"time_offset"}
    assert set(late) < set(every)


def test_a_bias_without_rows_is_still_refused() -> None:
    """Two means of rows at readings tell nothing: the line says what would do."""
    samples = ceaseless(55).part(0, 55)
    priors = telemetry_priors()
    thrusters = priors.spacecraft.thruster_names("B")
    sampling = sampling_of(priors, thrusters, 54.0, "first_order")
    found = prepare([samples], 0.125, sampling.guard_s).found
    with pytest.raises(InputError, match="at readings of the counters, got 2 means over 32 s"):
        reduce_chunks(
            "e",
            "bias",
            [samples],
            layout_of((1, 2, 4), thrusters, sampling),
            sampling,
            prepared=found,
        )


@pytest.mark.filterwarnings("error")
def test_a_firing_that_nothing_began_leaves_no_width() -> None:
    """On-time without a counted pulse, and one row alone: no rate of pulses is made up."""
    samples = ceaseless(100)
    firing = replace(samples, pulses=np.zeros_like(samples.pulses))
    for given in (firing, samples.part(0, 1)):
        assert prepare([given], 0.125, 1.0).found.late.block_s == 0.0
    assert prepare([samples], 0.125, 1.0).found.late.block_s > 0.0


def test_what_an_effect_takes_is_not_delivered() -> None:
    """A warm-up's loss, in the measure as in the last row: thrust that makes up for it is no gain.

    With the loss left out the measure grows with the thrust, and a warm-up was named by 27 nats.
    """
    event, _, condition = ceaseless_flight(3)
    priors = beliefs_under(condition, ROOT / "priors")
    effects = named_effects(["thrust_warmup"], priors, (1, 2, 4), ["telemetry"])
    model = build_model([reduced_simulation(event, priors)], priors, effects=effects)
    (term,) = model.telemetry
    balance, statistics = term.balance, term.balance.statistics
    rows, names = term.event.usable_rows, statistics.layout.extra
    assert statistics.extra_end == pytest.approx(rows.scalar[-1, -len(names) :])
    physics = term.physics(model.points(np.zeros((1, model.space.dimension))))
    physics = replace(physics, extra={})
    taking = {name: -0.02 for _, _, name in balance.pattern.brought}
    assert taking
    plain = term.delivered(physics, 1)
    less = term.delivered(replace(physics, extra=taking), 1)
    pushes = plain != 0.0
    assert np.all((less / np.where(pushes, plain, 1.0))[pushes] > 0.0)
    assert np.all(np.abs(less[pushes]) < np.abs(plain[pushes]))
    more = np.max(plain / np.where(pushes, less, 1.0), axis=(0, 1))

    def measure(found: tuple[Array, Array, Array], thrust: Array) -> float:
        matrix, vector, constant = (own[0] for own in found)
        return float(constant + vector @ thrust - 0.5 * thrust @ matrix @ thrust)

    moved = replace(balance, thrusts_n=more * balance.thrusts_n)
    before = pushed_information(balance, plain, np.zeros(1))
    after = pushed_information(moved, less, np.zeros(1))
    assert measure(after, moved.thrusts_n) == pytest.approx(measure(before, balance.thrusts_n))
