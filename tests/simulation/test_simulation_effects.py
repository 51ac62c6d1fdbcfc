"""Every effect by name: it does what it says, leaves the noise alone, and bad ones are refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulation_cases import BIAS, PARAMETERS, make_plan, run
from simulation_cases import EFFECT_CASES as CASES
from spacecraft_cases import TWELVE, middle, priors_of

from cassini_bayes.balance.physics import physics_of
from cassini_bayes.effects.catalogue import read_catalogue
from cassini_bayes.errors import InputError
from cassini_bayes.simulation import EFFECTS, EffectRequest, choose_effect, observe
from cassini_bayes.simulation.arrays import make_body, make_thrusters
from cassini_bayes.simulation.plan import Plan, frozen_mapping
from cassini_bayes.simulation.settings import StartSettings, TelemetrySettings
from cassini_bayes.spacecraft import load_spacecraft
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

SMALL = {**BIAS, "to_rpm": (-918.0, 1200.0, 250.0), "settle_s": 60.0}
NOISE = {f"rate_bias_{axis}_rad_s": 0.0 for axis in "xyz"}


def chosen(name: str, values: Mapping[str, Any], plan: Plan) -> Plan:
    """The plan with one effect."""
    request = EffectRequest(name=name, parameters=dict(values))
    effect = choose_effect(request, plan.spacecraft, plan.branch, plan.wheel_numbers, "effect")
    return effect.applied(plan)


def bias_plan() -> Plan:
    """A short bias with noisy channels."""
    return make_plan(SMALL, parameters=NOISE)


def settings() -> TelemetrySettings:
    """Noise on every channel."""
    return TelemetrySettings(attitude_noise_rad=1e-5, rate_noise_rad_s=1e-6, wheel_noise_rpm=0.2)


def columns(plan: Plan) -> dict[str, np.ndarray]:
    """Telemetry of a plan, seed 5, rates without the true motion under the key ``noise``."""
    motion = run(plan, record_s=0.5)
    seen = observe(plan, motion, settings(), seed=5)
    return {**seen.columns, "true_rate": motion.rate_rad_s[::2]}


def test_all_causes_of_the_catalogue_and_four_others_are_there() -> None:
    """Names of the telemetry format's table of causes, and effects that no diagnosis knows."""
    catalogue = {
        "thrust_scale",
        "thruster_degraded",
        "thrust_warmup",
        "tail_off",
        "pulse_shape",
        "center_of_mass",
        "wheel_inertia",
        "wheel_alignment",
        "wheel_articulation",
        "thruster_misalignment",
        "external_torque",
        "thruster_leak",
        "inertia",
        "time_offset",
        "rate_bias",
        "rate_scale",
        "flexible_mode",
        "firing_logic",
    }
    assert {name for name, effect in EFFECTS.items() if effect.catalogued} == catalogue
    assert len([effect for effect in EFFECTS.values() if not effect.catalogued]) >= 3
    assert {name.split(":")[0] for name in CASES} == set(EFFECTS)


@pytest.mark.parametrize("name", list(CASES))
def test_an_effect_changes_telemetry_but_not_the_noise(name: str) -> None:
    """Something in telemetry differs from the baseline; rate noise draws are those of before."""
    base, changed = columns(bias_plan()), columns(chosen(name, CASES[name], bias_plan()))
    shared = [key for key in base if key in changed and base[key].shape == changed[key].shape]
    assert any(
        not np.array_equal(base[key], changed[key], equal_nan=True)
        for key in shared
        if key != "true_rate"
    )
    for axis, letter in enumerate("xyz"):
        scale = 1.02 if name == f"rate_scale:{letter}" else 1.0
        bias = 1e-5 if name == f"rate_bias:{letter}" else 0.0
        noise = base[f"rate_{letter}_rad_s"] - base["true_rate"][:, axis]
        other = changed[f"rate_{letter}_rad_s"] - scale * changed["true_rate"][:, axis] - bias
        np.testing.assert_allclose(noise, other, atol=1e-15)


