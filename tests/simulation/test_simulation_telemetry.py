"""Telemetry of a motion: channels, rates, noise, resolution, drop-outs, totals."""

from __future__ import annotations

import csv
import io
import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulation_cases import BIAS, SLEWS, make_plan, run

from cassini_bayes.errors import InputError
from cassini_bayes.simulation import Effect, event_text, observe, telemetry_text, totals_row
from cassini_bayes.simulation.effects import ELEMENTS
from cassini_bayes.simulation.kernel import STANDARD_GRAVITY_M_S2
from cassini_bayes.simulation.motion import PulseLog
from cassini_bayes.simulation.settings import (
    PropulsionSettings,
    RcsSettings,
    StartSettings,
    TelemetrySettings,
    WheelSettings,
)
from cassini_bayes.simulation.telemetry import record_interval_s, stepped

SHORT = {**BIAS, "to_rpm": (-918.0, 1200.0, 250.0), "settle_s": 30.0}
BIASES = {f"rate_bias_{axis}_rad_s": 0.0 for axis in "xyz"}
FSW = {"thrust_common_n": 0.75, "mass_factor": 1.0, "fsw_impulse_offset_s": 0.0109}


def test_every_channel_has_its_own_rate() -> None:
    """Cells are there at multiples of the channel's interval, empty elsewhere, rows never empty."""
    plan = make_plan(SHORT, parameters=BIASES)
    channels = TelemetrySettings(
        attitude_every_s=4.0, rate_every_s=1.5, wheel_every_s=2.0, counter_every_s=10.0
    )
    motion = run(plan, record_s=record_interval_s(channels))
    seen = observe(plan, motion, channels, seed=1)
    for name, every in (("q1", 4.0), ("rate_x_rad_s", 1.5), ("rwa4_rpm", 2.0), ("pulses_y1", 10.0)):
        expected = np.isclose(seen.time_s / every, np.round(seen.time_s / every))
        np.testing.assert_array_equal(~np.isnan(seen.columns[name]), expected)
    filled = ~np.isnan(np.stack(list(seen.columns.values())))
    assert filled.any(axis=0).all()
    assert np.all(np.diff(seen.time_s) > 0.0)


def test_noise_has_its_size_and_resolution_its_step() -> None:
    """Standard deviation of what the channel adds, within 10 %; steps are whole."""
    plan = make_plan(SHORT, parameters=BIASES)
    channels = TelemetrySettings(
        attitude_every_s=0.5,
        rate_every_s=0.5,
        wheel_every_s=0.5,
        attitude_noise_rad=3e-5,
        rate_noise_rad_s=2e-6,
        wheel_noise_rpm=0.7,
        wheel_resolution_rpm=0.25,
    )
    motion = run(plan, record_s=0.5)
    seen = observe(plan, motion, channels, seed=3).columns
    rate = np.stack([seen[f"rate_{axis}_rad_s"] for axis in "xyz"], axis=1) - motion.rate_rad_s
    assert np.std(rate) == pytest.approx(2e-6, rel=0.1)
    wheels = np.stack([seen[f"rwa{n}_rpm"] for n in (1, 2, 4)], axis=1)
    np.testing.assert_allclose(wheels / 0.25, np.round(wheels / 0.25), atol=1e-9)
    spread = np.std(wheels - motion.wheels_rpm)
    assert spread == pytest.approx(np.hypot(0.7, 0.25 / np.sqrt(12.0)), rel=0.1)
    attitude = np.stack([seen[f"q{i}"] for i in range(1, 5)], axis=1)
    np.testing.assert_allclose(np.linalg.norm(attitude, axis=1), 1.0, atol=1e-12)
    angle = 2.0 * np.abs(np.sum(attitude * motion.attitude, axis=1))
    size = 2.0 * np.arccos(np.clip(angle / 2.0, 0.0, 1.0))
    assert np.sqrt(np.mean(size**2) / 3.0) == pytest.approx(3e-5, rel=0.15)


