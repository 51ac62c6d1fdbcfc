"""Pieces of the diagnosis against oracles of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cassini_bayes.balance.physics import physics_of
from cassini_bayes.balance.statistics import RowContext, Samples, reduce_chunks
from cassini_bayes.balance.statistics.columns import Carry, settle
from cassini_bayes.diagnosis import kinematics
from cassini_bayes.diagnosis.extended import TelemetrySource, reduce_source
from cassini_bayes.diagnosis.kinematics import rate_information, rotation_vectors
from cassini_bayes.diagnosis.modes import baseline_mode
from cassini_bayes.diagnosis.sizes import weighted_interval
from cassini_bayes.diagnosis.summaries import weigh_summaries
from cassini_bayes.effects.catalogue import DEFAULT, read_catalogue
from cassini_bayes.effects.columns import (
    WARMUP_NODES_S,
    hat_weights,
    lagrange_weights,
    telemetry_columns,
    warmup_column,
    warmup_tail_column,
)
from cassini_bayes.effects.modifiers import modifier_of
from cassini_bayes.errors import InputError
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.studies.blind.rates import interval
from cassini_bayes.studies.blind.trials import STRATA, stratum_of
from cassini_bayes.studies.published_cases import a_branch, flight_2004, fsds

ROOT = Path(__file__).parents[2]
PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
CATALOGUE = read_catalogue(PRIORS, (1, 2, 4), ("telemetry", "totals"))


def centre() -> dict[str, np.ndarray]:
    """Prior means as one point."""
    values = {}
    for name, prior in PRIORS.parameters.items():
        value = prior.fixed if prior.distribution is None else prior.distribution.mean()
        values[name] = np.array([value], dtype=float)
    return values


@pytest.mark.parametrize(
    ("name", "baseline"),
    [
        ("center_of_mass:x", "cm_x_m"),
        ("inertia:xy", "inertia_xy_kg_m2"),
        ("wheel_inertia:2", "rwa2_inertia_kg_m2"),
        ("tail_off", "tau_fall_s"),
    ],
)
def test_departure_is_the_baseline_parameter_moved(name: str, baseline: str) -> None:
    """An effect on a parameter of the baseline does what moving that parameter does."""
    effect = CATALOGUE.effect(name)
    point = {**centre(), effect.parameters[0].name: np.array([0.013])}
    modify = modifier_of(effect, PRIORS.spacecraft, PRIORS.branch)
    found = physics_of(PRIORS.spacecraft, PRIORS.branch, point, (modify,))
    moved = {**centre(), baseline: centre()[baseline] + 0.013}
    wanted = physics_of(PRIORS.spacecraft, PRIORS.branch, moved)
    assert found.arms_m == pytest.approx(wanted.arms_m)
    assert found.inertia_kg_m2 == pytest.approx(wanted.inertia_kg_m2)
    assert found.wheel_weights == pytest.approx(wanted.wheel_weights)
    assert found.tau_s[2] == pytest.approx(wanted.tau_s[2])


def test_cant_turns_the_force() -> None:
    """A canted thruster's arm is (r − e) × unit(d + a e1 + b e2)."""
    effect = CATALOGUE.effect("thruster_misalignment:y2")
    point = centre()
    for parameter, value in zip(effect.parameters, (0.04, -0.03), strict=True):
        point[parameter.name] = np.array([value])
    modify = modifier_of(effect, PRIORS.spacecraft, PRIORS.branch)
    arms = physics_of(PRIORS.spacecraft, PRIORS.branch, point, (modify,)).arms_m[0]
    k = PRIORS.spacecraft.thruster_names(PRIORS.branch).index("y2")
    force = np.array([0.04, -1.0, -0.03]) / np.sqrt(1.0 + 0.04**2 + 0.03**2)
    place = np.array([-1.234, 1.610, 2.880]) - np.array([0.13, 0.057, 1.064])
    assert arms[:, k] == pytest.approx(np.cross(place, force))


def test_interpolation_of_columns() -> None:
    """Warm-up between nodes is good to some percent; a time shift is linear between nodes."""
    nodes = np.array(WARMUP_NODES_S)
    on_time = np.linspace(0.0, 40.0, 200)

    def lost(t: float) -> np.ndarray:
        return np.asarray(-t * np.expm1(-on_time / t))

    for value in (0.8, 2.5, 6.0, 20.0):
        weights = lagrange_weights(np.log(np.array([value])), np.log(nodes))[0]
        found = sum(w * lost(float(t)) for w, t in zip(weights, nodes, strict=True))
        assert np.abs(found - lost(value)).max() < 0.05 * value + 0.25
    assert hat_weights(np.array([0.25]), np.array([-1.0, 0.0, 1.0])) == pytest.approx(
        np.array([[0.0, 0.75, 0.25]])
    )


