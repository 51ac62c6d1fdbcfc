"""What a pulse delivers in the simulation: the closed form of its shape, whatever the step."""

from __future__ import annotations

import numpy as np
import pytest
from simulation_cases import BIAS, PARAMETERS, make_plan, run

from cassini_bayes.errors import InputError
from cassini_bayes.simulation import kernel
from cassini_bayes.simulation.arrays import make_thrusters
from cassini_bayes.simulation.settings import PropulsionSettings, RcsSettings
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

TAUS = tuple(PARAMETERS[f"tau_{which}_s"] for which in ("delay", "rise", "fall"))
SHAPES = ("rectangular", "first_order", "first_order_held", "published_2005")
WIDTHS_S = (0.007, 0.0333, 0.125, 0.25, 0.5, 0.75)


def delivered(starts: list[float], widths: list[float], shape: str, step: float) -> float:
    """Effective time that the compiled thrust model delivers for some pulses of one thruster."""
    thrusters = make_thrusters(make_plan(propulsion=PropulsionSettings(pulse_shape=shape)))
    on, width = np.array(starts), np.array(widths)
    level = total = 0.0
    for i in range(round(3.0 / step)):
        time = i * step
        count = int(np.sum(on <= time))
        if count == 0:
            continue
        level, gained = kernel.thrust_step(level, time, step, on, width, count, thrusters)
        total += gained
    return total


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("step_s", [0.005, 0.0025, 0.0125])
def test_a_single_pulse_delivers_the_closed_form(shape: str, step_s: float) -> None:
    """7 to 750 ms, all shapes, steps that do and do not divide the edges: 1e-6."""
    for width in WIDTHS_S:
        expected = float(PULSE_SHAPES[shape].effective_time(width, *TAUS))
        assert delivered([0.25], [width], shape, step_s) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_thrust_curve_is_followed_in_time(shape: str) -> None:
    """Thrust level after every step equals the shape's thrust curve."""
    thrusters = make_thrusters(make_plan(propulsion=PropulsionSettings(pulse_shape=shape)))
    on, width = np.array([0.0]), np.array([0.0831])
    level = 0.0
    for i in range(60):
        level, _ = kernel.thrust_step(level, i * 0.005, 0.005, on, width, 1, thrusters)
        time = (i + 1) * 0.005
        expected = PULSE_SHAPES[shape].thrust_fraction(time - 1e-9, width[0], *TAUS)
        assert level == pytest.approx(float(expected), abs=2e-7), time


def test_a_pulse_that_follows_one_cycle_later_cuts_the_tail() -> None:
    """Two pulses 125 ms apart deliver less than two single ones, by F0 (τ_f − τ_r) of the tail."""
    _, rise, fall = TAUS
    shape = PULSE_SHAPES["first_order"]
    single = float(shape.effective_time(0.125, *TAUS))
    both = delivered([0.25, 0.5], [0.125, 0.125], "first_order", 0.005)
    left = (1.0 - np.exp(-0.125 / rise)) * np.exp(-0.125 / fall)
    # the residue left starts the rise higher; what it had in its tail is lost
    gained = left * rise * (1.0 - np.exp(-0.125 / rise))
    tail = left * fall
    more_at_off = left * np.exp(-0.125 / rise) * fall
    assert both == pytest.approx(2 * single - tail + gained + more_at_off, rel=1e-9)
    assert 0.0 < 1.0 - both / (2 * single) < 0.01


@pytest.mark.parametrize(("width_s", "offset_s"), [(0.125, 0.01), (0.016, 0.04), (0.125, -0.03)])
def test_with_an_offset_every_pulse_goes_on_for_longer(width_s: float, offset_s: float) -> None:
    """It gives what one of width w + c gives: a short pulse rises on, and gains more than c."""
    thrusters = make_thrusters(make_plan(impulse_offset_s=offset_s))
    on, width = np.array([0.0]), np.array([width_s])
    level = total = 0.0
    for i in range(200):
        level, gained = kernel.thrust_step(level, i * 0.005, 0.005, on, width, 1, thrusters)
        total += gained
    shape = PULSE_SHAPES["first_order"]
    plain, longer = (float(shape.effective_time(w, *TAUS)) for w in (width_s, width_s + offset_s))
    assert total == pytest.approx(longer, rel=1e-6)
    assert (abs(longer - plain) > 1.1 * abs(offset_s)) == (width_s < 0.1)