def test_each_effect_acts_where_it_says() -> None:
    """Sizes arrive in the arrays of the integrator."""
    plan = bias_plan()
    base = make_thrusters(plan)
    scaled = make_thrusters(chosen("thrust_scale", {"thrust_factor": 0.9}, plan))
    np.testing.assert_allclose(scaled.thrust_n, 0.9 * base.thrust_n)
    degraded = make_thrusters(chosen("thruster_degraded:z3", {"thrust_factor": 0.77}, plan))
    assert degraded.thrust_n.tolist() == pytest.approx([0.75, 0.75, 0.77 * 0.75, *[0.75] * 5])
    canted = make_thrusters(
        chosen("thruster_misalignment:y2", CASES["thruster_misalignment:y2"], plan)
    )
    expected = np.array([0.02, -1.0, -0.03])
    np.testing.assert_allclose(canted.directions[:, 5], expected / np.linalg.norm(expected))
    shifted = make_thrusters(chosen("center_of_mass:y", {"cm_y_m": 0.10}, plan))
    np.testing.assert_allclose(shifted.levers_m[0, :2] - base.levers_m[0, :2], 0.043, atol=1e-12)
    body = make_body(chosen("wheel_inertia:2", {"rwa2_inertia_kg_m2": 0.166}, plan))
    assert body.wheel_inertia_kg_m2.tolist() == [0.161, 0.166, 0.16]
    heavy = make_body(chosen("inertia:xz", {"inertia_xz_kg_m2": 50.0}, plan))
    assert heavy.inertia_kg_m2[0, 2] == heavy.inertia_kg_m2[2, 0] == 50.0


def test_a_warm_up_follows_its_formula() -> None:
    """Impulse with warm-up = Σ F (1 − d exp(−t_on/t_w)) per pulse, t_on at the pulse."""
    plan = chosen("thrust_warmup", {"warmup_deficit": 0.3, "warmup_time_s": 2.0}, bias_plan())
    motion = run(plan)
    shape = PULSE_SHAPES["first_order"]
    taus = [PARAMETERS[f"tau_{which}_s"] for which in ("delay", "rise", "fall")]
    expected = 0.0
    for name in ("z1", "z2", "z3", "z4"):
        log = motion.pulses[name]
        before = np.concatenate([[0.0], np.cumsum(log.width_s)])
        middle = 0.5 * (before[1:] + before[:-1])
        factor = 1.0 - 0.3 * np.exp(-middle / 2.0)
        expected += 0.75 * float(np.sum(factor * shape.effective_time(log.width_s, *taus)))
    delivered = -motion.delta_v_body_m_s[-1, 2] * 2400.0
    assert delivered == pytest.approx(expected, rel=0.02)


def twelve_plan() -> Plan:
    """A plan of the made-up spacecraft with canted thrusters, parameters at their prior means."""
    return replace(
        make_plan(wheels=(1, 2, 3, 5)),
        spacecraft=load_spacecraft(TWELVE),
        branch="P",
        parameters=frozen_mapping({**PARAMETERS, **middle("twelve")}),
    )


@pytest.mark.parametrize("thruster", ["p1", "p3", "r1", "r4", "v1"])
def test_a_cant_is_the_same_flown_and_diagnosed(thruster: str) -> None:
    """Lever arms of oblique thrusters: the simulation's are those of the catalogue's effect. Either
    cant moves the arm alone.
    """
    plan, priors = twelve_plan(), priors_of("twelve")
    plan = replace(plan, thrust_n=frozen_mapping(dict.fromkeys(plan.thrusters, 1.0)))
    name = f"thruster_misalignment:{thruster}"
    effect = read_catalogue(priors, (1, 2, 3, 5), ("telemetry", "totals")).effect(name)
    modify = effect.modifier(plan.spacecraft, plan.branch)
    k, plain = plan.thrusters.index(thruster), make_thrusters(plan).levers_m
    for cants in ((0.04, -0.03), (0.04, 0.0), (0.0, -0.03)):
        flown = make_thrusters(
            chosen(name, dict(zip(("cant_a_rad", "cant_b_rad"), cants, strict=True)), plan)
        ).levers_m
        point = {key: np.array([value]) for key, value in middle("twelve").items()}
        for parameter, value in zip(effect.parameters, cants, strict=True):
            point[parameter.name] = np.array([value])
        arms = physics_of(plan.spacecraft, plan.branch, point, (modify,)).arms_m[0]
        np.testing.assert_allclose(arms, flown, atol=1e-12)
        assert np.linalg.norm(flown[:, k] - plain[:, k]) > 0.01


