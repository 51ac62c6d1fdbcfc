"""The spacecraft of these flights: geometry typed from the description, and a truth drawn from
priors.

Body axes X, Y, Z. The torque of a thruster is (r − e) × F, e the centre of mass in the frame of the
thrusters' positions. The inertia is about the centre of mass and holds the wheels as if at rest.
"""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from closed_loop.arrays import Array

Table = dict[str, Any]

THRUSTERS = ("z1", "z2", "z3", "z4", "y1", "y2", "y3", "y4")
CORNERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))
"""Signs of Lx and Ly of thrusters 1 to 4, for Z and Y thrusters alike."""
FORCES = ((0, 0, -1),) * 4 + ((0, -1, 0),) * 2 + ((0, 1, 0),) * 2
SIDEWAYS = {"z": ((1, 0, 0), (0, 1, 0)), "y": ((1, 0, 0), (0, 0, 1))}
"""Directions of the cants a and b of Z and of Y thrusters."""
LY_M = {"A": 1.580, "B": 1.610}
WHEELS = {"A": (1, 2, 3), "B": (1, 2, 4)}
WHEEL_AXES = {
    1: (0.0, np.sqrt(2.0 / 3.0), np.sqrt(1.0 / 3.0)),
    2: (-np.sqrt(1.0 / 2.0), -np.sqrt(1.0 / 6.0), np.sqrt(1.0 / 3.0)),
    3: (np.sqrt(1.0 / 2.0), -np.sqrt(1.0 / 6.0), np.sqrt(1.0 / 3.0)),
}
WHEEL_AXES[4] = WHEEL_AXES[3]  # articulated there in 2003
ELEMENTS = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
AXES = ("x", "y", "z")
_MOST_DRAWS = 10_000


@dataclass(frozen=True, eq=False)
class Body:
    """What flies: mass properties, wheels, thrusters and valves.

    Attributes
    ----------
    mass_kg
        Of everything.
    centre_m
        Centre of mass (3,), in the frame of ``position_m``.
    inertia_kg_m2
        About the centre of mass, (3, 3), wheels included as if at rest.
    wheel_axes
        Spin axes as columns (3, 3), and the spin inertias ``wheel_inertia_kg_m2`` (3,).
    position_m, direction
        Of the thrusters and of their forces, (8, 3).
    thrust_n
        Steady thrusts (8,).
    delay_s, rise_s, fall_s
        Of every valve.
    """

    mass_kg: float
    centre_m: Array
    inertia_kg_m2: Array
    wheel_axes: Array
    wheel_inertia_kg_m2: Array
    position_m: Array
    direction: Array
    thrust_n: Array
    delay_s: float
    rise_s: float
    fall_s: float

    @property
    def torque_per_newton_m(self) -> Array:
        """(r − e) × d of every thruster, (8, 3)."""
        return np.cross(self.position_m - self.centre_m, self.direction)

    def momentum(self, rate_rad_s: Array, wheel_rad_s: Array) -> Array:
        """I ω + T I_w ρ in body axes, rows of (…, 3)."""
        wheels = (wheel_rad_s * self.wheel_inertia_kg_m2) @ self.wheel_axes.T
        return rate_rad_s @ self.inertia_kg_m2.T + wheels


OF_CONTROLLERS = (
    "close_pulse_share",
    "close_pulse_factor",
    "late_pulse_factor",
    "open_counter_factor",
)


def read_priors(path: Path, branch: str) -> Table:
    """A priors file as plain TOML, for a branch: its wheels, and where its thrusters are."""
    document = tomllib.loads(path.read_text("utf-8"))
    document["spacecraft"] |= {"branch": branch, "wheels": list(WHEELS[branch])}
    table = document["parameters"]["thruster_ly_m"]
    table |= {"loc": LY_M[branch], "source": f"{branch} branch; 1 % as in paper 003"}
    return document


def stated_priors(priors: Table, rate_noise_rad_s: float, levels: Mapping[str, float]) -> Table:
    """Priors with a median of the rates' noise, and with levels that are known."""
    tables = {name: dict(table) for name, table in priors["parameters"].items()}
    stated = "stated with the channels of this record"
    tables["rate_noise_rad_s"] |= {"scale": rate_noise_rad_s, "source": stated}
    for name, value in levels.items():
        tables[name] = {"fixed": value, "unit": tables[name]["unit"], "source": stated}
    return {"spacecraft": priors["spacecraft"], "parameters": tables}


def draw(table: Mapping[str, Any], rng: np.random.Generator) -> float:
    """One value of a prior: fixed, normal or log-normal, inside its bounds."""
    if "fixed" in table:
        return float(table["fixed"])
    low, high = table.get("low", -np.inf), table.get("high", np.inf)
    for _ in range(_MOST_DRAWS):
        z = float(rng.standard_normal())
        if table["dist"] == "norm":
            value = table["loc"] + table["scale"] * z
        elif table["dist"] == "lognorm":
            value = table["scale"] * np.exp(table["s"] * z)
        else:
            raise ValueError(f"a prior is norm or lognorm here, not {table['dist']!r}")
        if low <= value <= high:
            return float(value)
    raise ValueError(f"no draw of {dict(table)} lies within its bounds")


