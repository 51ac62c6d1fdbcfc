"""The recordings committed as test data: six scenes, made anew by ``--recordings``."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from closed_loop.hidden import Effect
from closed_loop.scene import draw_scene, fly_scene, write_scene
from closed_loop.sizes import sigma

_SMALL = {"shortest_s": 800.0, "longest_s": 900.0}


@dataclass(frozen=True)
class Recording:
    """A scene and what is hidden in it."""

    name: str
    seed: int
    given: Mapping[str, Any]
    effect: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


QUIET = {"rate_noise_rad_s": 2e-6, "rate_step_rad_s": 0.0}
LOUD = {"rate_noise_rad_s": 2e-5, "rate_step_rad_s": 5e-6}
FINE = {"attitude_noise_rad": 2e-5, "attitude_digits": 8}
COARSE = {"attitude_noise_rad": 1e-5, "attitude_digits": 6}
RECORDINGS = (
    Recording(
        "phase-plane", 101,
        {"controller": "phase_plane", "branch": "B", "events": ("bias", "bias", "slew"),
         "row_every_s": 1, "counter_every_s": 1, "counter_step_s": 0.125, "wheel_step_rpm": 0.1,
         **QUIET, **FINE},
    ),
    Recording(
        "pulse-frequency-noisy-rates", 102,
        {"controller": "pulse_frequency", "branch": "A", "events": ("bias", "bias"),
         "row_every_s": 1, "counter_every_s": 1, "counter_step_s": 0.01, "wheel_step_rpm": 1.0,
         **LOUD, **COARSE},
    ),
    Recording(
        "pulse-width-sparse", 103,
        {"controller": "pulse_width", "branch": "B", "events": ("bias", "bias", "bias", "slew"),
         "row_every_s": 4, "counter_every_s": 10, "counter_step_s": 0.001, "wheel_step_rpm": 0.1,
         **QUIET, **FINE, "shortest_s": 1200.0, "longest_s": 1600.0},
    ),
    Recording(
        "degraded-thruster", 104,
        {"controller": "phase_plane", "branch": "B", "events": ("bias", "bias"),
         "row_every_s": 1, "counter_every_s": 1, "counter_step_s": 0.01, "wheel_step_rpm": 0.1,
         **QUIET, **COARSE},
        "thruster_degraded:z3", {"thrust_factor": 0.7},
    ),
    Recording(
        "leak", 105,
        {"controller": "pulse_frequency", "branch": "B", "events": ("bias", "slew"),
         "row_every_s": 1, "counter_every_s": 1, "counter_step_s": 0.001, "wheel_step_rpm": 1.0,
         **QUIET, **FINE},
        "thruster_leak:y2", {"leak_n": 5e-5},
    ),
    Recording(
        "misaligned-thruster", 106,
        {"controller": "pulse_width", "branch": "A", "events": ("bias", "bias", "slew"),
         "row_every_s": 1, "counter_every_s": 10, "counter_step_s": 0.001, "wheel_step_rpm": 0.1,
         **QUIET, **FINE},
        "thruster_misalignment:z1", {"cant_a_rad": 0.05, "cant_b_rad": -0.04},
    ),
)  # fmt: skip


def write_all(out: Path, log: Callable[[str], None]) -> None:
    """Fly and write all recordings, replacing those that are there."""
    for recording in RECORDINGS:
        scene = draw_scene(recording.seed, {**_SMALL, **recording.given})
        effects = [Effect(recording.effect, recording.parameters)] if recording.effect else []
        flights, truth, departures = fly_scene(scene, effects)
        own = sigma(flights, scene.truth, effects, departures, scene.channels, scene.priors)
        kept = [Effect(effect.name, effect.parameters, round(own, 2)) for effect in effects]
        folder = out / recording.name
        shutil.rmtree(folder, ignore_errors=True)
        write_scene(folder, scene, kept, (flights, truth, departures))
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
        pulses = [sum(len(own) for own in flight.pulses) for flight in flights]
        log(f"{recording.name}: {size / 1e3:.0f} kB, {pulses} pulses, {own:.1f} sigma")
