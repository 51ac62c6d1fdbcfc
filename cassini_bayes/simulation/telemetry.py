"""What the ground sees of a motion: channels with their rates, noise, resolution and drop-outs.

Every channel draws from a stream of its own, so the noise is the same whatever happens. Counters
have no noise: on-times as commanded, a pulse counted when it starts.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import tomli_w

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.simulation.kernel import STANDARD_GRAVITY_M_S2, specific_impulse
from cassini_bayes.simulation.motion import Motion
from cassini_bayes.simulation.plan import Plan
from cassini_bayes.simulation.settings import TelemetrySettings
from cassini_bayes.simulation.streams import stream
from cassini_bayes.spacecraft import thruster_directions

DIGITS: Final = 12
DELTA_V_COLUMNS: Final = tuple(f"delta_v_{axis}_m_s" for axis in "xyz")
_WITHOUT_COUNTERS: Final = ("slew", "quiescent")
_TICK_MS: Final = 5
ARRIVED_RPM: Final = 0.1
"""A wheel so near to its commanded rate is there: the approach of a bias leaves 0.07 rev/min."""


@dataclass(frozen=True, eq=False)
class Telemetry:
    """Columns of ``telemetry.csv`` on common times (N,); NaN where a channel was not sampled."""

    time_s: Array
    columns: Mapping[str, Array]


def record_interval_s(settings: TelemetrySettings) -> float:
    """The greatest interval that divides those of all channels and 1 s.

    Raises
    ------
    InputError
        An interval is no multiple of 5 ms.
    """
    common = 1000
    for key, value in settings.model_dump().items():
        if not key.endswith("_every_s"):
            continue
        ms = round(value * 1000)
        if ms % _TICK_MS or abs(ms - value * 1000) > 1e-6:
            raise InputError(
                f"scenario: telemetry.{key}",
                "a multiple of 0.005 s",
                f"{value:g} s",
                "choose an interval that the integrator's grid meets",
            )
        common = math.gcd(common, ms)
    return common / 1000.0


def observe(plan: Plan, motion: Motion, settings: TelemetrySettings, seed: int) -> Telemetry:
    """Sample a motion as telemetry does."""
    channels = _Channels(plan, motion, settings, seed)
    channels.attitude()
    channels.rates()
    channels.wheels()
    counts = plan.event.kind not in _WITHOUT_COUNTERS
    if counts:
        channels.counters()
    if has_delta_v(plan, settings):
        channels.delta_v()
    if settings.accelerometer and counts:
        channels.accelerometer()
    if settings.pressure:
        channels.pressure()
    return channels.table()


def has_delta_v(plan: Plan, settings: TelemetrySettings) -> bool:
    """Whether an event has velocity channels: asked for, and thrusters in use."""
    return settings.delta_v != "none" and plan.event.kind not in _WITHOUT_COUNTERS


def level(plan: Plan, settings: TelemetrySettings, name: str) -> float:
    """A noise or resolution: of the scenario's telemetry table, else of the truth, else 0."""
    value = getattr(settings, name, None)
    return float(plan.parameters.get(name, 0.0) if value is None else value)