def test_propellant_and_delta_v_follow_the_pulses_of_a_whole_event() -> None:
    """m = Σ F eff / (g I_sp) and M ΔV_z = −Σ F eff over a bias whose tails are never cut."""
    plan = make_plan(
        {**BIAS, "from_rpm": (0.0, 0.0, 0.0), "to_rpm": (100.0, -80.0, 60.0)},
        propulsion=PropulsionSettings(ullage_m3=1e9, isp_s=(200.0, 15.0, 0.0, 5.0, 0.0)),
        rcs=RcsSettings(rate_gain_s=20.0, attitude_knowledge_rad=0.0, rate_knowledge_rad_s=0.0),
    )
    motion = run(plan, seed=3)  # a seed without pulses close together: checked below
    shape = PULSE_SHAPES["first_order"]
    force = {}
    for name, log in motion.pulses.items():
        if log.start_s.size > 1:
            assert np.diff(log.start_s).min() > 1.0
        force[name] = 0.75 * float(np.sum(shape.effective_time(log.width_s, *TAUS)))
        # the last pulse may still be tailing off at the end
        assert np.all(log.start_s < motion.duration_s - 1.0)
    assert sum(force.values()) > 3.0
    mass = sum(force.values()) / (kernel.STANDARD_GRAVITY_M_S2 * 180.0)
    assert motion.propellant_kg[-1] == pytest.approx(mass, rel=1e-6)
    expected = -sum(force[name] for name in ("z1", "z2", "z3", "z4")) / 2400.0
    assert motion.delta_v_body_m_s[-1, 2] == pytest.approx(expected, rel=1e-5)


def test_hydrazine_follows_the_specific_impulse_of_the_duty_cycle() -> None:
    """Σ F Δimpulse/(g I_sp(μ)), μ the thruster's own on-time so far over the time so far.

    Written down from the pulse log on a fine grid; with the duty cycle left out it differs.
    """
    isp = (174.1, 22.8, 33.3, 30.0, 400.0)
    event = {**BIAS, "from_rpm": (0.0, 0.0, 0.0), "to_rpm": (100.0, -80.0, 60.0)}
    settings = PropulsionSettings(ullage_m3=1e9, isp_s=isp)
    motion = run(make_plan(event, propulsion=settings, rcs=RcsSettings(rate_gain_s=20.0)))
    shape = PULSE_SHAPES["first_order"]
    fine = 5e-4
    grams = {"duty": 0.0, "plateau": 0.0}
    for log in motion.pulses.values():
        for start, width in zip(log.start_s, log.width_s, strict=True):
            time = start + fine * (np.arange(2000) + 0.5)
            thrust = 0.75 * shape.thrust_fraction(time - start, width, *TAUS)
            duty = log.on_time_s(time) / time
            curve = isp[0] - isp[1] * np.exp(-isp[2] * duty) - isp[3] * np.exp(-isp[4] * duty)
            grams["duty"] += 1e3 * fine * float(np.sum(thrust / (9.80665 * curve)))
            grams["plateau"] += 1e3 * fine * float(np.sum(thrust / (9.80665 * isp[0])))
    used = 1e3 * motion.propellant_kg[-1]
    assert used == pytest.approx(grams["duty"], rel=2e-3)
    assert used > 1.05 * grams["plateau"]


def test_a_shape_without_a_response_is_refused() -> None:
    """The shape whose rise outlasts the command cannot be simulated, and neither can a typo."""
    for name in ("published_2012", "first_oder"):
        with pytest.raises(InputError, match="first_order"):
            make_thrusters(make_plan(propulsion=PropulsionSettings(pulse_shape=name)))