def made_up(
    bias: float,
    scale: float,
    rng: np.random.Generator,
    noise: tuple[float, float] = (2e-5, 2e-6),
    seconds: float = 2000.0,
) -> Samples:
    """A body turning slowly about Z with swings, its rates misread about Z.

    ``noise`` is that of the attitude (rad) and of rates (rad/s).
    """
    time = np.arange(0.0, seconds)
    rate = 2e-4 * np.sin(time / 150.0)
    angle = 2e-4 * 150.0 * (1.0 - np.cos(time / 150.0))
    angle = angle + noise[0] * rng.standard_normal(len(time))
    attitude = np.zeros((len(time), 4))
    attitude[:, 2], attitude[:, 3] = np.sin(angle / 2), np.cos(angle / 2)
    rates = noise[1] * rng.standard_normal((len(time), 3))
    rates[:, 2] += (1.0 + scale) * rate + bias
    return Samples(
        time,
        attitude,
        rates,
        np.zeros((len(time), 3)),
        np.empty((len(time), 0)),
        np.empty((len(time), 0)),
    )


def test_attitude_tells_rate_bias_and_scale() -> None:
    """Bias and scale come back within four of their standard deviations; none gives none."""
    for bias, scale in ((3e-6, 0.0), (0.0, 0.02), (0.0, 0.0)):
        samples = made_up(bias, scale, np.random.default_rng(3))
        information = rate_information(samples)
        covariance = np.linalg.inv(information.precision[2])
        found = covariance @ information.linear[2]
        miss = (found - np.array([bias, scale])) / np.sqrt(np.diag(covariance))
        assert np.abs(miss).max() < 4.0
        assert np.sqrt(covariance[0, 0]) < 5e-7
    turned = rotation_vectors(made_up(0.0, 0.0, np.random.default_rng(0)).attitude)
    assert np.abs(turned[:, :2]).max() < 1e-12


def gyro_nats(count: int) -> NDArray[np.float64]:
    """What bias and scale gain at best on flights without either, attitude noise outweighing."""
    found = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        information = rate_information(made_up(0.0, 0.0, rng, (3e-5, 1e-6), 3600.0))
        linear = information.linear[2]
        found.append(0.5 * linear @ np.linalg.solve(information.precision[2], linear))
    return np.array(found)