def test_drop_outs_leave_the_first_row_and_the_other_values_alone() -> None:
    """A fraction of the cells is missing; those that stay are the same as without drop-outs."""
    plan = make_plan(SHORT, parameters=BIASES)
    motion = run(plan, record_s=0.5)
    whole = observe(plan, motion, TelemetrySettings(rate_noise_rad_s=1e-6), seed=2)
    holes = observe(plan, motion, TelemetrySettings(rate_noise_rad_s=1e-6, drop_out=0.3), seed=2)
    rate = holes.columns["rate_x_rad_s"]
    kept = ~np.isnan(rate)
    assert 0.55 < np.mean(kept) < 0.85
    assert kept[0]
    same = np.isin(whole.time_s, holes.time_s)
    np.testing.assert_array_equal(rate[kept], whole.columns["rate_x_rad_s"][same][kept])


def test_a_running_pulse_counts_as_far_as_it_went() -> None:
    """On-times as commanded up to the sample time; a pulse counts from its start; never earlier."""
    log = PulseLog(np.array([1.0, 3.0]), np.array([0.25, 0.125]))
    time = np.array([-1.0, 0.5, 1.0, 1.1, 1.25, 2.0, 3.05, 9.0])
    np.testing.assert_allclose(log.on_time_s(time), [0, 0, 0, 0.1, 0.25, 0.25, 0.3, 0.375])
    np.testing.assert_array_equal(log.pulses(time), [0, 0, 1, 1, 1, 1, 2, 2])
    empty = PulseLog(np.zeros(0), np.zeros(0))
    assert empty.on_time_s(time).tolist() == empty.pulses(time).tolist() == [0.0] * 8


def test_the_event_folder_is_as_the_format_says() -> None:
    """event.toml has the obligatory keys; telemetry.csv its columns; a slew has no counters."""
    channels = TelemetrySettings(delta_v="computed")
    plan = make_plan(SHORT, parameters={**BIASES, **FSW})
    document = tomllib.loads(event_text(plan, channels))
    assert document == {
        "id": "bias",
        "kind": "bias",
        "epoch": "2010-01-01T00:00:00Z",
        "branch": "B",
        "wheels": [1, 2, 4],
        "delta_v_source": "computed",
        "source": "simulation",
    }
    text = telemetry_text(observe(plan, run(plan, record_s=1.0), channels, seed=1))
    rows = list(csv.DictReader(io.StringIO(text)))
    thrusters = ("z1", "z2", "z3", "z4", "y1", "y2", "y3", "y4")
    assert set(rows[0]) == {
        "time_s",
        *(f"q{i}" for i in range(1, 5)),
        *(f"rate_{axis}_rad_s" for axis in "xyz"),
        *(f"rwa{n}_rpm" for n in (1, 2, 4)),
        *(f"on_time_{k}_s" for k in thrusters),
        *(f"pulses_{k}" for k in thrusters),
        *(f"delta_v_{axis}_m_s" for axis in "xyz"),
    }
    assert "" not in (rows[0]["q1"], rows[10]["delta_v_z_m_s"])
    assert rows[1]["delta_v_z_m_s"] == ""
    slew = make_plan(
        {"id": "s", "kind": "slew", "from_rpm": (0.0, 0.0, 0.0), "slew": SLEWS[:1]},
        parameters=BIASES,
    )
    seen = observe(slew, run(slew, record_s=1.0), channels, seed=1)
    assert not [name for name in seen.columns if name.startswith(("on_time", "pulses", "delta_v"))]
    assert "delta_v_source" not in tomllib.loads(event_text(slew, channels))


