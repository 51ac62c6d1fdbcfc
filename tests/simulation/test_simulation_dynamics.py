"""The equations of motion: momentum, an independent integration, the integrator's order."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from simulation_cases import BIAS, PARAMETERS, SLEWS, make_plan, run

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.simulation.arrays import make_thrusters
from cassini_bayes.simulation.engine import Steps
from cassini_bayes.simulation.motion import Motion, rotate_to_inertial
from cassini_bayes.simulation.settings import (
    Appendage,
    StartSettings,
)
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

BOOM = Appendage(
    name="boom", axis=(1.0, 0.0, 0.2), inertia_kg_m2=300.0, frequency_hz=0.7, damping=0.005
)
ANTENNA = Appendage(
    name="antenna", axis=(0.0, 1.0, 1.0), inertia_kg_m2=60.0, frequency_hz=0.13, damping=0.002
)
SLEW_HOUR = {
    "id": "slews",
    "kind": "slew",
    "from_rpm": (300.0, -500.0, 700.0),
    "slew": SLEWS,
    "duration_s": 3600.0,
}
TUMBLE = {**BIAS, "to_rpm": (5000.0, 6000.0, -7000.0), "duration_s": 96.0, "thrusters_on": False}


def relative_drift(motion: Motion) -> float:
    """Largest |H(t) − H(0) − ∫τ dt| over the largest |H|, inertial frame."""
    momentum = motion.momentum_inertial_n_m_s()
    gain = momentum - momentum[0] - motion.angular_impulse_n_m_s
    return float(np.abs(gain).max() / np.linalg.norm(momentum, axis=1).max())


@pytest.mark.parametrize("appendages", [(), (BOOM, ANTENNA)])
def test_momentum_is_conserved_over_an_hour_of_slews(appendages: tuple[Appendage, ...]) -> None:
    """No external torque: total inertial momentum drifts by less than 1e-8, wheels did work."""
    motion = run(make_plan(SLEW_HOUR, appendages=appendages), record_s=1.0)
    assert relative_drift(motion) < 1e-8
    assert np.all(motion.angular_impulse_n_m_s == 0.0)
    assert np.ptp(motion.wheels_rpm, axis=0).min() > 100.0
    assert np.abs(motion.rate_rad_s).max() > 2e-3


def test_a_wrong_inertia_would_show_as_drift() -> None:
    """Negative control: momentum formed with an inertia 1 % off is not conserved."""
    motion = run(make_plan(SLEW_HOUR), record_s=1.0)
    wrong = motion.body._replace(inertia_kg_m2=motion.body.inertia_kg_m2 * 1.01)
    changed = Motion(**{**vars(motion), "body": wrong})
    assert relative_drift(changed) > 1e-4


def test_momentum_change_is_the_integral_of_thruster_torque() -> None:
    """With thrusters and external torque H changes by the accumulated impulse to 1e-8."""
    plan = make_plan(parameters={"external_torque_x_n_m": 1e-4, "external_torque_z_n_m": -2e-4})
    motion = run(plan)
    assert relative_drift(motion) < 1e-8
    assert np.abs(motion.angular_impulse_n_m_s[-1]).max() > 10.0


def test_torque_noise_is_a_random_walk_of_momentum() -> None:
    """Gained momentum has the variance a² t and independent steps; what is gained is conserved."""
    density, ends, halves = 1e-3, [], []
    for seed in range(30):
        motion = run(make_plan(TUMBLE, torque_noise_n_m_s05=density), seed=seed, record_s=1.0)
        assert relative_drift(motion) < 1e-6
        halves.append(motion.angular_impulse_n_m_s[48])
        ends.append(motion.angular_impulse_n_m_s[-1] - halves[-1])
    # 90 values each: relative standard error of a variance 0.15, of a correlation 0.11
    assert np.var(halves) == pytest.approx(density**2 * 48.0, rel=0.45)
    assert np.var(ends) == pytest.approx(density**2 * 48.0, rel=0.45)
    assert abs(np.corrcoef(np.ravel(halves), np.ravel(ends))[0, 1]) < 0.33


def test_the_accumulated_impulse_is_that_of_the_logged_pulses() -> None:
    """The impulse follows from pulse log, thrust curve and attitude, written down independently."""
    motion = run(make_plan({**BIAS, "to_rpm": (-918.0, 1300.0, 229.0)}))
    thrusters = make_thrusters(make_plan())
    shape = PULSE_SHAPES["first_order"]
    taus = [PARAMETERS[f"tau_{which}_s"] for which in ("delay", "rise", "fall")]
    # cut tails: use the thrust's own equation on a 0.25 ms grid, not the closed form of one pulse
    fine = 2.5e-4
    time = np.arange(0.0, motion.duration_s, fine) + 0.5 * fine
    attitude = np.stack(
        [np.interp(time, motion.time_s, motion.attitude[:, i]) for i in range(4)], axis=1
    )
    total = np.zeros((time.size, 3))
    for k, log in enumerate(motion.pulses.values()):
        fraction = np.zeros(time.size)
        for start, width in zip(log.start_s, log.width_s, strict=True):
            near = slice(*np.searchsorted(time, [start, start + width + 1.0]))
            fraction[near] += shape.thrust_fraction(time[near] - start, width, *taus)
        total += fraction[:, None] * 0.75 * thrusters.levers_m[:, k]
    gain = np.sum(rotate_to_inertial(attitude, total), axis=0) * fine
    # overlapping tails of pulses less than a second apart are cut in the simulation: some 1e-3
    np.testing.assert_allclose(motion.angular_impulse_n_m_s[-1], gain, rtol=5e-3, atol=0.02)


def oracle(motion: Motion, torque_limit: float) -> Array:
    """ω and ρ at the end from Euler's equation in its inertial form, integrated by DOP853.

    State: q, ρ, total body momentum h with ḣ = −ω × h; ω solved from h at every call.
    """
    body = motion.body
    target = np.array(TUMBLE["to_rpm"]) / 60.0 * 2.0 * math.pi

    def rates(y: Array) -> Array:
        spin = body.axes @ (body.wheel_inertia_kg_m2 * y[3:])
        return np.linalg.solve(body.inertia_kg_m2, y[:3] - spin)

    def slope(_: float, y: Array) -> Array:
        omega = rates(y)
        h_dot = -np.cross(omega, y[:3])
        wheel = np.sign(target - y[3:]) * torque_limit
        # I ω̇ + A I_w ρ̇ = ḣ and I_w (ρ̇ + Aᵀ ω̇) = u, as one linear system
        size = 3 + len(wheel)
        matrix = np.zeros((size, size))
        matrix[:3, :3] = body.inertia_kg_m2
        matrix[:3, 3:] = body.axes * body.wheel_inertia_kg_m2
        matrix[3:, :3] = (body.axes * body.wheel_inertia_kg_m2).T
        matrix[3:, 3:] = np.diag(body.wheel_inertia_kg_m2)
        solution = np.linalg.solve(matrix, np.concatenate([h_dot, wheel]))
        return np.concatenate([h_dot, solution[3:]])

    begin = np.concatenate([motion.momentum_body_n_m_s()[0], motion.wheels_rad_s[0]])
    end = solve_ivp(
        slope, (0.0, motion.duration_s), begin, method="DOP853", rtol=1e-12, atol=1e-12
    ).y[:, -1]
    return np.concatenate([rates(end), end[3:]])


def test_rates_and_wheels_agree_with_an_independent_integration() -> None:
    """A tumbling body with accelerating wheels against DOP853 of the momentum form: 1e-9."""
    motion = run(make_plan(TUMBLE, start=StartSettings(rate_rad_s=0.03)), record_s=0.5)
    got = np.concatenate([motion.rate_rad_s[-1], motion.wheels_rad_s[-1]])
    np.testing.assert_allclose(got, oracle(motion, 0.03), rtol=1e-9)


def test_halving_the_step_shows_the_fourth_order() -> None:
    """Error against a much finer step falls sixteen-fold with every halving."""
    plan = make_plan(
        TUMBLE,
        start=StartSettings(rate_rad_s=0.1),
        appendages=(ANTENNA.model_copy(update={"frequency_hz": 0.05, "initial_rate_rad_s": 0.1}),),
    )
    ends = []
    for step in (2.0, 1.0, 0.5, 0.0625):
        motion = run(plan, step_s=step, cycle_s=2.0, record_s=2.0)
        ends.append(np.concatenate([motion.attitude[-1], motion.rate_rad_s[-1]]))
    errors = [float(np.linalg.norm(end - ends[-1])) for end in ends[:3]]
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert all(3.7 < order < 4.4 for order in orders), (errors, orders)


def test_a_clamped_mode_rings_at_its_free_frequency_and_decays() -> None:
    """On a free body a clamped mode (Ω, ζ) rings at Ω/√(1−μ), μ its share of the inertia."""
    share = 300.0 / 5393.0
    mode = Appendage(
        name="boom",
        axis=(0.0, 1.0, 0.0),
        inertia_kg_m2=300.0,
        frequency_hz=0.2,
        damping=0.01,
        initial_rate_rad_s=1e-3,
    )
    diagonal = {f"inertia_{element}_kg_m2": 0.0 for element in ("xy", "xz", "yz")}
    quiet = {"id": "quiet", "kind": "delta_v", "from_rpm": (0.0, 0.0, 0.0), "duration_s": 100.0}
    plan = make_plan(
        {**quiet, "thrusters_on": False},
        parameters=diagonal,
        appendages=(mode,),
        start=StartSettings(attitude_spread=0.0),
    )
    motion = run(plan)
    assert motion.rate_rad_s[0, 1] == pytest.approx(-share * 1e-3)
    # free wheels take their axial part of the body's acceleration: a slightly lighter body
    axial = float(np.sum(motion.body.axes[1] ** 2 * motion.body.wheel_inertia_kg_m2))
    factor = 1.0 - 300.0 / (5393.0 - axial)
    omega = 2.0 * math.pi * 0.2 / math.sqrt(factor)
    zeta = 0.01 / math.sqrt(factor)
    damped = omega * math.sqrt(1.0 - zeta**2)
    time = motion.time_s
    ring = np.exp(-zeta * omega * time) * (
        np.cos(damped * time) - zeta / math.sqrt(1.0 - zeta**2) * np.sin(damped * time)
    )
    np.testing.assert_allclose(
        motion.rate_rad_s[:, 1], -share * 1e-3 * ring, atol=1e-3 * share * 1e-2
    )


def test_an_inertia_smaller_than_its_wheels_is_refused() -> None:
    """An inertia that cannot hold its wheels is an input error, not a NaN."""
    tiny = {f"inertia_{e}_kg_m2": 0.05 for e in ("xx", "yy", "zz")}
    with pytest.raises(InputError, match="positive definite"):
        run(make_plan(parameters=tiny))


def test_a_step_that_does_not_divide_the_cycle_is_refused() -> None:
    """Steps fit whole numbers of times into a control cycle."""
    with pytest.raises(InputError, match="divides"):
        Steps.of(0.007, 0.125, 0.125)