def test_gyros_without_errors_gain_as_chance_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of a χ² of two: mean 1; with the walk of rate noise left to chance it is far more."""
    nats = gyro_nats(120)
    assert abs(nats.mean() - 1.0) < 4.0 / np.sqrt(len(nats))
    assert nats.max() < np.log(len(nats)) + 5.0
    monkeypatch.setattr(kinematics, "_white_variance", lambda _: np.zeros(3))
    assert gyro_nats(120).max() > np.log(len(nats)) + 5.0


def test_warm_up_takes_from_the_tails_of_pulses_as_well() -> None:
    """Pulses of 125 ms with tails of 30 ms: the columns are the sum of what each of them lost."""
    width, tail, constant = 0.125, 0.030, 1.4
    fired = np.arange(40)
    time = np.arange(400.0)
    count = np.minimum(time // 10.0 + 1.0, len(fired))
    counters = (time, (width * count)[:, None], count[:, None])
    context = RowContext(time, np.zeros((400, 3)), np.zeros((400, 3)), *counters)
    columns = {column.name: column for column in telemetry_columns(("z1",))}
    commanded = columns[warmup_column("z1", constant)].values(context)
    tails = columns[warmup_tail_column("z1", constant)].values(context)
    ends = width * (fired + 1.0)
    of_pulses = constant * (np.exp(-(ends - width) / constant) - np.exp(-ends / constant))
    place = count.astype(int) - 1
    assert commanded == pytest.approx(np.cumsum(of_pulses)[place])
    # the first pulse is before the first reading, where nothing had been lost
    wanted = np.cumsum(np.exp(-ends / constant)) - np.exp(-ends[0] / constant)
    assert tails == pytest.approx(wanted[place])
    assert tail * tails[-1] > 0.15 * commanded[-1]


def test_long_events_have_the_columns_of_the_whole_event() -> None:
    """The reduction cuts events into blocks; what an effect adds up has to see all of it."""
    n = 5_000
    time_s = np.arange(0.0, n)
    rng = np.random.default_rng(5)
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    pulses = np.floor(time_s / 40.0)[:, None] * np.ones(8)
    rates = 1e-5 * rng.standard_normal((n, 3)), rng.standard_normal((n, 3))
    samples = Samples(time_s, attitude, *rates, 0.125 * pulses, pulses)
    thrusters = PRIORS.spacecraft.thruster_names(PRIORS.branch)
    source = TelemetrySource("long", "bias", (1, 2, 4), thrusters, samples)
    reduced = reduce_source(source, PRIORS, telemetry_columns(thrusters))
    whole, sampling = reduced.statistics, reduced.sampling
    rows, _ = settle(samples, Carry.start(whole.layout), whole.layout, sampling, final=True)
    place = whole.layout.scalar.index(warmup_tail_column("z1", 32.0))
    wanted = float((rows.scalar[:, place] ** 2).sum())
    place += len(whole.layout.vector)
    assert whole.gram[0, 0, place, place] == pytest.approx(wanted)
    in_blocks = reduce_chunks("long", "bias", [samples], whole.layout, sampling)
    assert in_blocks.gram[0, 0, place, place] < 0.99 * wanted  # it begins anew in every block


def test_laplace_is_exact_for_a_normal() -> None:
    """On a Gaussian the evidence by Laplace is the determinant formula, ridges included."""
    rng = np.random.default_rng(5)
    root = np.diag([1.0, 0.03, 0.3]) @ np.linalg.qr(rng.standard_normal((3, 3)))[0]
    precision = np.linalg.inv(root @ root.T)

    def density(z: np.ndarray) -> np.ndarray:
        gap = z - 0.2
        return np.asarray(-0.5 * np.einsum("ni,ij,nj->n", gap, precision, gap))

    mode = baseline_mode(density, 3)
    wanted = 1.5 * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(precision)[1]
    assert mode.log_evidence == pytest.approx(wanted, abs=1e-3)


def test_weighted_interval_of_a_normal() -> None:
    """The shortest 90 % interval of a weighted normal sample is the central one."""
    z = np.random.default_rng(1).standard_normal(40_000)
    low, high = weighted_interval(z, np.full(len(z), 1.0 / len(z)))
    assert (low, high) == pytest.approx((-1.645, 1.645), abs=0.08)


def test_published_cases_say_what_the_docs_say() -> None:
    """The closed form explains the FSDS case; the flight biases do not need a cause."""
    rng = np.random.default_rng(1)
    case = fsds()
    verdicts = weigh_summaries(case.estimate_n, case.sd_n, case.causes(), rng, 60_000)
    assert verdicts[0].name == "pulse_shape, first-order closed form"
    flight = flight_2004()
    names = [
        v.name
        for v in weigh_summaries(flight.estimate_n, flight.sd_n, flight.causes(), rng, 60_000)
    ]
    assert names[0] == "none"
    branch = a_branch()
    found = weigh_summaries(branch.estimate_n, branch.sd_n, branch.causes(), rng, 60_000)
    assert {v.name: v.probability for v in found}["none"] < 1e-6


def test_strata_come_in_proportion() -> None:
    """Any first part of a campaign holds the strata in proportion; rates have exact intervals."""
    names = [stratum_of(i) for i in range(47)]
    for name, count in STRATA:
        assert abs(names.count(name) - count / 10) <= 1.0
    assert interval(0, 10) == pytest.approx((0.0, 0.3085), abs=1e-3)


def test_bad_catalogue_is_refused(tmp_path: Path) -> None:
    """A catalogue without its tables is an input error that names the table."""
    path = tmp_path / "effects.toml"
    path.write_text("[causes]\nnone = 0.5\n")
    with pytest.raises(InputError, match="unknown"):
        read_catalogue(PRIORS, (1, 2, 4), ("telemetry",), path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("flexible_mode.parameters.inertia_fraction", "flexible_mode.parameters.share", "share"),
        ("effects.flexible_mode", "effects.flexibel_mode", "did you mean"),
    ],
)
def test_a_catalogue_of_other_parameters_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    """What no change of the physics reads, or lacks what it reads, is named."""
    path = tmp_path / "effects.toml"
    text = DEFAULT.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_catalogue(PRIORS, (1, 2, 4), ("telemetry",), path)