def test_totals_follow_from_the_counters() -> None:
    """On-times, pulses, computed ΔV and hydrazine of a bias, each by its own formula."""
    plan = make_plan(
        SHORT,
        parameters={**BIASES, **FSW},
        propulsion=PropulsionSettings(isp_s=(175.0, 0.0, 0.0, 0.0, 0.0)),
    )
    motion = run(plan, record_s=1.0)
    row = totals_row(plan, motion, TelemetrySettings(delta_v="computed", delta_v_every_s=1.0), 1)
    on_time = np.array([log.width_s.sum() for log in motion.pulses.values()])
    pulses = np.array([log.width_s.size for log in motion.pulses.values()])
    np.testing.assert_allclose(row["on_time_s"], on_time, atol=1e-12)
    np.testing.assert_array_equal(row["pulses"], pulses)
    delta_v = -0.75 / 2400.0 * np.sum((on_time + 0.0109 * pulses)[:4])
    assert row["delta_v_m_s"][2] == pytest.approx(delta_v, rel=0.05)
    grams = 1000.0 * 0.75 * on_time.sum() / (STANDARD_GRAVITY_M_S2 * 175.0)
    assert row["hydrazine_g"] == pytest.approx(grams, rel=1e-12)


@pytest.mark.parametrize("kind", ["computed", "measured"])
def test_totals_have_the_velocity_change_of_the_end(kind: str) -> None:
    """Whether or not a row tells it: with an interval that does not divide the duration, or with
    drop-outs, it had been that of the last sample, which is another.
    """
    plan = make_plan({**SHORT, "duration_s": 77.0}, parameters={**BIASES, **FSW})
    motion = run(plan, record_s=1.0)
    noisy = {"delta_v": kind, "delta_v_noise_m_s": 1e-5, "delta_v_resolution_m_s": 1e-6}
    sampled = TelemetrySettings.model_validate({**noisy, "delta_v_every_s": 1.0})
    rows = observe(plan, motion, sampled, 3).columns
    end = [rows[f"delta_v_{axis}_m_s"][-1] for axis in "xyz"]
    for telling in ({"delta_v_every_s": 1.0}, {"delta_v_every_s": 50.0}, {"drop_out": 0.9}):
        settings = TelemetrySettings.model_validate({**noisy, **telling})
        row = totals_row(plan, motion, settings, 3)
        np.testing.assert_array_equal(row["delta_v_m_s"], end)
    true = motion.delta_v_body_m_s[:, 2]
    assert end[2] == pytest.approx(true[-1], rel=0.1)
    assert abs(true[50] / true[-1] - 1.0) > 0.2  # what a row at 50 s would tell


def test_totals_tell_the_rates_that_wheels_have() -> None:
    """The commanded ones where they were reached; the true ones, in steps of telemetry, where an
    event ends too early or drag leaves wheels short. A step wider than that hides it.
    """
    drag = {"drag_viscous_n_m_s": 5e-5, "drag_compensation": 0.5}
    cases = (
        (SHORT, WheelSettings()),
        ({**SHORT, "duration_s": 40.0}, WheelSettings()),
        (SHORT, WheelSettings.model_validate(drag)),
    )
    rows, motions = [], []
    for event, manager in cases:
        plan = make_plan(event, parameters={**BIASES, **FSW}, manager=manager)
        motions.append(run(plan, record_s=1.0))
        for step in (0.25, 500.0):
            settings = TelemetrySettings(wheel_resolution_rpm=step)
            rows.append(totals_row(plan, motions[-1], settings, 1)["rwa_end_rpm"])
    for commanded in (rows[0], *rows[1::2]):
        assert commanded.tolist() == list(SHORT["to_rpm"])
    for told, motion in zip(rows[2::2], motions[1:], strict=True):
        assert np.abs(told - motion.wheels_rpm[-1]).max() <= 0.125 + 1e-9
        assert np.abs(told - SHORT["to_rpm"]).min() > 0.7


@pytest.mark.parametrize("interval", [0.0123, 0.0005])
def test_an_interval_off_the_grid_is_refused(interval: float) -> None:
    """Channels are sampled on the integrator's grid."""
    with pytest.raises(InputError, match=r"multiple of 0\.005 s"):
        record_interval_s(TelemetrySettings(rate_every_s=interval))


def test_rounding_keeps_zero_resolution_exact() -> None:
    """Resolution 0 changes nothing."""
    values = np.array([0.1, 0.2345])
    assert stepped(values, 0.0) is values
    np.testing.assert_allclose(stepped(values, 0.01), [0.1, 0.23])