def spread(table: Mapping[str, Any]) -> float:
    """Standard deviation of a normal prior; 0 of a fixed value."""
    return 0.0 if "fixed" in table else float(table["scale"])


@dataclass(frozen=True)
class Truth:
    """Prime wheels, parameters that all events share, every thruster's thrust in every event."""

    wheels: tuple[int, ...]
    parameters: Mapping[str, float]
    thrust_n: Mapping[str, Mapping[str, float]]

    def changed(
        self,
        parameters: Mapping[str, float] | None = None,
        thrust_factors: Mapping[str, float] | None = None,
    ) -> Truth:
        """The truth with other values of parameters, and with thrusts multiplied."""
        factors = thrust_factors or {}
        return Truth(
            self.wheels,
            {**self.parameters, **(parameters or {})},
            {
                event: {k: value * factors.get(k, 1.0) for k, value in thrusts.items()}
                for event, thrusts in self.thrust_n.items()
            },
        )

    def body(self, event: str, cants: Mapping[str, tuple[float, float]] | None = None) -> Body:
        """The spacecraft in one event; ``cants`` a and b turn the forces of some thrusters."""
        value = self.parameters
        directions = [canted(name, *(cants or {}).get(name, (0.0, 0.0))) for name in THRUSTERS]
        return Body(
            mass_kg=value["mass_kg"],
            centre_m=np.array([value[f"cm_{axis}_m"] for axis in AXES]),
            inertia_kg_m2=inertia_tensor(value),
            wheel_axes=np.stack([wheel_axis(number, value) for number in self.wheels], axis=1),
            wheel_inertia_kg_m2=np.array([value[f"rwa{n}_inertia_kg_m2"] for n in self.wheels]),
            position_m=thruster_positions(value),
            direction=np.array(directions),
            thrust_n=np.array([self.thrust_n[event][name] for name in THRUSTERS]),
            delay_s=value["tau_delay_s"],
            rise_s=value["tau_rise_s"],
            fall_s=value["tau_fall_s"],
        )


def thruster_positions(value: Mapping[str, float]) -> Array:
    """Positions (8, 3) of Z1 … Z4 and Y1 … Y4: four corners at two heights."""
    lx, ly = value["thruster_lx_m"], value["thruster_ly_m"]
    heights = (value["thruster_lzz_m"], value["thruster_lzy_m"])
    return np.array([(sx * lx, sy * ly, height) for height in heights for sx, sy in CORNERS])


def canted(name: str, a_rad: float, b_rad: float) -> Array:
    """Force direction unit(d + a e1 + b e2) of a thruster."""
    first, second = (np.array(side) for side in SIDEWAYS[name[0]])
    force = np.array(FORCES[THRUSTERS.index(name)]) + a_rad * first + b_rad * second
    return np.asarray(force / np.linalg.norm(force))


def wheel_axis(number: int, value: Mapping[str, float]) -> Array:
    """Spin axis of a wheel, tilted: unit(a + u e1 + v e2), e1 = unit(ẑ × a), e2 = a × e1."""
    axis = np.array(WHEEL_AXES[number])
    first = np.cross([0.0, 0.0, 1.0], axis)
    first /= np.linalg.norm(first)
    tilted = (
        axis
        + value.get(f"rwa{number}_tilt_u_rad", 0.0) * first
        + value.get(f"rwa{number}_tilt_v_rad", 0.0) * np.cross(axis, first)
    )
    return np.asarray(tilted / np.linalg.norm(tilted))


def inertia_tensor(value: Mapping[str, float]) -> Array:
    """Symmetric tensor from its six matrix elements."""
    tensor = np.empty((3, 3))
    for element, (i, j) in ELEMENTS.items():
        tensor[i, j] = tensor[j, i] = value[f"inertia_{element}_kg_m2"]
    return tensor


def is_body(value: Mapping[str, float]) -> bool:
    """Whether a mass distribution can have this tensor: the triangle of principal moments."""
    moments = np.linalg.eigvalsh(inertia_tensor(value))
    return bool(moments[0] > 0.0 and moments[2] <= moments[0] + moments[1])


def draw_truth(priors: Table, events: tuple[str, ...], rng: np.random.Generator) -> Truth:
    """Parameters of these events from their priors; idle wheels' parameters are left out.

    So is what controllers do: these decide it themselves. The thrust of a thruster in an event is
    common + its own departure + the event's + both's.
    """
    tables = copy.deepcopy(priors["parameters"])
    prime = priors["spacecraft"]["wheels"]
    for name in list(tables):
        if (name.startswith("rwa") and int(name[3]) not in prime) or name in OF_CONTROLLERS:
            del tables[name]
    parts = {part: tables.pop(f"thrust_{part}_n") for part in ("individual", "event", "jitter")}
    parameters = {name: draw(table, rng) for name, table in tables.items()}
    while not is_body(parameters):
        elements = [f"inertia_{element}_kg_m2" for element in ELEMENTS]
        parameters |= {name: draw(tables[name], rng) for name in elements}
    common = parameters["thrust_common_n"]
    own = {name: draw(parts["individual"], rng) for name in THRUSTERS}
    thrusts = {}
    for event in events:
        level = common + draw(parts["event"], rng)
        thrusts[event] = {k: level + own[k] + draw(parts["jitter"], rng) for k in THRUSTERS}
    return Truth(tuple(prime), parameters, thrusts)
