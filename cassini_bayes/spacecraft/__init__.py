"""The spacecraft as data: wheels, thrusters and geometry from a TOML file, no constants in code."""

from __future__ import annotations

from cassini_bayes.spacecraft.cant_axes import cant_axes
from cassini_bayes.spacecraft.description import (
    AXIS_DEMANDS,
    WHEEL_KEYS,
    BranchGeometry,
    Platform,
    Spacecraft,
    Thruster,
    Wheel,
)
from cassini_bayes.spacecraft.geometry import (
    centre_of_mass,
    check_axis_pairs,
    couples,
    inertia_tensor,
    lever_arms,
    pair_indicator,
    thruster_directions,
    thruster_positions,
    wheel_axes,
    wheel_inertias,
)
from cassini_bayes.spacecraft.reader import load_spacecraft

__all__ = [
    "AXIS_DEMANDS",
    "WHEEL_KEYS",
    "BranchGeometry",
    "Platform",
    "Spacecraft",
    "Thruster",
    "Wheel",
    "cant_axes",
    "centre_of_mass",
    "check_axis_pairs",
    "couples",
    "inertia_tensor",
    "lever_arms",
    "load_spacecraft",
    "pair_indicator",
    "thruster_directions",
    "thruster_positions",
    "wheel_axes",
    "wheel_inertias",
]