rpm = st.floats(-1500.0, 1500.0)
EVENTS = st.fixed_dictionaries(
    {
        "id": st.just("random"),
        "kind": st.just("bias"),
        "from_rpm": st.tuples(rpm, rpm, rpm),
        "to_rpm": st.tuples(rpm, rpm, rpm),
        "duration_s": st.floats(20.0, 300.0),
    }
)
CONTROLLERS = st.builds(
    RcsSettings,
    rate_gain_s=st.floats(0.3, 60.0),
    hysteresis=st.floats(0.0, 1.0),
    pulse_law=st.sampled_from(["fixed", "adaptive"]),
    mapping=st.sampled_from(["shared", "union"]),
    latency_cycles=st.sampled_from([0, 1]),
    attitude_knowledge_rad=st.floats(0.0, 1e-4),
    rate_knowledge_rad_s=st.floats(0.0, 1e-5),
)
PARAMETER_CHANGES = st.fixed_dictionaries(
    {
        "cm_x_m": st.floats(-0.3, 0.3),
        "cm_z_m": st.floats(0.0, 2.0),
        "tau_fall_s": st.floats(0.0, 0.1),
        "tau_rise_s": st.floats(0.0, 0.05),
        **{f"inertia_{e}_kg_m2": st.floats(-200.0, 200.0) for e in ELEMENTS[3:]},
        "external_torque_z_n_m": st.floats(-0.02, 0.02),
    }
)


@settings(max_examples=40)
@given(
    event=EVENTS,
    rcs=CONTROLLERS,
    parameters=PARAMETER_CHANGES,
    thrust=st.floats(0.3, 1.2),
    rate=st.floats(0.0, 3e-4),
    tau=st.floats(1.0, 40.0),
    seed=st.integers(0, 1000),
)
def test_random_scenarios_stay_physical(
    event: dict[str, object],
    rcs: RcsSettings,
    parameters: dict[str, float],
    thrust: float,
    rate: float,
    tau: float,
    seed: int,
) -> None:
    """Unit quaternion, no NaN, counters never fall, no more pulses than cycles, momentum kept."""
    plan = make_plan(
        event,
        parameters={**BIASES, **parameters},
        thrust_n=thrust,
        rcs=rcs,
        start=StartSettings(rate_rad_s=rate),
        manager=WheelSettings(time_constant_s=tau),
    )
    motion = run(plan, seed=seed, record_s=0.5)
    for field in (motion.attitude, motion.rate_rad_s, motion.wheels_rad_s, motion.delta_v_body_m_s):
        assert np.all(np.isfinite(field))
    np.testing.assert_allclose(np.linalg.norm(motion.attitude, axis=1), 1.0, atol=1e-12)
    seen = observe(plan, motion, TelemetrySettings(on_time_resolution_s=0.01), seed)
    cycles = motion.duration_s / 0.125
    for name, log in motion.pulses.items():
        on_time, pulses = seen.columns[f"on_time_{name}_s"], seen.columns[f"pulses_{name}"]
        assert np.all(np.diff(on_time) >= -1e-12)
        assert np.all(np.diff(pulses) >= 0.0)
        assert np.all(on_time <= seen.time_s + 0.005 + 1e-9)
        assert log.width_s.size <= cycles
        if log.width_s.size:
            assert log.width_s.min() >= 0.007 - 1e-12
            assert np.all(np.diff(log.start_s) > log.width_s[:-1] - 1e-9)
    assert np.all(np.diff(motion.propellant_kg) >= 0.0)
    momentum = motion.momentum_inertial_n_m_s()
    gain = momentum - momentum[0] - motion.angular_impulse_n_m_s
    # relative to all that went through: a violent limit cycle leaves little of what it stirs
    stirred = 3.0 * thrust * sum(float(log.width_s.sum()) for log in motion.pulses.values())
    assert np.abs(gain).max() <= 1e-8 * max(1.0, float(np.abs(momentum).max()), stirred)


def test_an_effect_is_a_small_frozen_thing() -> None:
    """An effect is a name, keys and one function."""
    effect = Effect("nothing", (), None, lambda plan, _, __: plan)
    plan = make_plan(SHORT)
    assert effect.change(plan, "", {}) is plan
