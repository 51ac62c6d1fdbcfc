"""What the ground gets of a flight: event folders, and the truth beside them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from closed_loop.arrays import Array
from closed_loop.cassini import AXES, THRUSTERS, Table, Truth, stated_priors
from closed_loop.flight import Flight
from closed_loop.hidden import Departures, Effect
from closed_loop.valve import commanded

RPM_PER_RAD_S = 60.0 / (2.0 * np.pi)


@dataclass(frozen=True)
class Channels:
    """How channels are sampled, disturbed and printed.

    ``row_every_ms`` is the interval of attitude, rates and wheels, ``counter_every_ms`` that of the
    counters; noises are 1 σ, steps the least steps of print (0: printed in full).
    """

    row_every_ms: int
    counter_every_ms: int
    counter_step_ms: int
    wheel_noise_rpm: float
    wheel_step_rpm: float
    rate_noise_rad_s: float
    rate_step_rad_s: float
    attitude_noise_rad: float
    attitude_digits: int


def row_times(kind: str, duration_ms: int, channels: Channels) -> list[int]:
    """Times of all rows: those of either group of channels."""
    times = set(range(0, duration_ms + 1, channels.row_every_ms))
    if kind == "bias":
        times |= set(range(0, duration_ms + 1, channels.counter_every_ms))
    return sorted(times)


def telemetry_csv(
    flight: Flight,
    channels: Channels,
    departures: Departures,
    wheels: Sequence[int],
    rng: np.random.Generator,
) -> str:
    """``telemetry.csv`` of a flight."""
    n = len(flight.row_ms)
    columns: dict[str, list[str]] = {"time_s": [f"{t / 1000:g}" for t in flight.row_ms]}
    attitude = _disturbed(
        flight.attitude, channels.attitude_noise_rad * rng.standard_normal((n, 3))
    )
    for j in range(4):
        columns[f"q{j + 1}"] = [f"{q:.{channels.attitude_digits}f}" for q in attitude[:, j]]
    noise = channels.rate_noise_rad_s * rng.standard_normal((n, 3))
    for j, axis in enumerate(AXES):
        shown = (1.0 + departures.rate_scale.get(axis, 0.0)) * flight.rate[:, j]
        shown = shown + departures.rate_bias_rad_s.get(axis, 0.0) + noise[:, j]
        columns[f"rate_{axis}_rad_s"] = _printed(shown, channels.rate_step_rad_s, 9)
    spin = RPM_PER_RAD_S * flight.wheels + channels.wheel_noise_rpm * rng.standard_normal((n, 3))
    for j, number in enumerate(wheels):
        columns[f"rwa{number}_rpm"] = _printed(spin[:, j], channels.wheel_step_rpm, 4)
    sampled = flight.row_ms % channels.row_every_ms == 0
    for name in columns:
        if name != "time_s":
            columns[name] = [c if s else "" for c, s in zip(columns[name], sampled, strict=True)]
    if flight.event.kind == "bias":
        columns |= _counters(flight, channels, departures)
    lines = [",".join(columns)]
    lines += [",".join(cells) for cells in zip(*columns.values(), strict=True)]
    return "\n".join(lines) + "\n"


def _disturbed(attitude: Array, angles: Array) -> Array:
    """Attitudes turned further by small angles about body axes."""
    x, y, z, w = attitude.T
    a, b, c = 0.5 * angles.T
    turned = np.stack(
        [x + w * a + y * c - z * b, y + w * b + z * a - x * c, z + w * c + x * b - y * a,
         w - x * a - y * b - z * c], axis=1,
    )  # fmt: skip
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _printed(values: Array, step: float, digits: int) -> list[str]:
    """Numbers in steps, or with so many digits after the point, without idle zeros."""
    if step:
        values = step * np.round(values / step)
        digits = max(0, -int(np.floor(np.log10(step) + 1e-9)))
    texts = [f"{value:.{digits}f}" for value in values]
    return [text.rstrip("0").rstrip(".") if "." in text else text for text in texts]


def _counters(flight: Flight, channels: Channels, departures: Departures) -> dict[str, list[str]]:
    """Cumulative on-times in the counter's steps, and pulses; late by the hidden offset."""
    shown_ms = flight.row_ms - round(1000.0 * departures.time_offset_s)
    sampled = flight.row_ms % channels.counter_every_ms == 0
    columns: dict[str, list[str]] = {}
    counts: dict[str, list[str]] = {}
    for name, pulses in zip(THRUSTERS, flight.pulses, strict=True):
        on_ms, started = commanded(pulses, shown_ms)
        step = channels.counter_step_ms
        rounded = step * ((2 * on_ms + step) // (2 * step))
        columns[f"on_time_{name}_s"] = [
            f"{value / 1000:.3f}".rstrip("0").rstrip(".") if s else ""
            for value, s in zip(rounded, sampled, strict=True)
        ]
        counts[f"pulses_{name}"] = [
            str(value) if s else "" for value, s in zip(started, sampled, strict=True)
        ]
    return columns | counts


def event_toml(flight: Flight, branch: str, wheels: Sequence[int]) -> str:
    """``event.toml`` of a flight."""
    event = flight.event
    fields = {
        "id": event.name,
        "kind": event.kind,
        "epoch": event.epoch,
        "branch": branch,
        "wheels": list(wheels),
        "source": "simulation (Basilisk)",
    }
    return tomli_w.dumps(fields)


def truth_json(
    seed: int,
    truth: Truth,
    effects: Sequence[Effect],
    flights: Sequence[Flight],
    conditions: Mapping[str, Any],
) -> str:
    """``truth.json``: parameters and thrusts with the effects applied, effects, conditions,
    firings.

    Firings are start and width in ms, relative to the first row, by thruster.
    """
    fields = {
        "format": 1,
        "seed": seed,
        "parameters": dict(truth.parameters),
        "effects": [
            {k: v for k, v in asdict(effect).items() if v is not None} for effect in effects
        ],
        "events": {
            flight.event.name: {
                "parameters": {},
                "thrust_n": dict(truth.thrust_n[flight.event.name]),
                "firings_ms": {
                    name: [[start, end - start] for start, end in pulses]
                    for name, pulses in zip(THRUSTERS, flight.pulses, strict=True)
                    if pulses
                },
            }
            for flight in flights
        },
        "conditions": dict(conditions),
    }
    return _compact_lists(json.dumps(fields, indent=1, allow_nan=False)) + "\n"


def _compact_lists(text: str) -> str:
    """Lists of numbers on one line: a list of firings is not a page."""
    lines: list[str] = []
    depth = 0
    for line in text.split("\n"):
        stripped = line.strip()
        if depth:
            lines[-1] += stripped
        else:
            lines.append(line)
        if stripped.endswith("["):
            depth += 1
        elif stripped.startswith("]"):
            depth -= 1
        if depth and stripped.endswith(","):
            lines[-1] += " "
    return "\n".join(lines)


def priors_toml(priors: Table, channels: Channels) -> str:
    """The priors file for a diagnosis: noise and steps as the channels' makers state them."""
    levels = {
        "attitude_noise_rad": channels.attitude_noise_rad,
        "wheel_resolution_rpm": channels.wheel_step_rpm,
        "on_time_resolution_s": channels.counter_step_ms / 1000,
    }
    return tomli_w.dumps(stated_priors(priors, max(channels.rate_noise_rad_s, 1e-7), levels))


def write_record(
    folder: Path,
    flights: Sequence[Flight],
    texts: Mapping[str, str],
    branch: str,
    wheels: Sequence[int],
    truth_text: str,
    priors_text: str,
) -> None:
    """Event folders with their telemetry, ``truth.json`` and ``priors.toml`` beside them."""
    for flight in flights:
        event = folder / flight.event.name
        event.mkdir(parents=True, exist_ok=True)
        (event / "event.toml").write_text(event_toml(flight, branch, wheels), "utf-8")
        (event / "telemetry.csv").write_text(texts[flight.event.name], "utf-8")
    (folder / "truth.json").write_text(truth_text, "utf-8")
    (folder / "priors.toml").write_text(priors_text, "utf-8")