def test_an_effect_on_a_wheel_changes_that_wheel_alone_whatever_its_parameters_are_called() -> None:
    """Twelve's wheels 1 and 2 share an inertia, wheel 5 tilts under names of its own; before, both
    effects set parameters that its file does not have, and changed nothing.
    """
    plan = twelve_plan()
    plain = make_body(plan)
    heavy = make_body(chosen("wheel_inertia:2", {"rwa2_inertia_kg_m2": 0.3}, plan))
    changed = heavy.wheel_inertia_kg_m2 != plain.wheel_inertia_kg_m2
    assert changed.tolist() == [False, True, False, False]
    assert heavy.wheel_inertia_kg_m2[1] == 0.3
    tilt = {"rwa5_tilt_u_rad": 0.05, "rwa5_tilt_v_rad": 0.0}
    tilted = make_body(chosen("wheel_alignment:5", tilt, plan))
    assert (tilted.axes != plain.axes).any(axis=0).tolist() == [False, False, False, True]


def test_a_leak_pushes_all_the_time() -> None:
    """A valve that leaks F for the whole event gives F t / M, seen where no thruster fires."""
    event = {"id": "q", "kind": "quiescent", "from_rpm": (0.0, 0.0, 0.0), "duration_s": 100.0}
    motion = run(chosen("thruster_leak:z1", {"leak_n": 0.01}, make_plan(event)), record_s=1.0)
    assert motion.delta_v_body_m_s[-1, 2] == pytest.approx(-0.01 * 100.0 / 2400.0, rel=1e-4)
    control = run(make_plan(event), record_s=1.0)
    assert control.delta_v_body_m_s[-1, 2] == 0.0


def test_a_leak_may_begin_later() -> None:
    """Of 100 s the leak has the last 40; without a start the truth does not tell one."""
    event = {"id": "q", "kind": "quiescent", "from_rpm": (0.0, 0.0, 0.0), "duration_s": 100.0}
    values = {"leak_n": 0.01, "start_s": 60.0}
    motion = run(chosen("thruster_leak:z1", values, make_plan(event)), record_s=1.0)
    assert motion.delta_v_body_m_s[60, 2] == 0.0
    assert motion.delta_v_body_m_s[-1, 2] == pytest.approx(-0.01 * 40.0 / 2400.0, rel=1e-3)
    spacecraft = make_plan(event).spacecraft
    request = EffectRequest(name="thruster_leak:z1", parameters={"leak_n": 0.01})
    effect = choose_effect(request, spacecraft, "B", (1, 2, 4), "effect")
    assert dict(effect.values) == {"leak_n": 0.01}


@pytest.mark.parametrize("phase", [0.0, 0.7, 4.0])
def test_a_flexible_mode_shows_its_frequency_amplitude_and_phase(phase: float) -> None:
    """Rates of a quiet body oscillate at the given frequency, amplitude, damping and phase."""
    event = {
        "id": "quiet",
        "kind": "delta_v",
        "thrusters_on": False,
        "from_rpm": (0.0, 0.0, 0.0),
        "duration_s": 200.0,
    }
    diagonal = {f"inertia_{element}_kg_m2": 0.0 for element in ("xy", "xz", "yz")}
    plan = make_plan(event, parameters=diagonal, start=StartSettings(attitude_spread=0.0))
    values = {"frequency_hz": 0.13, "damping": 0.005, "amplitude_rad_s": 2e-5, "phase_rad": phase}
    motion = run(chosen("flexible_mode", values, plan))
    omega = 2.0 * np.pi * 0.13
    decay = np.exp(-0.005 * omega * motion.time_s)
    expected = -2e-5 * decay * np.cos(omega * motion.time_s + phase)
    np.testing.assert_allclose(motion.rate_rad_s[:, 2], expected, atol=4e-7)


