"""Spacecraft that the tests run over, and geometry read plainly from their files.

Nothing here uses the package's geometry: files are read with tomllib and torques are taken with one
cross product per thruster.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.priors.reader import Priors, read_priors

Values = Mapping[str, float]

ROOT = Path(__file__).parents[1]
CASSINI = ROOT / "cassini_bayes" / "spacecraft" / "cassini.toml"
TWELVE = ROOT / "tests" / "data" / "spacecraft" / "twelve.toml"
FILES = {"cassini": CASSINI, "twelve": TWELVE}
PRIORS = {
    "cassini": ROOT / "priors" / "cassini_b_branch_2010.toml",
    "twelve": ROOT / "tests" / "data" / "priors" / "twelve.toml",
}
RPM = 2 * np.pi / 60


@cache
def table(name: str) -> dict[str, Any]:
    """The spacecraft file as tomllib reads it."""
    return tomllib.loads(FILES[name].read_text(encoding="utf-8"))


@cache
def priors_of(name: str) -> Priors:
    """Priors that suit the spacecraft."""
    return read_priors(PRIORS[name])


@cache
def middle(name: str) -> dict[str, float]:
    """The prior mean, or fixed value, of every parameter."""
    values = {}
    for key, prior in priors_of(name).parameters.items():
        value = prior.fixed if prior.distribution is None else prior.distribution.mean()
        assert value is not None
        values[key] = float(value)
    return values


def plain_position(thruster: Mapping[str, Any], values: Values) -> Array:
    """Position of one [[thruster]] table."""
    coordinates = []
    for entry in thruster["position"]:
        if isinstance(entry, str):
            value = values[entry.lstrip("+-")]
            coordinates.append(-value if entry[0] == "-" else value)
        else:
            coordinates.append(entry)
    return np.array(coordinates)


def plain_arm(thruster: Mapping[str, Any], values: Values) -> Array:
    """Torque per newton of one [[thruster]] table about the centre of mass."""
    centre = np.array([values[f"cm_{axis}_m"] for axis in "xyz"])
    return np.cross(plain_position(thruster, values) - centre, thruster["direction"])


def plain_wheel_axis(wheel: Mapping[str, Any], values: Values) -> Array:
    """Spin axis of one [[wheel]] table, tilted by rotations rather than by adding vectors.

    unit(a + u e1 + v e2) lies in the plane of a and u e1 + v e2, at atan(|(u, v)|) from a.
    """
    a = np.array(wheel["axis"])
    if "tilt" not in wheel:
        return a
    u, v = (values[name] for name in wheel["tilt"])
    size = np.hypot(u, v)
    if size == 0:
        return a
    azimuth = np.arctan2(a[1], a[0])
    east = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    north = np.cross(a, east)
    angle = np.arctan(size)
    return np.cos(angle) * a + np.sin(angle) * (u * east + v * north) / size


def balanced_events(
    name: str, branch: str, values: Values, thrust: Array, rng: np.random.Generator, n: int
) -> tuple[TotalsEvent, ...]:
    """Made-up biases whose wheels take exactly what thrusters, torque and dead-band deliver.

    On-times are drawn; the angular impulse follows from one cross product per thruster; the change
    of wheel speed is the least one that takes it up. thrust (n, K) in N.
    """
    file = table(name)
    thrusters = [t for t in file["thruster"] if branch in t["branches"]]
    wheels = [w for w in file["wheel"] if w["number"] in priors_of(name).wheels]
    momentum = np.stack(
        [values[w["inertia"]] * plain_wheel_axis(w, values) * RPM for w in wheels], axis=-1
    )
    inertia = np.array(
        [[values[f"inertia_{''.join(sorted(a + b))}_kg_m2"] for b in "xyz"] for a in "xyz"]
    )
    torque = np.array([values[f"external_torque_{axis}_n_m"] for axis in "xyz"])
    rise, fall = values["tau_rise_s"], values["tau_fall_s"]
    events = []
    for e in range(n):
        width = rng.uniform(0.06, 0.25, len(thrusters))
        pulses = np.round(rng.uniform(2, 8, len(thrusters)) * rng.choice([1, 10], len(thrusters)))
        duration = 1200.0
        impulse = torque * duration
        for k, thruster in enumerate(thrusters):
            one = width[k] + (fall - rise) * (1 - np.exp(-width[k] / rise))
            impulse = impulse + plain_arm(thruster, values) * thrust[e, k] * pulses[k] * one
        rates = values["hold_rate_rad_s"] * rng.standard_normal((2, 3))
        change = np.linalg.lstsq(momentum, impulse - inertia @ (rates[1] - rates[0]), rcond=None)[0]
        start = rng.uniform(-300, 300, len(wheels))
        events.append(
            TotalsEvent(
                id=f"made-up-{e}",
                epoch=datetime(2031, 1, 1 + e, tzinfo=UTC),
                branch=branch,
                wheels=tuple(w["number"] for w in wheels),
                rwa_start_rpm=start,
                rwa_end_rpm=start + change,
                duration_s=duration,
                thrusters=tuple(t["name"] for t in thrusters),
                on_time_s=width * pulses,
                pulses=pulses,
                delta_v_m_s=None,
                delta_v_source=None,
                hydrazine_g=None,
                mass_kg=None,
                thrust_predicted_n=None,
                source="simulation",
            )
        )
    return tuple(events)