@dataclass
class _Channels:
    """Columns while they are collected; dropped and unsampled cells are NaN."""

    _plan: Plan
    _motion: Motion
    _settings: TelemetrySettings
    _seed: int
    _columns: dict[str, Array] = field(default_factory=dict)

    def _level(self, name: str) -> float:
        return level(self._plan, self._settings, name)

    def _noise(self, channel: str, width: int, sigma: float) -> Array:
        shape = (self._motion.time_s.size, width)
        return stream(self._seed, self._plan.event.id, channel).standard_normal(shape) * sigma

    def _keep(self, channel: str, names: Sequence[str], values: Array) -> None:
        time = self._motion.time_s
        every_s = getattr(self._settings, f"{channel.replace(' ', '_')}_every_s")
        phase = np.round(time / every_s)
        sampled = np.abs(time - phase * every_s) < 1e-6
        draws = stream(self._seed, self._plan.event.id, channel, "drop-out").random(time.size)
        # the first row is the epoch: it stays
        sampled &= (draws >= self._settings.drop_out) | (time == 0.0)
        for i, name in enumerate(names):
            self._columns[name] = np.where(sampled, values[:, i], np.nan)

    def attitude(self) -> None:
        angle = self._noise("attitude", 3, self._level("attitude_noise_rad"))
        turned = _turned(self._motion.attitude, angle)
        self._keep("attitude", ("q1", "q2", "q3", "q4"), turned)

    def rates(self) -> None:
        parameters = self._plan.parameters
        bias = np.array([parameters[f"rate_bias_{axis}_rad_s"] for axis in "xyz"])
        scale = 1.0 + np.array(self._plan.misreading.rate_scale)
        noise = self._noise("rate", 3, self._level("rate_noise_rad_s"))
        values = scale * self._motion.rate_rad_s + bias + noise
        names = [f"rate_{axis}_rad_s" for axis in "xyz"]
        self._keep("rate", names, stepped(values, self._settings.rate_resolution_rad_s))

    def wheels(self) -> None:
        speed = self._motion.wheels_rpm
        read = speed * (1.0 + self._plan.misreading.speed_slope_per_rpm * np.abs(speed))
        noise = self._noise("wheel", speed.shape[1], self._level("wheel_noise_rpm"))
        names = [f"{self._plan.spacecraft.wheel(n).name}_rpm" for n in self._plan.wheel_numbers]
        self._keep("wheel", names, stepped(read + noise, self._level("wheel_resolution_rpm")))

    def counters(self) -> None:
        shown = self._motion.time_s - self._plan.misreading.counters_late_s
        resolution = self._level("on_time_resolution_s")
        logs = self._motion.pulses
        on_time = np.stack([log.on_time_s(shown) for log in logs.values()], axis=1)
        pulses = np.stack([log.pulses(shown) for log in logs.values()], axis=1)
        names = [f"on_time_{name}_s" for name in logs] + [f"pulses_{name}" for name in logs]
        values = np.concatenate([stepped(on_time, resolution), pulses], axis=1)
        self._keep("counter", names, values)

    def read_delta_v_m_s(self) -> Array:
        """ΔV (N, 3) as it is read at every time of the motion, whether a row tells it or not."""
        if self._settings.delta_v == "measured":
            values = self._motion.delta_v_body_m_s
        else:
            values = computed_delta_v_m_s(self._plan, self._motion, self._motion.time_s)
        noise = self._noise("delta v", 3, self._level("delta_v_noise_m_s"))
        return stepped(values + noise, self._level("delta_v_resolution_m_s"))

    def delta_v(self) -> None:
        self._keep("delta v", DELTA_V_COLUMNS, self.read_delta_v_m_s())

    def accelerometer(self) -> None:
        """Whole counts N of (ΔV along Z − b t)/κ (paper 000 appendix D)."""
        parameters, motion = self._plan.parameters, self._motion
        drift = parameters["accelerometer_bias_m_s2"] * motion.time_s
        counts = (motion.delta_v_body_m_s[:, 2] - drift) / parameters["accelerometer_scale_m_s"]
        self._keep("accelerometer", ("accelerometer_counts",), np.round(counts)[:, None])

    def pressure(self) -> None:
        noise = self._noise("pressure", 1, self._settings.pressure_noise_kpa)
        values = self._motion.tank_pressure_kpa[:, None] + noise
        self._keep("pressure", ("tank_pressure_kpa",), values)

    def table(self) -> Telemetry:
        cells = np.stack(list(self._columns.values()), axis=1)
        rows = ~np.all(np.isnan(cells), axis=1)
        columns = {name: values[rows] for name, values in self._columns.items()}
        return Telemetry(self._motion.time_s[rows], columns)


def stepped(values: Array, resolution: float) -> Array:
    """Values rounded to whole steps of the resolution; unchanged when it is 0."""
    return np.round(values / resolution) * resolution if resolution > 0.0 else values


def _turned(attitude: Array, angle: Array) -> Array:
    """Attitudes (N, 4) after small turns (N, 3) in body axes."""
    size = np.linalg.norm(angle, axis=1, keepdims=True)
    vector = 0.5 * np.sinc(size / (2.0 * np.pi)) * angle
    scalar = np.cos(0.5 * size)
    old, old_scalar = attitude[:, :3], attitude[:, 3:]
    turned = scalar * old + old_scalar * vector + np.cross(old, vector)
    last = scalar * old_scalar - np.sum(old * vector, axis=1, keepdims=True)
    result = np.concatenate([turned, last], axis=1)
    return np.asarray(result / np.linalg.norm(result, axis=1, keepdims=True))