def test_counters_shown_late_are_those_of_earlier() -> None:
    """A record stamped t shows the counters of t − offset, at sub-sample accuracy."""
    plan = bias_plan()
    motion = run(plan, record_s=0.5)
    late = chosen("time_offset", {"time_offset_s": 2.0}, plan)
    base, shown = (observe(p, motion, settings(), seed=5).columns for p in (plan, late))
    np.testing.assert_array_equal(shown["pulses_z1"][2:], base["pulses_z1"][:-2])
    np.testing.assert_allclose(shown["on_time_z1_s"][2:], base["on_time_z1_s"][:-2], atol=1e-12)


def test_a_tachometer_that_depends_on_speed() -> None:
    """Read = ρ (1 + slope |ρ|): 1000 rpm read 5 rpm too high at 5e-6 per rpm."""
    plan = chosen("tachometer_scale", {"slope_per_rpm": 5e-6}, bias_plan())
    motion = run(plan, record_s=1.0)
    read = observe(plan, motion, TelemetrySettings(), seed=1).columns["rwa2_rpm"]
    true = motion.wheels_rpm[:, 1]
    np.testing.assert_allclose(read - true, 5e-6 * true * np.abs(true), atol=1e-9)


def test_an_effect_can_be_confined_to_some_events() -> None:
    """In other events the plan stays the same object."""
    plan = bias_plan()
    request = EffectRequest(name="thrust_scale", parameters={"thrust_factor": 2.0}, events=("x",))
    effect = choose_effect(request, plan.spacecraft, "B", (1, 2, 4), "effect")
    assert effect.applied(plan) is plan


@pytest.mark.parametrize(
    ("name", "values", "hint"),
    [
        ("thrust_scal", {}, "thrust_scale"),
        ("thruster_leak:z9", {"leak_n": 0.1}, "z1"),
        ("thruster_leak", {"leak_n": 0.1}, "thruster_leak:<thruster>"),
        ("thrust_scale:z1", {"thrust_factor": 1.0}, "drop the colon"),
        ("thrust_scale", {}, "add thrust_factor"),
        ("thrust_scale", {"thrust_facto": 1.0}, "thrust_factor"),
        ("thrust_scale", {"thrust_factor": "1"}, "plain number"),
        ("thrust_scale", {"thrust_factor": -1.0}, "above 0"),
        ("thruster_leak:z1", {"leak_n": float("nan")}, "finite"),
        ("wheel_alignment:1", {"rwa1_tilt_u_rad": 0.0, "rwa1_tilt_v_rad": 0.0}, "4"),
        ("wheel_articulation:2", {"rwa2_articulation_rad": 0.0}, "4"),
        ("inertia:xx", {"inertia_xx_kg_m2": 0.0}, "positive"),
        ("thrust_warmup", {"warmup_deficit": 1.5, "warmup_time_s": 1.0}, "fraction"),
        ("pressure_surge", {"thrust_fraction": -1, "start_s": 0, "decay_s": 1}, "no thrust"),
        (
            "flexible_mode",
            {"frequency_hz": 1, "damping": 0, "amplitude_rad_s": 0, "axis": 3},
            "x, y",
        ),
    ],
)
def test_a_bad_effect_is_refused(name: str, values: dict[str, Any], hint: str) -> None:
    """Where, what was expected, what was found, the nearest name."""
    request = EffectRequest(name=name, parameters=values)
    with pytest.raises(InputError, match=hint) as caught:
        choose_effect(request, load_spacecraft("cassini"), "B", (1, 2, 4), "s.toml: effect.0")
    assert str(caught.value).startswith("s.toml: effect.0.")