def computed_delta_v_m_s(plan: Plan, motion: Motion, time_s: Array) -> Array:
    """ΔV (N, 3) as flight software computes it: c F/M Σ_k d_k (T_k + offset · pulses_k).

    c F/M is the plan's ``computed_acceleration_m_s2``, the offset the parameter
    ``fsw_impulse_offset_s`` (paper 001 eq. 22).
    """
    offset_s, factor = plan.parameters["fsw_impulse_offset_s"], plan.computed_acceleration_m_s2
    directions = thruster_directions(plan.spacecraft, plan.branch)
    total = np.zeros((time_s.size, 3))
    for k, log in enumerate(motion.pulses.values()):
        seconds = log.on_time_s(time_s) + offset_s * log.pulses(time_s)
        total += factor * seconds[:, None] * directions[:, k]
    return total


def hydrazine_g(plan: Plan, motion: Motion) -> float:
    """Hydrazine as paper 001 eqs. (19), (21) reckon it from commanded on-times: Σ F T/(g I_sp)."""
    duration = motion.duration_s
    isp = np.array(plan.propulsion.isp_s, dtype=np.float64)
    grams = 0.0
    for log in motion.pulses.values():
        on_time = float(log.width_s.sum())
        impulse = plan.parameters["thrust_common_n"] * on_time
        exhaust_m_s = STANDARD_GRAVITY_M_S2 * specific_impulse(isp, on_time / duration)
        grams += 1000.0 * impulse / exhaust_m_s
    return grams


def event_fields(plan: Plan, settings: TelemetrySettings) -> dict[str, Any]:
    """The content of an event folder's ``event.toml``, by key."""
    event = plan.event
    document: dict[str, Any] = {
        "id": event.id,
        "kind": event.kind,
        "epoch": event.epoch.isoformat().replace("+00:00", "Z"),
        "branch": plan.branch,
        "wheels": list(plan.wheel_numbers),
    }
    if has_delta_v(plan, settings):
        document["delta_v_source"] = settings.delta_v
    document["source"] = settings.source
    return document


def event_text(plan: Plan, settings: TelemetrySettings) -> str:
    """``event.toml`` of an event folder."""
    return tomli_w.dumps(event_fields(plan, settings))


def telemetry_text(telemetry: Telemetry) -> str:
    """``telemetry.csv`` of an event folder: an empty cell where a channel was not sampled."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time_s", *telemetry.columns])
    columns = [telemetry.time_s, *telemetry.columns.values()]
    for row in np.stack(columns, axis=1).tolist():
        writer.writerow(["" if math.isnan(x) else f"{x + 0.0:.{DIGITS}g}" for x in row])
    return text.getvalue()


def _end_rpm(plan: Plan, motion: Motion, settings: TelemetrySettings) -> Array:
    """Wheel rates (W,) at the end: the commanded ones, of wheels that are there, or the true."""
    step = level(plan, settings, "wheel_resolution_rpm")
    commanded = np.array(plan.event.to_rpm or plan.event.from_rpm, dtype=np.float64)
    reached = motion.wheels_rpm[-1]
    is_there = np.abs(reached - commanded) <= max(step, ARRIVED_RPM)
    return np.where(is_there, commanded, stepped(reached, step))


def totals_row(
    plan: Plan, motion: Motion, settings: TelemetrySettings, seed: int
) -> dict[str, Any]:
    """Totals of a bias: the fields of a totals event, as plain values and arrays.

    Everything is that of the end of the motion, ΔV as well, whether or not telemetry has a row
    there. On-times are rounded to their resolution.
    """
    end = np.array([motion.duration_s])
    names = plan.thrusters
    delta_v = None
    if settings.delta_v != "none":
        delta_v = _Channels(plan, motion, settings, seed).read_delta_v_m_s()[-1]
    resolution = level(plan, settings, "on_time_resolution_s")
    on_time = np.array([float(motion.pulses[name].on_time_s(end)[0]) for name in names])
    return {
        "id": plan.event.id,
        "epoch": plan.event.epoch,
        "branch": plan.branch,
        "wheels": plan.wheel_numbers,
        "rwa_start_rpm": np.array(plan.event.from_rpm, dtype=np.float64),
        "rwa_end_rpm": _end_rpm(plan, motion, settings),
        "duration_s": motion.duration_s,
        "thrusters": names,
        "on_time_s": stepped(on_time, resolution),
        "pulses": np.array([float(motion.pulses[name].pulses(end)[0]) for name in names]),
        "delta_v_m_s": delta_v,
        "delta_v_source": None if settings.delta_v == "none" else settings.delta_v,
        "hydrazine_g": hydrazine_g(plan, motion),
        "mass_kg": plan.nominal_mass_kg,
        "thrust_predicted_n": plan.parameters["thrust_common_n"],
        "source": "simulation",
    }
